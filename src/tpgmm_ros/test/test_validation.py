# SPDX-License-Identifier: Apache-2.0
"""Errors of reproductions, and what is replayed: by numbers that can be worked out by hand."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest

from tpgmm_core.geometry import quaternion
from tpgmm_ros.models.validation import path_errors, replay_nearest
from tpgmm_ros.recordings.bags import Recording


def test_the_sign_of_a_quaternion_is_no_error() -> None:
    path = np.tile([1.0, 2.0, 3.0, 0.0, 0.0, 0.6, 0.8], (20, 1))
    shown = path * [1, 1, 1, -1, -1, -1, -1]
    assert path_errors(path, shown) == path_errors(path, path)
    shown[:, 0] += 0.3
    assert path_errors(path, shown).position_rmse_m == pytest.approx(0.3)


def test_errors_that_change_along_the_path_are_squared_before_their_mean_is_taken() -> None:
    shown = np.tile([1.0, 2.0, 3.0, 0.0, 0.0, 0.0, 1.0], (20, 1))
    path = shown.copy()
    path[:10, 1] += 0.3
    path[10:, 2] -= 0.1
    path[:5, 3:] = quaternion.exp([0.2, 0.0, 0.0])
    errors = path_errors(path, shown)
    assert errors.position_rmse_m == pytest.approx(math.sqrt(0.05))  # the mean is 0.2
    assert errors.position_end_m == pytest.approx(0.1)
    assert errors.orientation_mean_deg == pytest.approx(math.degrees(0.05))
    assert errors.orientation_end_deg == pytest.approx(0.0, abs=1e-6)
    np.testing.assert_allclose(errors.position_by_tenth_m, [0.3] * 5 + [0.1] * 5)


def standing(place: Sequence[float], hand: Sequence[float]) -> Recording:
    """The hand rests at a place while the object, not turned, rests at another."""
    poses = {name: np.tile([*at, 0.0, 0.0, 0.0, 1.0], (5, 1)) for name, at in (("hand", hand), ("object", place))}
    return Recording(Path(), np.arange(5.0), poses["hand"], {"object": poses["object"]}, {"object": np.ones(5, bool)})


@pytest.mark.parametrize("order", [1, -1])
def test_what_is_replayed_is_the_demonstration_whose_frames_are_nearest(order: int) -> None:
    near, far, opposite = (standing([x, 0.0, 0.0], [x, 0.0, z]) for x, z in ((0.6, 0.1), (2.0, 0.2), (-0.5, 0.3)))
    others = [near, far, opposite][::order]
    path = replay_nearest(others, standing([0.5, 0.0, 0.0], [0.0, 0.0, 0.0]), "object")
    np.testing.assert_allclose(path[:, :3], np.tile([0.5, 0.0, 0.1], (5, 1)), atol=1e-12)
