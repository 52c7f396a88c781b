# SPDX-License-Identifier: Apache-2.0
"""Hidden chains against the enumeration of all that could have happened."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import product

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.special import logsumexp

from tpgmm_core.common.types import Array
from tpgmm_core.learning.hidden_markov.chain import Posteriors
from tpgmm_core.learning.hidden_markov.durations import PRIOR_SEGMENTS, Durations
from tpgmm_core.learning.hidden_markov.markov import MarkovChain, SemiMarkovChain


def random_rows(rng: np.random.Generator, K: int, allowed: Array) -> Array:
    rows = rng.dirichlet(np.ones(K), size=len(allowed)) * allowed
    return rows / np.maximum(rows.sum(axis=1, keepdims=True), 1e-300)


def markov(rng: np.random.Generator, K: int) -> MarkovChain:
    allowed = (rng.random((K, K)) > 0.3) | np.eye(K, dtype=bool)
    return MarkovChain(random_rows(rng, K, np.ones((1, K)))[0], random_rows(rng, K, allowed))


def semi_markov(rng: np.random.Generator, K: int, L: int = 4) -> SemiMarkovChain:
    durations = Durations.around(rng.uniform(1.0, L, K), L)
    start = random_rows(rng, K, np.ones((1, K)))[0]
    return SemiMarkovChain(start, random_rows(rng, K, 1.0 - np.eye(K)), durations)


def log(p: float) -> float:
    return float(np.log(p)) if p > 0.0 else -np.inf


def courses(chain: MarkovChain | SemiMarkovChain, log_b: Array) -> Iterator[tuple[list[int], Posteriors]]:
    """Everything that could have happened: states, and numbers of starts, transitions, durations with their
    log-density."""
    T, K = log_b.shape
    for states in product(range(K), repeat=T):
        if isinstance(chain, MarkovChain):
            cuts: list[tuple[int, ...]] = [tuple(range(1, T))]  # every sample is a segment of its own
        else:
            changes = tuple(t for t in range(1, T) if states[t] != states[t - 1])
            cuts = [changes]
        for cut in cuts:
            begins, ends = (0, *cut), (*cut, T)
            value = log(chain.start[states[0]]) + sum(log_b[t, s] for t, s in enumerate(states))
            transitions, durations = np.zeros((K, K)), np.zeros((K, T))
            for b, e in zip(begins, ends, strict=True):
                if b > 0:
                    value += log(chain.transitions[states[b - 1], states[b]])
                    transitions[states[b - 1], states[b]] += 1.0
                durations[states[b], e - b - 1] += 1.0
                if isinstance(chain, SemiMarkovChain):
                    L = chain.durations.max_duration
                    value += chain.durations.log_probabilities[states[b], e - b - 1] if e - b <= L else -np.inf
            occupancy = np.eye(K)[list(states)]
            yield list(states), Posteriors(value, occupancy, occupancy[0], transitions, durations)


def expected(chain: MarkovChain | SemiMarkovChain, log_b: Array) -> tuple[Posteriors, list[int], float]:
    everything = list(courses(chain, log_b))
    values = np.array([found.log_likelihood for _, found in everything])
    total = float(logsumexp(values))
    weights = np.exp(values - total)

    def mean(name: str) -> Array:
        return np.asarray(sum(w * getattr(found, name) for w, (_, found) in zip(weights, everything, strict=True)))

    names = ("responsibilities", "starts", "transitions", "durations")
    best = int(np.argmax(values))
    return Posteriors(total, *(mean(name) for name in names)), everything[best][0], float(values[best])


@settings(max_examples=30)
@given(
    seed=st.integers(0, 2**32 - 1),
    K=st.integers(1, 3),
    lengths=st.lists(st.integers(1, 6), min_size=1, max_size=3),
    scale=st.sampled_from([1.0, 30.0, 1000.0]),
    semi=st.booleans(),
)
def test_posteriors_and_likeliest_states_agree_with_enumeration(
    seed: int, K: int, lengths: list[int], scale: float, semi: bool
) -> None:
    rng = np.random.default_rng(seed)
    if semi and K == 1:
        lengths = [min(n, 4) for n in lengths]  # a single state lasts no longer than the longest duration
    chain = semi_markov(rng, K) if semi else markov(rng, K)
    log_b = scale * rng.normal(size=(sum(lengths), K))
    parts = np.split(log_b, np.cumsum(lengths)[:-1])
    answers = [expected(chain, part) for part in parts]
    found = chain.posteriors(log_b, lengths)
    assert found.log_likelihood == pytest.approx(sum(a.log_likelihood for a, _, _ in answers), rel=1e-12, abs=1e-10)
    np.testing.assert_allclose(
        found.responsibilities, np.concatenate([a.responsibilities for a, _, _ in answers]), atol=1e-9
    )
    np.testing.assert_allclose(found.starts, sum(a.starts for a, _, _ in answers), atol=1e-9)
    np.testing.assert_allclose(found.transitions, sum(a.transitions for a, _, _ in answers), atol=1e-9)
    if semi:
        durations = np.zeros((K, 6))
        for a, _, _ in answers:
            durations[:, : a.durations.shape[1]] += a.durations
        np.testing.assert_allclose(found.durations, durations[:, :4], atol=1e-9)
    states, value = chain.most_likely(log_b, lengths)
    assert value == pytest.approx(sum(v for _, _, v in answers), rel=1e-12, abs=1e-10)
    np.testing.assert_array_equal(states, np.concatenate([path for _, path, _ in answers]))


@pytest.mark.parametrize("semi", [False, True])
def test_em_of_the_chain_never_lowers_its_objective(semi: bool) -> None:
    rng = np.random.default_rng(1)
    chain: MarkovChain | SemiMarkovChain = semi_markov(rng, 3, L=30) if semi else markov(rng, 3)
    log_b = 3.0 * rng.normal(size=(150, 3))
    objectives = []
    for _ in range(40):
        found = chain.posteriors(log_b, [60, 50, 40])
        objectives.append(found.log_likelihood + chain.log_prior)
        chain = chain.maximised(found)
    assert np.diff(objectives).min() > -1e-9
    np.testing.assert_allclose(chain.transitions.sum(axis=1), 1.0)


@settings(max_examples=50)
@given(seed=st.integers(0, 2**32 - 1), L=st.integers(1, 300), n=st.floats(0.0, 50.0), width=st.floats(0.0, 40.0))
def test_durations_match_the_moments_that_they_are_given(seed: int, L: int, n: float, width: float) -> None:
    rng = np.random.default_rng(seed)
    d = np.arange(1.0, L + 1.0)
    counts = np.exp(-0.5 * ((d - rng.uniform(1.0, L)) / (width + 1e-3)) ** 2)[None]
    counts *= n / max(counts.sum(), 1e-300)
    durations = Durations.around([rng.uniform(1.0, L)], L)
    if seed % 3 == 0:
        counts[0, [0, -1]] += n  # a spread that no log-normal distribution has
    new = durations.maximised(counts)
    features = np.stack([np.log(d), np.log(d) ** 2])
    wanted = (counts @ features.T + PRIOR_SEGMENTS * durations.prior_moments) / (counts.sum() + PRIOR_SEGMENTS)
    moments = np.exp(new.log_probabilities) @ features.T
    np.testing.assert_allclose(moments[:, 0], wanted[:, 0], atol=1e-6)
    if new.natural[0, 1] < 0.0:
        np.testing.assert_allclose(moments[:, 1], wanted[:, 1], atol=1e-6)
    else:
        assert new.natural[0, 1] == 0.0 and moments[0, 1] <= wanted[0, 1]
    np.testing.assert_allclose(np.exp(new.log_probabilities).sum(), 1.0, atol=1e-12)


def test_left_right_states_follow_each_other_and_the_last_one_stays() -> None:
    for chain in (
        MarkovChain.of("left-right", np.full(3, 10.0)),
        SemiMarkovChain.of("left-right", np.full(3, 10.0), 20),
    ):
        p = chain.state_probabilities(100)
        np.testing.assert_allclose(p.sum(axis=1), 1.0, atol=1e-12)
        np.testing.assert_allclose(p[0], [1.0, 0.0, 0.0])
        assert p[99, 2] > 0.99 and np.argmax(p[12]) == 1
        assert np.all(np.diff(p @ np.arange(3.0)) > -1e-12)


def test_a_demonstration_that_cannot_be_is_refused() -> None:
    chain = SemiMarkovChain.of("left-right", np.full(2, 3.0), 5)
    with pytest.raises(ValueError, match="demonstration 1 .* max_duration"):
        chain.posteriors(np.zeros((21, 2)), [10, 11])
    with pytest.raises(ValueError, match="diagonal of its transitions must be 0"):
        SemiMarkovChain.of(np.eye(2), np.full(2, 3.0), 5)
    with pytest.raises(ValueError, match="left-right"):
        MarkovChain.of("circular", np.full(2, 3.0))
    with pytest.raises(ValueError, match="shape"):
        MarkovChain.of(np.ones((3, 2)), np.full(2, 3.0))
