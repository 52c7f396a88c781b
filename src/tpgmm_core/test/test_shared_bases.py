# SPDX-License-Identifier: Apache-2.0
"""Bases (synergies) of one task that another one is learned with: exact values, and what they are good for."""

from __future__ import annotations

import copy
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from random_problems import random_covariance
from tpgmm_core import TPGMM, Demonstration
from tpgmm_core.common.types import Array
from tpgmm_core.learning.covariance.semi_tied import SemiTiedCovariances
from tpgmm_core.learning.covariance.structure import Structure
from tpgmm_core.learning.estimation.em import expectation
from tpgmm_core.learning.hidden_markov.hmm import TPHMM
from tpgmm_core.learning.hidden_markov.hsmm import TPHSMM
from tpgmm_core.learning.incremental.online import OnlineTPGMM
from tpgmm_core.learning.shared_bases import transforms_of
from tpgmm_core.model.samples import Samples
from workloads import pose_demonstrations

DIMS = {"a": 5, "b": 4}
K = 3


class RelatedTasks:
    """Tasks of K clusters in two frames, whose covariances share one basis per frame, and nothing else."""

    def __init__(self, seed: int) -> None:
        self.rng = np.random.default_rng(seed)
        self.bases = {name: self.rng.normal(size=(n, n)) for name, n in DIMS.items()}

    def task(self, *counts: int) -> list[dict[str, Array]]:
        """Views of one new task, one of each number of samples; sample i is of cluster i % K."""
        means = {name: 8.0 * self.rng.normal(size=(K, n)) for name, n in DIMS.items()}
        spreads = {name: np.exp(self.rng.uniform(-1.5, 1.0, size=(K, n))) for name, n in DIMS.items()}
        found = []
        for N in counts:
            k = np.arange(N) % K
            found.append(
                {
                    name: means[name][k] + (spreads[name][k] * self.rng.normal(size=(N, n))) @ self.bases[name].T
                    for name, n in DIMS.items()
                }
            )
        return found


def learned(X: dict[str, Array], **settings: Any) -> TPGMM:
    labels = np.arange(len(X["a"])) % K
    return TPGMM(K, **{"init": labels, "reg_covar": 1e-8, "covariance": "semi_tied", **settings}).fit_projected(X)


def score(model: TPGMM, X: dict[str, Array]) -> float:
    samples = Samples.from_projected(X, None, "euclidean")
    return expectation(model.priors_, model.emissions_, samples)[1] / samples.n_samples


def transforms(model: TPGMM) -> dict[str, Array]:
    return {name: frame.arrays()["transform"] for name, frame in model.emissions_.frames.items()}


def assert_bases_are_those_of(model: TPGMM, other: TPGMM) -> None:
    """To the last bit."""
    for name, A in transforms(model).items():
        np.testing.assert_array_equal(A, transforms(other)[name])


def test_the_variances_on_a_given_basis_are_the_likeliest_ones() -> None:
    rng = np.random.default_rng(0)
    A, counts = rng.normal(size=(4, 4)), np.array([3.0, 5.0])
    scatters = np.stack([random_covariance(rng, 4) for _ in counts])
    structure = Structure("semi_tied", fixed_bases=True)
    begun = SemiTiedCovariances(structure, A, np.ones((2, 4)))
    found = begun.maximised(counts, scatters)
    assert found.transform is A
    expected = [np.diagonal(A @ S @ A.T) for S in scatters]  # diag(A S_k A^T), Gales 1999
    np.testing.assert_allclose(found.variances, expected, rtol=1e-13)

    def objective(variances: Array) -> float:
        some = SemiTiedCovariances(structure, A, variances)
        inverses = np.linalg.inv(some.dense())
        return float(-0.5 * counts @ (some.log_determinants + np.einsum("kij,kji->k", inverses, scatters)))

    best = objective(found.variances)
    for i, k in np.ndindex(4, 2):
        for factor in (0.99, 1.01):
            moved = found.variances.copy()
            moved[k, i] *= factor
            assert objective(moved) < best


