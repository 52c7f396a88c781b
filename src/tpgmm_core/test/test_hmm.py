# SPDX-License-Identifier: Apache-2.0
from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tpgmm_core import TPGMM, Adapter, ModelFileError
from tpgmm_core.common.types import Array
from tpgmm_core.learning.hidden_markov.hmm import TPHMM
from tpgmm_core.learning.hidden_markov.hsmm import TPHSMM
from tpgmm_core.learning.hidden_markov.markov import MarkovChain
from workloads import Workload, demonstrations, pose_demonstrations

SMALL = Workload("small", n_demonstrations=4, n_samples=60, n_frames=2, D=3, K=4)
MEANS = {"a": np.array([[0.0, 0.0], [3.0, 0.0], [3.0, 3.0]]), "b": np.array([[1.0], [-1.0], [2.0]])}


def sampled(
    rng: np.random.Generator, transitions: Array, mean_durations: Array, n_segments: int, n_sequences: int
) -> tuple[dict[str, Array], list[int], Array]:
    """Segments of the states of `MEANS` with log-normal durations: views, lengths, states."""
    states, lengths = [], []
    for _ in range(n_sequences):
        k, before = 0, len(states)
        for _ in range(n_segments):
            states += [k] * max(1, round(mean_durations[k] * np.exp(0.2 * rng.normal())))
            k = int(rng.choice(3, p=transitions[k]))
        lengths.append(len(states) - before)
    path = np.array(states)
    X = {name: means[path] + 0.5 * rng.normal(size=(len(path), means.shape[1])) for name, means in MEANS.items()}
    return X, lengths, path


def frequencies(path: Array, lengths: list[int]) -> tuple[Array, list[list[int]]]:
    """Of states (N,) in sequences: shares (3, 3) of the segments that follow one another, and durations by state."""
    counts, durations = np.zeros((3, 3)), [list[int]() for _ in range(3)]
    for sequence in np.split(path, np.cumsum(lengths)[:-1]):
        changes = np.flatnonzero(np.diff(sequence)) + 1
        segments = np.split(sequence, changes)
        for before, after in zip(segments, segments[1:], strict=False):
            counts[before[0], after[0]] += 1.0
            durations[before[0]].append(len(before))
        durations[segments[-1][0]].append(len(segments[-1]))
    return counts / counts.sum(axis=1, keepdims=True), durations


def order_of(model: TPGMM) -> Array:
    """Which component of the model is which state of `MEANS`."""
    return np.array([np.argmin(np.linalg.norm(model.means_["a"] - mean, axis=1)) for mean in MEANS["a"]])


def test_parameters_of_a_semi_markov_model_are_recovered() -> None:
    rng = np.random.default_rng(0)
    transitions = np.array([[0.0, 0.7, 0.3], [0.2, 0.0, 0.8], [0.5, 0.5, 0.0]])
    durations = np.array([6.0, 12.0, 20.0])
    X, lengths, path = sampled(rng, transitions, durations, n_segments=40, n_sequences=10)
    model = TPHSMM(3, init="kmeans", transitions="ergodic", max_duration=50)
    model.fit_projected(X, lengths=lengths)
    order = order_of(model)
    assert sorted(order) == [0, 1, 2] and model.converged_
    drawn, drawn_durations = frequencies(path, lengths)
    np.testing.assert_allclose(model.transitions_[np.ix_(order, order)], drawn, atol=0.005)
    np.testing.assert_allclose(model.transitions_[np.ix_(order, order)], transitions, atol=0.12)
    for k in range(3):
        assert model.mean_durations_[order[k]] == pytest.approx(np.mean(drawn_durations[k]), rel=0.01)
        assert model.std_durations_[order[k]] == pytest.approx(np.std(drawn_durations[k]), rel=0.1)
    for name, means in MEANS.items():
        np.testing.assert_allclose(model.means_[name][order], means, atol=0.06)
        truth = np.stack([0.25 * np.eye(means.shape[1])] * 3)
        np.testing.assert_allclose(model.covariances_[name][order], truth, atol=0.06)
    np.testing.assert_allclose(model.priors_[order], np.bincount(path) / len(path), atol=0.02)


def test_parameters_of_a_markov_model_are_recovered() -> None:
    rng = np.random.default_rng(1)
    transitions = np.array([[0.9, 0.1, 0.0], [0.0, 0.8, 0.2], [0.1, 0.0, 0.9]])
    X, lengths, _ = sampled(rng, transitions, np.ones(3), n_segments=400, n_sequences=6)
    model = TPHMM(3, init="kmeans", transitions="ergodic").fit_projected(X, lengths=lengths)
    order = order_of(model)
    np.testing.assert_allclose(model.transitions_[np.ix_(order, order)], transitions, atol=0.04)
    np.testing.assert_allclose(model.start_probabilities_[order], [1.0, 0.0, 0.0], atol=1e-3)


