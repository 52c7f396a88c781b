# SPDX-License-Identifier: Apache-2.0
from __future__ import annotations

import numpy as np
import pytest

from tpgmm_core import Manifold
from tpgmm_core.learning.estimation.initialization import equal_bins, joint_points, kmeans, time_bins

rng = np.random.default_rng(0)


def test_time_bins_are_half_open_and_leave_out_the_last_sample() -> None:
    np.testing.assert_array_equal(time_bins(np.array([0.0, 0.9, 1.0, 1.9, 2.0, 2.9, 3.0]), 3), [0, 0, 1, 1, 2, 2, -1])


def test_equal_bins_cut_every_demonstration() -> None:
    np.testing.assert_array_equal(equal_bins([6, 3], 3), [0, 0, 1, 1, 2, 2, 0, 1, 2])


def test_kmeans_finds_separate_groups_in_any_order() -> None:
    group = rng.integers(4, size=200)
    points = 10.0 * np.eye(4)[group] + rng.normal(size=(200, 4))
    labels = kmeans(points, 4, random_state=1)
    assert all(len(set(labels[group == g])) == 1 for g in range(4)) and set(labels) == set(range(4))


def test_kmeans_leaves_no_component_empty() -> None:
    points = np.repeat(rng.normal(size=(8, 2)), 30, axis=0)
    assert set(kmeans(points, 8, random_state=0)) == set(range(8))
    with pytest.raises(ValueError, match="fewer distinct samples"):
        kmeans(points, 9, random_state=0)


def test_joint_points_compare_seconds_with_metres_and_ignore_what_was_not_seen() -> None:
    x = np.column_stack([1000.0 * rng.normal(size=50), 0.001 * rng.normal(size=50)])
    seen = np.ones((1, 50), dtype=bool)
    seen[0, :10] = False
    points = joint_points([Manifold.euclidean(2)], [x], seen)
    np.testing.assert_allclose(points[10:].std(axis=0), 1.0)
    assert not points[:10].any()