@settings(max_examples=12)
@given(seed=st.integers(0, 2**32 - 1), is_prior=st.booleans(), share=st.sampled_from([0.0, 0.3]))
def test_the_likelihood_never_falls_and_the_bases_stay_bit_by_bit(seed: int, is_prior: bool, share: float) -> None:
    tasks = RelatedTasks(seed)
    (X,) = tasks.task(90)
    visible = {name: tasks.rng.uniform(size=90) >= share for name in X}
    given_bases = {name: tasks.rng.normal(size=(n, n)) for name, n in DIMS.items()}  # of any other task
    rules: dict[str, Any] = {"regularization": "prior", "reg_covar": 1e-3} if is_prior else {"reg_covar": 0.0}
    model = TPGMM(
        4, init="kmeans", tol=0.0, max_iter=25, covariance="semi_tied", bases=given_bases, **rules
    ).fit_projected(X, visible)  # fmt: skip
    course = model.objectives_
    assert np.diff(course).min(initial=0.0) > -1e-9 * max(1.0, np.abs(course).max())
    for name, A in transforms(model).items():
        np.testing.assert_array_equal(A, given_bases[name])
        inner = A @ model.covariances_[name] @ A.T  # diagonal
        np.testing.assert_allclose(inner, inner * np.eye(len(A)), atol=1e-6 * np.abs(inner).max())


def test_only_the_variances_are_counted() -> None:
    tasks = RelatedTasks(1)
    (X,), (Y,) = tasks.task(300), tasks.task(60)
    other = learned(X)
    means_and_priors = K * sum(DIMS.values()) + K - 1
    assert other.n_parameters_ == means_and_priors + sum(n * (n - 1) + K * n for n in DIMS.values())
    assert learned(Y, bases=other).n_parameters_ == means_and_priors + K * sum(DIMS.values())


def test_the_bases_of_one_task_serve_another_one_of_which_little_was_shown() -> None:
    gains = []
    for seed in range(5):
        tasks = RelatedTasks(seed)
        (before,), (few, unseen) = tasks.task(1500), tasks.task(30, 2000)
        other = learned(before)
        model = learned(few, bases=other)
        assert_bases_are_those_of(model, other)
        ours = score(model, unseen)
        gains.append([ours - score(learned(few, covariance=c), unseen) for c in ("full", "semi_tied", "diag")])
    assert np.min(gains) > 0.2, gains  # nats per sample, against each of the others, in each of the five
    assert np.median(gains, axis=0).min() > 1.0, gains


def test_where_much_was_shown_bases_of_a_task_that_is_not_related_are_worse() -> None:
    (other,), (many, unseen) = RelatedTasks(0).task(1500), RelatedTasks(1).task(1500, 2000)
    assert score(learned(many, bases=learned(other)), unseen) < score(learned(many), unseen) - 0.5


def test_the_end_of_a_movement_is_learned_with_the_synergies_of_its_beginning() -> None:
    halves = [
        [Demonstration(d.times[part] - d.times[part][0], d.data[part] - start, d.frames) for d in demonstrations]
        for demonstrations in [pose_demonstrations(10, n_samples=60)]
        for part, start in ((slice(0, 30), 0.0), (slice(30, 60), np.eye(8)[0] * demonstrations[0].data[30, 0]))
    ]
    rules: dict[str, Any] = {"manifold": "R1 x R3 x S3", "reg_covar": 1e-6, "covariance": "semi_tied"}
    other = TPGMM(3, **rules).fit(halves[0])
    few, unseen = halves[1][:2], halves[1][2:]
    with_bases, without = TPGMM(3, bases=other, **rules).fit(few), TPGMM(3, **{**rules, "covariance": "full"}).fit(few)
    assert_bases_are_those_of(with_bases, other)
    assert with_bases.score(unseen) > without.score(unseen) + 1.0