def test_neighbours_tell_states_apart_that_look_the_same() -> None:
    """Where a movement comes through the same place twice, a mixture sees one component, a chain two states."""
    rng = np.random.default_rng(2)
    path = np.repeat([0, 1, 0], 20)
    x = np.concatenate([MEANS["a"][path] + 0.1 * rng.normal(size=(60, 2)) for _ in range(5)])
    model = TPHSMM(3).fit_projected({"a": x}, lengths=[60] * 5)
    np.testing.assert_allclose(model.means_["a"], MEANS["a"][[0, 1, 0]], atol=0.05)
    np.testing.assert_allclose(model.mean_durations_, 20.0, rtol=0.05)
    p = model.state_probabilities(60)
    np.testing.assert_array_equal(np.argmax(p[[5, 30, 55]], axis=1), [0, 1, 2])


@settings(max_examples=12)
@given(
    seed=st.integers(0, 2**32 - 1),
    kind=st.sampled_from([TPHMM, TPHSMM]),
    transitions=st.sampled_from(["left-right", "ergodic"]),
    covariance=st.sampled_from(["full", "diag", "tied", "spherical"]),
    hidden=st.floats(0.0, 0.5),
    K=st.integers(1, 4),
)
def test_the_objective_never_falls(
    seed: int, kind: type[TPHMM], transitions: str, covariance: str, hidden: float, K: int
) -> None:
    rng = np.random.default_rng(seed)
    X = {f"frame_{j}": np.cumsum(rng.normal(size=(90, D)), axis=0) for j, D in enumerate((2, 3))}
    visible = {name: rng.random(90) >= hidden for name in X}
    model = kind(
        K, transitions=transitions, covariance=covariance, regularization="prior", reg_covar=1e-2, tol=0.0, max_iter=25
    )
    model.fit_projected(X, visible, lengths=[40, 20, 30])
    assert np.diff(model.objectives_).min(initial=0.0) > -1e-9
    assert all(np.all(np.isfinite(m)) for m in model.means_.values())
    np.testing.assert_allclose(model.start_probabilities_.sum(), 1.0)
    assert np.all(np.isin(np.round(model.transitions_.sum(axis=1), 9), [0.0, 1.0]))


def test_what_a_hidden_sample_holds_does_not_matter() -> None:
    rng = np.random.default_rng(3)
    X, lengths, _ = sampled(rng, np.roll(np.eye(3), 1, axis=1), np.full(3, 8.0), 3, 4)
    mask = rng.random(len(X["b"])) > 0.3
    spoilt = {**X, "b": np.where(mask[:, None], X["b"], np.nan)}
    a, b = (TPHSMM(3).fit_projected(x, {"b": mask}, lengths=lengths) for x in (X, spoilt))
    np.testing.assert_array_equal(a.means_["b"], b.means_["b"])


def test_one_state_is_one_gaussian() -> None:
    demos = demonstrations(SMALL)
    gaussian = TPGMM(1).fit(demos)
    hmm = TPHMM(1, tol=0.0, max_iter=6).fit(demos)
    assert hmm.log_likelihood_ == pytest.approx(gaussian.log_likelihood_, abs=1e-9)
    np.testing.assert_allclose(hmm.covariances_["frame_0"], gaussian.covariances_["frame_0"], atol=1e-9)


@pytest.mark.parametrize("init", ["time", "bins", "kmeans"])
def test_states_of_a_left_right_model_are_in_order_from_any_start(init: str) -> None:
    demos = demonstrations(SMALL)
    model = TPHMM(4, init=init).fit(demos)
    assert np.all(np.diff(model.means_["frame_0"][:, 0]) > 0.0)
    for states, posteriors in zip(model.most_likely_states(demos), model.state_posteriors(demos), strict=True):
        assert np.all(np.isin(np.diff(states), [0, 1])) and states[0] == 0
        assert np.mean(np.argmax(posteriors, axis=1) == states) > 0.9
    assert model.score(demos) >= model.log_likelihood_ - 1e-6


def test_learning_goes_on_from_a_fitted_model() -> None:
    demos = demonstrations(SMALL)
    for kind in (TPHMM, TPHSMM):
        model = kind(4, regularization="prior").fit(demos)
        again = kind(4, regularization="prior", init=model, max_iter=1).fit(demos)
        assert model.objectives_[-1] <= again.objectives_[0] <= model.objectives_[-1] + 1e-4
        mixture = TPGMM(4, init="bins").fit(demos)
        assert kind(4, init=mixture).fit(demos).log_likelihood_ > mixture.log_likelihood_


