# SPDX-License-Identifier: Apache-2.0
"""A product that does not exist is refused with the true reason; where only the numbers are large, it exists."""

from __future__ import annotations

import functools
import re

import numpy as np
import pytest

from tpgmm_core import TPGMM, Demonstration, Frame, Gaussian
from tpgmm_core.geometry import quaternion
from tpgmm_core.geometry.disagreement import disagreement
from tpgmm_core.geometry.manifold import POSE
from tpgmm_core.retrieval.regression import AdaptThenRegress, RegressThenProduct

METHODS = [AdaptThenRegress, RegressThenProduct]
ROBOT = Frame.from_pose(np.zeros(3), [0.0, 0.0, 0.0, 1.0]).with_time()
OBJECT = np.array([0.6, 0.0, 0.1])


def turned(angle: float) -> np.ndarray:
    return quaternion.exp([0.0, 0.0, angle])


def demonstration(seed: int, start: float, away: np.ndarray) -> Demonstration:
    """A reach to an object that turns with it, in a world of other times and places."""
    rng, share = np.random.default_rng(seed), np.linspace(0.0, 1.0, 60)
    share = share**3 * (10.0 - 15.0 * share + 6.0 * share**2)
    goal, yaw, home = OBJECT + rng.uniform(-0.2, 0.2, 3), rng.uniform(-0.8, 0.8), np.array([0.4, 0.3, 0.5])
    places = away + home + share[:, None] * (goal - home) + 0.001 * rng.normal(size=(60, 3))
    times = start + np.linspace(0.0, 4.0, 60)
    data = np.column_stack([times, places, [turned(yaw * u) for u in share]])
    place = Frame.from_pose(away + goal, turned(yaw)).with_time()
    return Demonstration(times, data, {"object": place, "robot": ROBOT})


@functools.cache
def model(start: float = 0.0, away: tuple[float, float, float] = (0.0, 0.0, 0.0)) -> TPGMM:
    demonstrations = [demonstration(seed, start, np.array(away)) for seed in range(6)]
    return TPGMM(4, reg_covar=1e-5, manifold="R1 x R3 x S3").fit(demonstrations)


def situation(place: np.ndarray, yaw: float = 0.3) -> dict[str, Frame]:
    return {"object": Frame.from_pose(place, turned(yaw)).with_time(), "robot": ROBOT}


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize(
    ("start", "away", "tolerance"),
    [
        (1.75e9, (0.0, 0.0, 0.0), 1e-5),  # seconds since 1970, which are known to 2e-7
        (0.0, (448262.13, 4427757.24, 650.0), 1e-6),  # a map's coordinates, to 1e-9
        (1.75e9, (448262.13, 4427757.24, 650.0), 1e-5),
    ],
)
def test_large_times_and_coordinates_give_what_small_ones_give(
    method: type, start: float, away: tuple[float, float, float], tolerance: float
) -> None:
    near = method(model()).retrieve(situation(OBJECT), [2.0, 4.0])
    far = method(model(start, away)).retrieve(situation(OBJECT + away), [start + 2.0, start + 4.0])
    for a, b in zip(near, far, strict=True):
        np.testing.assert_allclose(b.mean[:3] - away, a.mean[:3], atol=tolerance)
        assert quaternion.angle_between(a.mean[3:], b.mean[3:]) < tolerance
        np.testing.assert_allclose(b.covariance, a.covariance, rtol=1e-3, atol=1e-8)


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("distance", [10.0, 100.0])
def test_an_object_far_away_is_refused_by_its_distance(method: type, distance: float) -> None:
    with pytest.raises(ValueError, match="dependence of the orientation on the position") as error:
        for direction in np.vstack([np.eye(3), -np.eye(3)]):  # some of them may agree
            method(model()).retrieve(situation(OBJECT + distance * direction), [2.0, 3.0, 4.0])
    found = re.search(r"what 'object' and 'robot' expect is ([\d.e+]+) m apart, ([\d.]+) standard", str(error.value))
    assert found is not None, error.value
    assert float(found[1]) == pytest.approx(distance, rel=0.1) and float(found[2]) > 10.0


def test_what_contradicts_most_is_said() -> None:
    sure = np.diag([1e-4] * 3 + [1e-2] * 3)
    home = Gaussian([0.0, 0.0, 0.0, *turned(0.0)], sure, POSE)
    for place, angle, words in (
        (
            0.02,
            2.0,
            "what 'a' and 'b' expect differs by 115 deg in orientation, 14.1 standard deviations of what was learned",
        ),
        (3.0, 0.1, "what 'a' and 'b' expect is 3 m apart, 212.1 standard deviations of what was learned"),
        (3.0, 2.0, "(it also differs by 115 deg in orientation)"),
    ):
        other = Gaussian([place, 0.0, 0.0, *turned(angle)], sure, POSE)
        assert words in disagreement({"a": home, "b": other, "c": home})
    assert "'left'" in disagreement({"left": home, "right": home})