@pytest.mark.parametrize("kind", [TPGMM, TPHMM, TPHSMM, OnlineTPGMM])
def test_every_kind_of_mixture_takes_bases_and_a_file_keeps_them(kind: type[TPGMM], tmp_path: Path) -> None:
    demos = pose_demonstrations(6, n_samples=40)
    rules: dict[str, Any] = {"manifold": "R1 x R3 x S3", "covariance": "semi_tied", "max_iter": 20}
    other = TPGMM(4, **rules).fit(demos[:3])
    model = kind(3, bases=other, **rules).fit(demos[3:])
    assert_bases_are_those_of(model, other)
    model.save(tmp_path / "model")
    loaded = kind.load(tmp_path / "model")
    assert loaded.emissions_.structure.fixed_bases and loaded.n_parameters_ == model.n_parameters_
    assert loaded.score(demos) == pytest.approx(model.score(demos), rel=1e-12)
    assert_bases_are_those_of(loaded, other)
    assert "<array of shape (7, 7)>" in repr(loaded)
    assert_bases_are_those_of(loaded.fit(demos), other)
    if isinstance(loaded, OnlineTPGMM):
        for demo in pose_demonstrations(12, n_samples=40, seed=5):  # beyond the number of dimensions it goes on
            assert_bases_are_those_of(loaded.partial_fit([demo]), other)
        far = Demonstration(demos[0].times, demos[0].data + 20.0 * np.eye(8)[1], demos[0].frames)
        before = len(loaded.priors_)
        assert_bases_are_those_of(loaded.partial_fit([far]), other)
        assert len(loaded.priors_) > before, "no new component was made on the bases"


def test_learning_goes_on_from_a_model_with_these_or_other_bases() -> None:
    tasks = RelatedTasks(2)
    (X,), (Y,) = tasks.task(300), tasks.task(300)
    one, two = learned(X), learned(Y)
    begun = learned(Y, bases=one, tol=1e-9)
    again = learned(Y, bases=one, init=begun)
    assert again.log_likelihoods_[0] >= begun.log_likelihood_ - 1e-9
    assert_bases_are_those_of(learned(Y, bases=one, init=two), one)
    freed = learned(Y, init=begun, max_iter=100)
    assert freed.log_likelihood_ > begun.log_likelihood_ and not freed.emissions_.structure.fixed_bases


def test_the_other_model_may_change_afterwards() -> None:
    tasks = RelatedTasks(3)
    (X,), (Y,) = tasks.task(100), tasks.task(100)
    other = learned(X)
    model, kept = learned(Y, bases=other), copy.deepcopy(transforms(other))
    transforms(other)["a"][:] = 0.0
    np.testing.assert_array_equal(transforms(model)["a"], kept["a"])


def test_a_file_without_fixed_bases_is_as_earlier_versions_wrote_it(tmp_path: Path) -> None:
    (X,) = RelatedTasks(4).task(60)
    for name, settings_, is_there in (("own", {}, False), ("given", {"bases": learned(X)}, True)):
        learned(X, **settings_).save(tmp_path / name)
        with np.load(tmp_path / name) as archive:
            assert (b"fixed_bases" in archive["model.json"].tobytes()) is is_there


def test_what_gives_no_bases_is_refused_in_words() -> None:
    tasks = RelatedTasks(5)
    (X,) = tasks.task(60)
    other = learned(X)
    poses = TPGMM(2, manifold="R1 x R3 x S3", covariance="semi_tied").fit(pose_demonstrations(3, n_samples=40))
    for bases, reason in (
        (learned(X, covariance="full"), "has full covariances"),
        (TPGMM(2), "not fitted"),
        (poses, "no bases for a, b; there are some for"),
        ({"a": np.eye(5)}, "no bases for b; there are some for a"),
        ({"a": np.eye(5), "b": np.eye(5)}, r"frame 'b' is a regular matrix \(4, 4\), got \(5, 5\)"),
        ({"a": np.eye(5), "b": np.zeros((4, 4))}, "regular"),
        ({"a": np.full((5, 5), np.nan), "b": np.eye(4)}, "regular"),
        ("other.tpgmm", "a model with semi-tied covariances, or one matrix per frame"),
    ):
        with pytest.raises(ValueError, match=reason):
            learned(X, bases=bases)
    with pytest.raises(ValueError, match="bases are of covariance \"semi_tied\", got 'mfa'"):
        learned(X, bases=other, covariance="mfa")
    flat = {name: TPGMM(1, covariance="semi_tied").fit_projected({name: np.eye(8, 7) + 0.1}) for name in poses.means_}
    with pytest.raises(ValueError, match="sees R1 x R3 x S3, but R7 in the model"):
        transforms_of(next(iter(flat.values())), dict.fromkeys(list(poses.means_)[:1], poses.manifold_))
    with pytest.raises(ValueError, match="may hold scree_threshold, layers, got"):
        learned(X, covariance_options={"fixed_bases": True})
