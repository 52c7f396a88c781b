# SPDX-License-Identifier: Apache-2.0
from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tpgmm_core import TPGMM
from tpgmm_core.common.types import Array
from tpgmm_core.learning.covariance.factor_analyzers import PrincipalComponentAnalyzers
from tpgmm_core.learning.dp_means import DPMeans
from tpgmm_core.learning.estimation.em import expectation
from tpgmm_core.learning.hidden_markov.hmm import TPHMM
from tpgmm_core.model.samples import Samples
from workloads import pose_demonstrations


def same_partition(a: Array, b: Array) -> bool:
    """Whether two labellings group the samples alike."""
    return len(set(zip(a.tolist(), b.tolist(), strict=True))) == len(set(a.tolist())) == len(set(b.tolist()))


def cost(X: dict[str, Array], seen: dict[str, Array], clusters: DPMeans) -> float:
    """The cost from its definition, with subspaces by singular values."""
    total = clusters.penalty * clusters.n_components_
    for name, x in X.items():
        x = (x - x[seen[name]].mean(axis=0)) / x[seen[name]].std(axis=0)
        for k, d in enumerate(clusters.dimensions_[name]):
            members = x[seen[name] & (clusters.labels_ == k)]
            total += (clusters.dimension_penalty or 0.0) * d
            if len(members):
                total += np.sum(np.linalg.svd(members - members.mean(axis=0), compute_uv=False)[d:] ** 2)
    return float(total)


@settings(max_examples=40)
@given(
    seed=st.integers(0, 2**32 - 1),
    dims=st.lists(st.integers(1, 4), min_size=1, max_size=3),
    N=st.integers(2, 300),
    hidden=st.floats(0.0, 0.6),
    penalty=st.floats(0.05, 50.0),
    dimension_penalty=st.none() | st.floats(0.05, 50.0),
)
def test_the_cost_never_rises_and_is_what_it_says(
    seed: int, dims: list[int], N: int, hidden: float, penalty: float, dimension_penalty: float | None
) -> None:
    rng = np.random.default_rng(seed)
    centres = 3.0 * rng.normal(size=(4, sum(dims)))
    x = centres[rng.integers(4, size=N)] + rng.normal(size=(N, sum(dims)))
    X = {f"frame_{j}": part for j, part in enumerate(np.split(x, np.cumsum(dims)[:-1], axis=1))}
    visible = {name: rng.random(N) >= hidden for name in X}
    for mask in visible.values():
        mask[:2] = True
    clusters = DPMeans(penalty, dimension_penalty).fit_projected(X, visible)
    assert clusters.converged_
    assert np.diff(clusters.costs_).max(initial=0.0) <= 1e-9 * clusters.costs_[0]
    assert clusters.costs_[-1] == pytest.approx(cost(X, visible, clusters), rel=1e-9)
    assert set(clusters.labels_) == set(range(clusters.n_components_))


def test_no_sample_is_farther_than_the_root_of_the_penalty_from_its_cluster() -> None:
    x = np.random.default_rng(1).normal(size=(300, 3))
    clusters = DPMeans(penalty=0.5).fit_projected({"a": x})
    scaled = (x - x.mean(axis=0)) / x.std(axis=0)
    centres = np.stack([scaled[clusters.labels_ == k].mean(axis=0) for k in range(clusters.n_components_)])
    assert np.sum((scaled - centres[clusters.labels_]) ** 2, axis=1).max() <= 0.5


def test_frames_that_see_different_groups_find_all_of_them_together() -> None:
    rng = np.random.default_rng(2)
    group = rng.integers(4, size=400)
    X = {
        "tells_halves": np.array([0.0, 0.0, 9.0, 9.0])[group, None] + 0.1 * rng.normal(size=(400, 2)),
        "tells_parity": np.array([0.0, 9.0, 0.0, 9.0])[group, None] + 0.1 * rng.normal(size=(400, 3)),
    }
    clusters = DPMeans(penalty=2.0).fit_projected(X)
    assert clusters.n_components_ == 4 and same_partition(clusters.labels_, group)


