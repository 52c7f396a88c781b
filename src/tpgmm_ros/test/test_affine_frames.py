# SPDX-License-Identifier: Apache-2.0
"""Frames that are any affine maps: what a message says, what a bag holds, and what is learned from it."""

from __future__ import annotations

import re
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from affine_bags import maps, write_map_bag
from tpgmm_core import Frame
from tpgmm_core.geometry import quaternion
from tpgmm_core.observation.tracked import FrameStatus, TrackedFrame
from tpgmm_core.observation.tracking import FrameTracker
from tpgmm_msgs.msg import TaskFrame
from tpgmm_ros.messages.affine import affine_observation
from tpgmm_ros.messages.frame_messages import task_parameters, task_parameters_message
from tpgmm_ros.messages.sources import TaskParametersSource
from tpgmm_ros.messages.values import StampedFrames
from tpgmm_ros.programs import convert
from tpgmm_ros.recordings.bags import BagError, read_recording
from tpgmm_ros.recordings.one_by_one import OneByOne
from tpgmm_ros.recordings.recording import Recording
from tpgmm_ros.task.task_file import Task, TaskError

TASK = """\
name: tray
base_frame: base
movement: hand/pose
endpoint: left
frames:
  tray: {topic: tray/maps, type: tpgmm_msgs/TaskParameters, name: tray}
"""
#: Sheared, scaled and reflected.
S = np.array([[0.4, 0.1, 0.0], [0.0, -0.3, 0.2], [0.0, 0.0, 1.5]])
P, Q = np.array([0.5, -0.2, 0.1]), quaternion.exp([0.2, -0.4, 0.9])
TIMES = np.linspace(0.0, 2.0, 41)
HAND = np.tile([0.5, 0.1, 0.2, 0.0, 0.0, 0.0, 1.0], (41, 1)) + np.outer(TIMES, [0.1, 0, 0, 0, 0, 0, 0])


def item(A: np.ndarray, b: np.ndarray, **fields: Any) -> TaskFrame:
    rows, cols = A.shape
    return TaskFrame(name="tray", rows=rows, cols=cols, a=A.ravel().tolist(), b=b.tolist(), **fields)


def observed(A: np.ndarray, b: np.ndarray) -> Frame:
    """The frame that an observation of a map is."""
    found = affine_observation(7, "base", item(A, b))
    assert not found.fault and found.stamp_ns == 7 and found.stretch is not None
    pose = np.asarray(found.pose)
    return Frame.from_pose(pose[:3], pose[3:], stretch=found.stretch)


def test_a_map_of_poses_comes_back_from_its_pose_and_its_stretch() -> None:
    A = np.zeros((7, 7))
    A[:3, :3], A[3:, 3:] = S, quaternion.left_matrix(Q)
    frame = observed(A, np.array([*P, 0.0, 0.0, 0.0, 0.0]))
    np.testing.assert_allclose(frame.A, A, atol=1e-12)
    np.testing.assert_allclose(frame.b[:3], P)


def test_a_map_of_positions_leaves_orientations_as_they_are() -> None:
    frame = observed(S, P)
    np.testing.assert_allclose(frame.A[:3, :3], S, atol=1e-15)
    np.testing.assert_array_equal(frame.A[3:, 3:], np.eye(4))


@pytest.mark.parametrize(
    ("A", "b", "complaint"),
    [
        (np.ones((3, 2)), P, r"3 x 2, with 6 numbers in a and 3 in b; expected 3 x 3"),
        (np.eye(3), np.zeros(7), "with 9 numbers in a and 7 in b"),
        (np.eye(7) * 2.0, np.zeros(7), "no left multiplication"),
        (np.eye(7) + np.eye(7, k=3), np.zeros(7), "no left multiplication"),
        (np.eye(7), np.ones(7), "no left multiplication"),
    ],
)
def test_what_is_no_map_of_poses_is_said(A: np.ndarray, b: np.ndarray, complaint: str) -> None:
    assert re.search(complaint, affine_observation(0, "base", item(A, b)).fault)


def test_numbers_that_are_not_finite_are_refused_as_those_of_poses() -> None:
    tracker = FrameTracker(["tray"])
    for A, b in ((S * np.nan, P), (S * 1e9, P), (np.eye(7), np.array([0.0, 0.0, 0.0, np.nan, 0.0, 0.0, 0.0]))):
        found = affine_observation(1, "base", item(A, b))
        assert "finite" in str(tracker.observe("tray", np.asarray(found.pose), 1, 1, 1, None, found.stretch))


def test_held_frames_and_those_of_other_names_say_nothing() -> None:
    source = TaskParametersSource("maps", "tray")
    header = SimpleNamespace(frame_id="base", stamp=SimpleNamespace(sec=3, nanosec=0))
    frames = [item(S, P, status=TaskFrame.HELD), TaskFrame(name="cup")]
    assert source.read(SimpleNamespace(header=header, frames=frames)) is None
    found = source.read(SimpleNamespace(header=header, frames=[*frames, item(S, P)]))
    assert found is not None and found.stamp_ns == 3_000_000_000, "without a stamp of its own it has the message's"


