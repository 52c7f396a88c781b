# SPDX-License-Identifier: Apache-2.0
"""The direction in which too little is known: found, measured, and told from one that the task leaves free."""

from __future__ import annotations

import math

import numpy as np
import pytest

from reaching import frames_at, place, reaching_model
from tpgmm_core.geometry import quaternion
from tpgmm_core.geometry.manifold import POSE, Manifold
from tpgmm_core.model.adaptation import UNCONSTRAINED_VARIANCE
from tpgmm_core.retrieval.knowledge import KnowledgeConfig, least_known
from tpgmm_core.retrieval.regression import AdaptThenRegress

LIMITS = KnowledgeConfig(unknown_ratio=5.0)
TASK = np.diag(np.square([0.002, 0.002, 0.002, 0.01, 0.01, 0.01]))


def turned(deviations: list[float], turn: np.ndarray) -> np.ndarray:
    R = quaternion.rotation_matrix(quaternion.exp(turn))
    return R @ np.diag(np.square(deviations)) @ R.T


def test_the_direction_that_is_not_known_is_found_wherever_it_points() -> None:
    turn = np.array([0.3, -0.8, 0.5])
    present = TASK.copy()
    present[:3, :3] = turned([0.002, 0.052, 0.004], turn)
    found = least_known(TASK, present, POSE, LIMITS)
    expected = quaternion.rotation_matrix(quaternion.exp(turn))[:, 1]
    assert found.kind == "position" and abs(found.direction @ expected) == pytest.approx(1.0)
    assert (found.present, found.complete) == pytest.approx((0.052, 0.002))
    assert found.excess == pytest.approx(0.052 / 0.03)  # the limit of 30 mm comes after the ratio of 5


@pytest.mark.parametrize(
    ("complete", "present", "is_unknown"),
    [
        (0.002, 0.031, True),
        (0.002, 0.029, False),  # known to 29 mm, which is enough although it was much better
        (0.010, 0.049, False),
        (0.010, 0.051, True),
        (0.300, 1.400, False),  # the task leaves it free, as its frames do
        (1e3, 1e3, False),
    ],
)
def test_a_direction_is_unknown_above_the_ratio_and_above_the_limit(
    complete: float, present: float, is_unknown: bool
) -> None:
    covariances = [TASK.copy(), TASK.copy()]
    for S, deviation in zip(covariances, (complete, present), strict=True):
        S[2, 2] = deviation**2
    assert (least_known(*covariances, POSE, LIMITS).excess > 1.0) is is_unknown


def test_it_is_said_in_units_and_axes_that_people_know() -> None:
    present = TASK.copy()
    present[2, 2] = 0.052**2
    assert least_known(TASK, present, POSE, LIMITS).words() == ("to 52 mm along z", "2 mm")
    present = TASK.copy()
    present[3:, 3:] = turned([0.01, 0.01, math.radians(31.0)], np.array([0.0, math.pi / 4, 0.0]))
    there, with_all = least_known(TASK, present, POSE, LIMITS).words()
    assert there.startswith("to 31 deg about (") and "0.71, 0.00, " in there and with_all == "0.57 deg"
    assert least_known(TASK, UNCONSTRAINED_VARIANCE * np.eye(6), POSE, LIMITS).words()[0].startswith("not at all a")
    joints = Manifold.euclidean(2)
    found = least_known(0.01**2 * np.eye(2), np.diag([1e-4, 0.2**2]), joints, LIMITS)
    assert found.words() == ("to 0.2 rad or m along joint 2", "0.01 rad or m")


def test_a_model_knows_the_end_without_the_frame_of_its_start_and_not_without_its_object() -> None:
    course = AdaptThenRegress(reaching_model())
    frames = frames_at(start=place(0.02, -0.03, 0.2), object=place(0.5, 0.02, -0.2))
    at_end = np.array([0.95 * course.duration])

    def covariance(*names: str) -> np.ndarray:
        course.situate({name: frames[name] for name in names})
        return course.at(at_end)[1][0]

    complete = covariance("start", "object")
    assert least_known(complete, covariance("object"), POSE, LIMITS).excess < 0.5
    found = least_known(complete, covariance("start"), POSE, LIMITS)
    assert found.excess > 1.0 and found.present > 8.0 * found.complete


def test_what_cannot_be_compared_is_refused() -> None:
    with pytest.raises(ValueError, match=r"R3 x S3 have shape \(6, 6\), got \(3, 3\)"):
        least_known(TASK[:3, :3], TASK, POSE, LIMITS)
    with pytest.raises(ValueError, match="position with all frames is not positive definite"):
        least_known(np.zeros((6, 6)), TASK, POSE, LIMITS)
    with pytest.raises(ValueError, match="unknown_position is 0.0, expected"):
        KnowledgeConfig(unknown_position=0.0)