def test_subspaces_of_different_dimension_are_found_with_their_number() -> None:
    rng = np.random.default_rng(3)
    parts = []
    for dim in (0, 1, 1, 2):
        basis = np.linalg.qr(rng.normal(size=(5, 3)))[0][:, :dim]
        parts.append(6.0 * rng.normal(size=5) + 3.0 * rng.normal(size=(200, dim)) @ basis.T)
    x = np.concatenate(parts) + 0.05 * rng.normal(size=(800, 5))
    clusters = DPMeans(penalty=5.0, dimension_penalty=2.0).fit_projected({"a": x})
    assert sorted(clusters.dimensions_["a"]) == [0, 1, 1, 2]
    plain = DPMeans(penalty=5.0).fit_projected({"a": x})
    assert plain.n_components_ > 4  # points need many clusters where a line needs one
    order = np.repeat(np.arange(4), 200)
    agree = sum(np.bincount(clusters.labels_[order == k]).max() for k in range(4))
    assert agree >= 0.97 * 800


def test_the_labels_start_em() -> None:
    demos = pose_demonstrations(3, n_samples=50)
    clusters = DPMeans(penalty=5.0, manifold="R1 x R3 x S3").fit(demos)
    model = TPGMM(clusters.n_components_, init=clusters.labels_, manifold="R1 x R3 x S3").fit(demos)
    assert len(model.priors_) == clusters.n_components_ > 1 and np.isfinite(model.log_likelihood_)


def lines_and_planes(rng: np.random.Generator, *counts: int) -> list[dict[str, Array]]:
    """Samples of a point, two lines and a plane, with noise, as two frames see them."""
    found: list[dict[str, Array]] = [{} for _ in counts]
    for frame, dims in {"a": (0, 1, 1, 2), "b": (1, 1, 0, 2)}.items():
        bases = [np.linalg.qr(rng.normal(size=(5, 3)))[0][:, :dim] for dim in dims]
        centres = 8.0 * rng.normal(size=(4, 5))
        for view, count in zip(found, counts, strict=True):
            parts = [c + 3.0 * rng.normal(size=(count, B.shape[1])) @ B.T for c, B in zip(centres, bases, strict=True)]
            view[frame] = np.concatenate(parts) + 0.05 * rng.normal(size=(4 * count, 5))
    return found