def test_the_tracker_hands_the_stretch_on_and_the_message_holds_the_map() -> None:
    tracker = FrameTracker(["tray"])
    tracker.observe("tray", np.array([*P, *Q]), 1, 1, 1, None, S)
    (tracked,) = tracker.update(2)
    assert isinstance(tracked, TrackedFrame) and tracked.status is FrameStatus.VISIBLE
    expected = Frame.from_pose(P, Q, stretch=S)
    (sent,) = task_parameters(task_parameters_message([tracked], 2, "base")).values()
    (handed,) = StampedFrames((tracked,), 2, "base").states().values()
    for state in (sent, handed):
        assert state.frame is not None
        np.testing.assert_allclose(state.frame.A, expected.A, atol=1e-12)
    tracker.forget()
    (forgotten,) = tracker.update(3)
    assert forgotten.stretch is None


def test_a_bag_holds_maps_that_change_and_the_demonstration_is_seen_by_them(tmp_path: Path) -> None:
    stretches = S * (1.0 + 0.5 * TIMES)[:, None, None]
    path = write_map_bag(tmp_path / "demo", {"/hand/pose": HAND}, {"/tray/maps": maps("tray", P, Q, stretches)}, TIMES)
    task = Task.from_text(TASK)
    recording = read_recording(path, task)
    np.testing.assert_allclose(recording.stretches["tray"], stretches, atol=1e-9)
    every = np.arange(0, 41, 4)
    few = recording.at(every)
    shown = few.to_demonstration()
    seen = shown.frames["tray"].project(shown.data)[:, 1:4]
    R = quaternion.rotation_matrix(Q)
    expected = [np.linalg.solve(R @ stretches[t], HAND[t, :3] - P) for t in every]
    np.testing.assert_allclose(seen, expected, atol=1e-6)
    with OneByOne(task) as kept:
        whole = kept.whole(kept.keep(recording))
    assert isinstance(whole, Recording)
    np.testing.assert_array_equal(whole.stretches["tray"], recording.stretches["tray"])


def test_a_constant_map_is_a_constant_frame(tmp_path: Path) -> None:
    topics = {"/tray/maps": maps("tray", P, Q, np.tile(S, (41, 1, 1)))}
    recording = read_recording(
        write_map_bag(tmp_path / "demo", {"/hand/pose": HAND}, topics, TIMES), Task.from_text(TASK)
    )
    assert not recording.to_demonstration().frames["tray"].is_time_varying


def test_bags_with_other_names_or_other_matrices_are_refused_with_the_reason(tmp_path: Path) -> None:
    task = Task.from_text(TASK)
    path = write_map_bag(
        tmp_path / "cup", {"/hand/pose": HAND}, {"/tray/maps": maps("cup", P, Q, np.tile(S, (41, 1, 1)))}, TIMES
    )
    with pytest.raises(BagError, match="tray/maps never holds a visible frame 'tray', in 41 messages"):
        read_recording(path, task)
    wrong = [item(2.0 * np.eye(7), np.zeros(7))] * 41
    path = write_map_bag(tmp_path / "wrong", {"/hand/pose": HAND}, {"/tray/maps": wrong}, TIMES)
    with pytest.raises(BagError, match="tray/maps: no map of poses: .* no left multiplication"):
        read_recording(path, task)


def test_maps_that_are_not_finite_are_left_out_of_a_bag_with_their_poses(tmp_path: Path) -> None:
    stretches = S * (1.0 + 0.5 * TIMES)[:, None, None]
    frames = maps("tray", P, Q, stretches)
    frames[3].a = [float("nan")] * 49
    recording = read_recording(
        write_map_bag(tmp_path / "demo", {"/hand/pose": HAND}, {"/tray/maps": frames}, TIMES), Task.from_text(TASK)
    )
    expected = stretches[[0, 1, 2, 2, *range(4, 41)]]
    np.testing.assert_allclose(recording.stretches["tray"], expected, atol=1e-9)
    assert any("1 of 41 poses left out" in note and "not finite" in note for note in recording.notes)


def test_a_dataset_of_poses_refuses_maps(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    pytest.importorskip("pyarrow", reason="pyarrow is not installed: pip install 'pyarrow>=21'")
    (tmp_path / "tray.yaml").write_text(TASK)
    frames = maps("tray", P, Q, np.tile(S, (41, 1, 1)))
    write_map_bag(tmp_path / "bags" / "demo", {"/hand/pose": HAND}, {"/tray/maps": frames}, TIMES)
    options = ["--to", str(tmp_path / "set"), "--lerobot", "--task", str(tmp_path / "tray.yaml"), "--rate", "20"]
    assert convert.main([*options, str(tmp_path / "bags")]) == 1
    assert "poses of frames, and tray are maps: leave them out" in capsys.readouterr().err


def test_the_entry_names_the_frame_of_the_messages() -> None:
    with pytest.raises(TaskError, match=r"'frames\.tray' lacks the key 'name': which frame of the messages is meant"):
        Task.from_text(TASK.replace(", name: tray", ""))
    with pytest.raises(TaskError, match="'name', which is not a key of"):
        Task.from_text(TASK.replace(", type: tpgmm_msgs/TaskParameters", ""))