def test_a_learned_chain_meets_new_frames_as_a_mixture_does() -> None:
    demos = pose_demonstrations(4, n_samples=60)
    model = TPHMM(4, manifold="R1 x R3 x S3").fit(demos)
    frames = pose_demonstrations(1, seed=5)[0].frames
    mixture = model.adapt(frames)
    assert mixture.means.shape == (4, 8)
    assert mixture.condition([0], [0.5]).mean.shape == (7,)
    np.testing.assert_allclose(Adapter(model).adapt(frames).means, mixture.means)


@pytest.mark.parametrize(
    ("kind", "params", "message"),
    [
        (TPHMM, {"transitions": "circular"}, "left-right"),
        (TPHMM, {"transitions": -np.eye(3)}, "shape"),
        (TPHSMM, {"transitions": np.eye(3)}, "diagonal"),
        (TPHSMM, {"max_duration": 0}, "max_duration"),
        (TPHSMM, {"max_duration": 5}, "max_duration"),
        (TPHMM, {"covariance": "round"}, "round"),
        (TPHMM, {"n_components": 1000}, "1000"),
    ],
)
def test_bad_parameters_are_refused_by_fit(kind: type[TPHMM], params: dict[str, Any], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        kind(**params).fit(demonstrations(SMALL))


def test_lengths_and_states_are_checked() -> None:
    with pytest.raises(ValueError, match="sum to the 10"):
        TPHMM(2).fit_projected({"a": np.zeros((10, 1))}, lengths=[5, 4])
    with pytest.raises(ValueError, match="not fitted"):
        TPHMM().state_probabilities(5)


@pytest.mark.parametrize("covariance", ["full", "mfa"])
@pytest.mark.parametrize("kind", [TPHMM, TPHSMM])
def test_a_model_file_brings_the_chain_back(kind: type[TPHMM], covariance: str, tmp_path: Path) -> None:
    demos = demonstrations(SMALL)
    model = kind(4, covariance=covariance, reg_covar=1e-3).fit(demos)
    model.save(tmp_path / "m.tpgmm")
    loaded = kind.load(tmp_path / "m.tpgmm")
    assert loaded.get_params() == model.get_params()
    assert loaded.score(demos) == pytest.approx(model.score(demos), rel=1e-12)
    np.testing.assert_array_equal(loaded.transitions_, model.transitions_)
    np.testing.assert_array_equal(loaded.state_probabilities(70), model.state_probabilities(70))
    mixture = TPGMM.load(tmp_path / "m.tpgmm")
    np.testing.assert_array_equal(mixture.priors_, model.priors_)
    other = TPHSMM if kind is TPHMM else TPHMM
    with pytest.raises(ModelFileError, match=f"holds a model of the kind {kind.__name__}, no {other.__name__}"):
        other.load(tmp_path / "m.tpgmm")


def test_a_model_file_without_a_chain_or_with_a_wrong_one_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "m.tpgmm"
    demos = demonstrations(SMALL)
    TPGMM(4).fit(demos).save(path)
    with pytest.raises(ModelFileError, match="holds a model of the kind TPGMM"):
        TPHMM.load(path)
    model = TPHMM(4).fit(demos)
    for chain in (np.eye(3), 2.0 * np.eye(4)):
        model.chain_ = MarkovChain(model.start_probabilities_, chain)
        model.save(path)
        with pytest.raises(ModelFileError, match="m.tpgmm: .* chain"):
            TPHMM.load(path)


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize("kind", [TPHMM, TPHSMM])
@pytest.mark.parametrize("lengths", [[50], [5, 80, 33], [3, 2], [1, 1, 1]])
@pytest.mark.parametrize("spoil", ["nothing", "constant dimension", "repeated sample"])
def test_awkward_data_gives_a_finite_model_or_says_what_is_wrong(
    kind: type[TPHMM], lengths: list[int], spoil: str
) -> None:
    rng = np.random.default_rng(4)
    x = np.cumsum(rng.normal(size=(sum(lengths), 3)), axis=0)
    if spoil == "constant dimension":
        x[:, 1] = 2.0
    elif spoil == "repeated sample":
        x[:] = x[0]
    for init, transitions, K in (("bins", "left-right", 3), ("kmeans", "ergodic", 2), ("bins", "ergodic", 6)):
        try:
            model = kind(K, init=init, transitions=transitions).fit_projected({"a": x}, lengths=lengths)
        except ValueError as error:
            assert "samples" in str(error)
            continue
        assert np.isfinite(model.log_likelihood_) and np.all(np.isfinite(model.covariances_["a"]))
        assert np.all(np.isfinite(model.transitions_)) and np.all(np.isfinite(model.state_probabilities(20)))