def test_the_dimensions_that_are_found_enter_the_model_one_per_component_and_frame(tmp_path: Path) -> None:
    shown, unseen = lines_and_planes(np.random.default_rng(3), 40, 500)
    clusters = DPMeans(penalty=4.0, dimension_penalty=2.0).fit_projected(shown)
    assert sorted(zip(clusters.dimensions_["a"], clusters.dimensions_["b"], strict=True)) == [
        (0, 1),
        (1, 0),
        (1, 1),
        (2, 2),
    ]
    rules: dict[str, Any] = {"init": clusters.labels_, "covariance": "mppca", "reg_covar": 1e-6, "tol": 0.0}
    model = TPGMM(4, n_factors=clusters.dimensions_, max_iter=20, **rules).fit_projected(shown)
    sizes = 0
    for name, frame in model.emissions_.frames.items():
        assert isinstance(frame, PrincipalComponentAnalyzers)
        np.testing.assert_array_equal(frame.dimensions, clusters.dimensions_[name])
        for k, d in enumerate(clusters.dimensions_[name]):  # as many directions stand out of the noise
            values = np.linalg.eigvalsh(model.covariances_[name][k])
            np.testing.assert_allclose(values[: 5 - d], frame.noise[k, 0], rtol=1e-9)
            assert np.all(values[5 - d :] > 10.0 * values[0])
            sizes += 5 + (5 * d - d * (d - 1) // 2) + 1
    assert model.n_parameters_ == sizes + 3
    assert np.diff(model.objectives_).min() > -1e-9 * np.abs(model.objectives_).max()

    def score(other: TPGMM) -> float:
        samples = Samples.from_projected(unseen, None, "euclidean")
        return expectation(other.priors_, other.emissions_, samples)[1] / samples.n_samples

    for d in (1, 2, 4):  # the same number everywhere is too few, or too many
        assert score(model) > score(TPGMM(4, n_factors=d, max_iter=20, **rules).fit_projected(shown))
    model.save(tmp_path / "model")
    loaded = TPGMM.load(tmp_path / "model")
    assert loaded.n_parameters_ == model.n_parameters_ and score(loaded) == pytest.approx(score(model), rel=1e-12)
    again = TPGMM(4, **{**rules, "init": loaded}, n_factors=loaded.n_factors, max_iter=1).fit_projected(shown)
    assert again.log_likelihoods_[0] >= model.log_likelihood_ - 1e-9


def test_numbers_of_factors_that_do_not_fit_are_refused_in_words() -> None:
    x = {"a": np.random.default_rng(0).normal(size=(30, 3))}
    rules: dict[str, Any] = {"covariance": "mppca", "init": np.arange(30) % 2}
    for numbers in ([1], [1, 3], [-1, 1], [1.0, 1.0]):
        with pytest.raises(ValueError, match="n_factors of frame 'a' are 2 integers from 0 to 2, got"):
            TPGMM(2, n_factors={"a": numbers}, **rules).fit_projected(x)
    with pytest.raises(ValueError, match=r"n_factors of frame 'a' .* got \[\]"):
        TPGMM(2, n_factors={"b": [1, 1]}, **rules).fit_projected(x)
    for kind, more in ((TPGMM, {"covariance": "mfa"}), (TPGMM, {"init": "bins"}), (TPGMM, {"n_init": 2}), (TPHMM, {})):
        with pytest.raises(ValueError, match='are for TPGMM, covariance "mppca", and one start from labels'):
            kind(2, n_factors={"a": [1, 1]}, **{**rules, **more}).fit_projected(x)


def test_the_suggested_penalty_gives_about_the_components_asked_for() -> None:
    demos = pose_demonstrations(3, n_samples=50)
    numbers = []
    for K in (3, 6, 12):
        penalty = DPMeans.suggested_penalty(K, demos, "R1 x R3 x S3")
        numbers.append(DPMeans(penalty, manifold="R1 x R3 x S3").fit(demos).n_components_)
    assert numbers == sorted(numbers) and all(0.3 * K <= n <= 2 * K for n, K in zip(numbers, (3, 6, 12), strict=True))
    with pytest.raises(ValueError, match="n_components"):
        DPMeans.suggested_penalty(0, demos)


def test_the_order_of_the_samples_does_not_matter() -> None:
    rng = np.random.default_rng(4)
    x = rng.normal(size=(200, 2))
    order = rng.permutation(200)
    a, b = (DPMeans(0.4, 3.0).fit_projected({"a": y}) for y in (x, x[order]))
    assert same_partition(a.labels_[order], b.labels_)


def test_identical_samples_are_one_cluster() -> None:
    clusters = DPMeans(penalty=0.1).fit_projected({"a": np.ones((20, 3))})
    assert clusters.n_components_ == 1 and clusters.costs_[-1] == pytest.approx(0.1)


def test_bad_arguments_are_refused_with_the_reason() -> None:
    x = {"a": np.zeros((5, 2))}
    with pytest.raises(ValueError, match="^penalty is a finite number above 0"):
        DPMeans(penalty=0.0).fit_projected(x)
    with pytest.raises(ValueError, match="dimension_penalty"):
        DPMeans(dimension_penalty=-1.0).fit_projected(x)
    with pytest.raises(ValueError, match="max_iter"):
        DPMeans(max_iter=0).fit_projected(x)
    assert repr(DPMeans(2.0, max_iter=7)) == "DPMeans(penalty=2.0, max_iter=7)"
