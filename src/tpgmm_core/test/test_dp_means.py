# SPDX-License-Identifier: Apache-2.0
from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tpgmm_core import TPGMM
from tpgmm_core.common.types import Array
from tpgmm_core.learning.dp_means import DPMeans
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


@settings(max_examples=40, deadline=None)
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
