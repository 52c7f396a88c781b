# SPDX-License-Identifier: Apache-2.0
"""One rule of what is a pose, whether it comes alone or in a recording; and clocks that are ahead."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tpgmm_core.observation.clocks import ENOUGH, LeadMeter
from tpgmm_core.observation.poses import check_pose, check_poses, doubtful_units, never_filled, wrong_frame
from tpgmm_core.observation.tracking import FrameTracker

POSE = [0.5, 0.1, 0.2, 0.0, 0.0, 0.0, 1.0]
NUMBERS = st.one_of(
    st.floats(), st.sampled_from([0.0, 1.0, -0.7, 5e-324, 1e8, -1.1e8, 1e200, np.inf, np.nan, 1e-3, 9e-4])
)


@given(st.lists(st.lists(NUMBERS, min_size=7, max_size=7), max_size=6))
def test_many_poses_are_judged_as_each_of_them(poses: list[list[float]]) -> None:
    found = check_poses(np.array(poses).reshape(-1, 7))
    alone = [check_pose(pose) for pose in poses]
    assert found.good.tolist() == [pose is not None for pose, _ in alone]
    kinds = [reason.split(":")[0] for pose, reason in alone if pose is None]
    assert {kind: count for kind, (count, _) in found.reasons.items()} == {kind: kinds.count(kind) for kind in kinds}
    for pose, (one, _) in zip(found.poses[found.good], [item for item in alone if item[0] is not None], strict=True):
        assert one is not None
        np.testing.assert_allclose(pose[:3], one[:3])
        assert abs(pose[3:] @ one[3:]) == pytest.approx(1.0)


@pytest.mark.parametrize(("frame_id", "is_right"), [("base", True), ("/base", True), ("", False), ("camera", False)])
def test_frame_ids_may_have_the_slash_of_ros_1(frame_id: str, is_right: bool) -> None:
    assert (wrong_frame(frame_id, "base") == "") is is_right
    if not is_right:
        assert wrong_frame(frame_id, "base").startswith(f"wrong frame_id: '{frame_id}', expected 'base'")


def test_magnitudes_that_look_like_millimetres_are_said() -> None:
    assert doubtful_units([[0.6, 0.2, 0.1]] * 5) == "" and doubtful_units(np.empty((0, 3))) == ""
    assert "millimetres" in doubtful_units([[600.0, 200.0, 100.0]] * 5)


# clocks


def leads(*seconds: float) -> list[float | None]:
    meter, found = LeadMeter(), []
    for k, lead in enumerate(seconds):
        now = 10**9 + k * 33_000_000
        stamp = meter.corrected(now + round(1e9 * lead), now)
        found.append(None if stamp is None else 1e-9 * (now - stamp))
    return found


def test_a_clock_that_is_steadily_ahead_is_corrected_once_that_is_known() -> None:
    found = leads(*([0.15, 0.14, 0.16] * 10))
    assert found[: ENOUGH - 1] == [None] * (ENOUGH - 1) and None not in found[ENOUGH - 1 :]
    assert all(0.0 <= age <= 0.05 for age in found[ENOUGH - 1 :] if age is not None), "never in the future again"


@pytest.mark.parametrize("seconds", [[0.15, 0.3] * 10, [5.0] * 20, [3600.0] * 20])
def test_a_lead_that_changes_or_is_another_clocks_is_not_corrected(seconds: list[float]) -> None:
    assert set(leads(*seconds)) == {None}


def test_the_tracker_takes_a_camera_whose_clock_is_ahead_and_says_so() -> None:
    frames, taken = FrameTracker(["object"]), 0
    for k in range(60):
        now = 10**12 + k * 33_000_000
        reason = frames.observe("object", POSE, now + 150_000_000, now, now)
        taken += reason is None
        assert reason is None or "stamp in the future: 0.150 s ahead" in reason
        assert frames.update(now)[0].stamp_ns <= now
    assert taken == 60 - ENOUGH + 1
    assert "its clock is 0.150 s ahead" in frames.health(now)["object"].notes[0]


def test_numbers_that_are_no_rotation_are_no_quaternion() -> None:
    """Angles in degrees or a rotation vector where a quaternion is expected; a length of 1.3 is one that was scaled."""
    poses = np.tile([0.5, 0.1, 0.2, 0.0, 0.0, 0.0, 1.3], (4, 1))
    poses[1, 3:], poses[2, 3:] = [0.0, 0.0, 46.0, 0.0], [0.0, 0.0, 0.3, 0.0]
    _, good, reasons = check_poses(poses)
    assert good.tolist() == [True, False, False, True]
    assert reasons["no quaternion"] == (2, f"number 1: {check_pose(poses[1])[1]}")
    assert "has length 46, expected 1; angles or a rotation vector" in check_pose(poses[1])[1]


@pytest.mark.parametrize("orientation", [[0.0, 0.0, 0.0, 1.0], [0.0, 0.0, 0.6, 0.8]])
def test_poses_of_empty_messages_are_no_poses_where_others_are_elsewhere(orientation: list[float]) -> None:
    """Also where only the position was not filled in."""
    poses = np.tile([0.5, 0.1, 0.2, 0.0, 0.0, 0.0, 1.0], (4, 1))
    poses[1] = [0.0, 0.0, 0.0, *orientation]
    assert never_filled(poses).tolist() == [False, True, False, False]
    begins_there = np.linspace([0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0], poses[0], 20)
    assert not never_filled(begins_there).any() and not never_filled(poses[[1, 1]]).any()
