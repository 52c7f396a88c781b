# SPDX-License-Identifier: Apache-2.0
"""Movements as PoseArrays with frames in a file: what is read, and that each kind of damage is a BagError."""

from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from synthetic_bags import REACH_TASK, reach, write_bag, write_pose_arrays
from tpgmm_core.geometry import quaternion
from tpgmm_ros.programs.train import main
from tpgmm_ros.recordings.bags import BagError, find_bags, read_demonstrations, read_recording
from tpgmm_ros.task.recordings_section import PoseArraySpec
from tpgmm_ros.task.task_file import Task, TaskError

ROOT = Path(__file__).resolve().parents[3]
FRANKA = ROOT.parent / "shared" / "data" / "franka_bolts"
TEXT = REACH_TASK + "recordings: {pose_array: demo, period: 0.05, frames: frames.yaml}\n"
TASK = Task.from_text(TEXT)


def movement(seed: int = 0) -> NDArray[np.float64]:
    return reach(seed)["/endpoint/pose"].poses


def place(seed: int = 0) -> NDArray[np.float64]:
    return reach(seed)["/object/pose"].poses[0]


def write_frames(directory: Path, suffix: str = ".bag", **places: NDArray[np.float64]) -> None:
    """frames.yaml for bags of these names, without the suffix."""
    lines = []
    for bag, pose in places.items():
        lines += [f"{bag}{suffix}:", "  object:", f"    position: {pose[:3].tolist()}"]
        lines += [f"    orientation_xyzw: {pose[3:].tolist()}"]
    (directory / "frames.yaml").write_text("\n".join(lines))


def written(directory: Path, *arrays: NDArray[np.float64]) -> Path:
    directory.mkdir(exist_ok=True)
    write_frames(directory, demo=place())
    return write_pose_arrays(directory / "demo.bag", arrays)


@pytest.mark.parametrize("ros1", [True, False])
def test_a_movement_is_read_as_it_was_written(ros1: bool, tmp_path: Path) -> None:
    suffix = ".bag" if ros1 else ""
    write_frames(tmp_path, suffix, demo=place())
    path = write_pose_arrays(tmp_path / f"demo{suffix}", [movement()], ros1=ros1)
    recording = read_recording(path, TASK)
    np.testing.assert_allclose(recording.times, 0.05 * np.arange(100), atol=1e-12)
    np.testing.assert_allclose(recording.movement, movement(), atol=1e-12)
    np.testing.assert_allclose(recording.frames["object"], np.tile(place(), (100, 1)), atol=1e-12)
    np.testing.assert_array_equal(recording.frames["robot"][0], [0, 0, 0, 0, 0, 0, 1])
    assert list(recording.frames) == ["object", "robot"] and recording.visible["object"].all() and not recording.notes


def test_a_namespace_is_understood_and_samples_can_be_left_out(tmp_path: Path) -> None:
    write_frames(tmp_path, demo=place())
    path = write_pose_arrays(tmp_path / "demo.bag", [movement()], topic="/robot1/demo")
    recording = read_recording(path, TASK, every=7)
    assert len(recording.times) == 16 and len(recording.visible["object"]) == 16
    np.testing.assert_allclose(recording.movement[-1], movement()[-1], atol=1e-12)


def test_orientations_that_were_never_recorded_are_said(tmp_path: Path) -> None:
    poses = movement()
    poses[:, 3:] = quaternion.IDENTITY
    assert "none was recorded" in read_recording(written(tmp_path, poses), TASK).notes[0]


def test_a_model_is_trained_from_such_recordings(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    write_frames(tmp_path, **{f"demo_{i}": place(i) for i in range(5)})
    for i in range(5):
        write_pose_arrays(tmp_path / f"demo_{i}.bag", [movement(i)])
    (tmp_path / "task.yaml").write_text(TEXT)
    output = tmp_path / "model.tpgmm"
    assert main(["--task", str(tmp_path / "task.yaml"), "--output", str(output), str(tmp_path)]) == 0
    assert output.exists() and "demonstrations  5" in capsys.readouterr().out
    demonstrations, duration = read_demonstrations(find_bags([tmp_path]), TASK)
    assert duration == pytest.approx(99 * 0.05) and len(demonstrations) == 5


def refused(path: Path, complaint: str) -> None:
    with pytest.raises(BagError, match=complaint) as raised:
        read_recording(path, TASK)
    assert raised.value.path == path


def test_what_is_no_movement_is_refused(tmp_path: Path) -> None:
    refused(written(tmp_path / "two", movement(), movement()), "2 messages, expected one PoseArray")
    refused(written(tmp_path / "empty", np.empty((0, 7))), "is empty")
    refused(written(tmp_path / "short", movement()[:5]), "5 samples, expected at least 10")
    spoilt = movement()
    spoilt[7:67, 1] = np.nan
    refused(
        written(tmp_path / "nan", spoilt), "has 60 of 100 poses that cannot be used, the first is number 7: not fini"
    )
    foreign = write_pose_arrays(tmp_path / "demo.bag", [movement()], frame_id="world")
    refused(foreign, "world, expected the base frame .?base")


def test_a_pose_that_is_none_is_left_out_and_the_times_of_the_others_stay(tmp_path: Path) -> None:
    spoilt = movement()
    spoilt[3, 3:] = 0.0
    recording = read_recording(written(tmp_path, spoilt), TASK)
    kept = np.delete(np.arange(100), 3)
    np.testing.assert_allclose(recording.times, 0.05 * kept, atol=1e-12)
    np.testing.assert_allclose(recording.movement, movement()[kept], atol=1e-12)
    assert "1 of 100 poses left out, the first is number 3: zero quaternion" in recording.notes[0]


def test_topics_of_another_name_or_type_are_refused(tmp_path: Path) -> None:
    refused(write_pose_arrays(tmp_path / "a.bag", [movement()], topic="/other"), "PoseArray topics are /other")
    topics = reach(0)
    refused(write_bag(tmp_path / "b.bag", {"/demo": topics["/endpoint/pose"]}, "ros1"), "expected .*PoseArray")


def test_a_damaged_bag_is_refused(tmp_path: Path) -> None:
    path = written(tmp_path, movement())
    path.write_bytes(path.read_bytes()[:3000])
    refused(path, "cannot be read")


@pytest.mark.parametrize(
    ("text", "complaint"),
    [
        (None, "frames are not known: .*frames.yaml: cannot be read"),
        ("other.bag: {}", r"lacks the key 'demo\.bag'"),
        ("demo.bag: {}", "lacks the key 'object'"),
        ("demo.bag: {object: {position: [0, 0, 0]}}", "lacks the key 'orientation_xyzw'"),
        ("demo.bag: {object: {position: [0, 0], orientation_xyzw: [0, 0, 0, 1]}}", "3 finite numbers"),
        ("demo.bag: {object: {position: [0, 0, .nan], orientation_xyzw: [0, 0, 0, 1]}}", "3 finite numbers"),
        ("demo.bag: {object: {position: [0, 0, 0], orientation_xyzw: [0, 0, 0, 0]}}", "of norm 1"),
        ("demo.bag: {object: {position: [0, 0, 0], rpy: [0, 0, 0]}}", "unknown key 'rpy'"),
        ("demo.bag: [", "not a YAML file"),
    ],
)
def test_what_is_wrong_with_the_frames_is_said(text: str | None, complaint: str, tmp_path: Path) -> None:
    path = write_pose_arrays(tmp_path / "demo.bag", [movement()])
    if text is not None:
        (tmp_path / "frames.yaml").write_text(text)
    refused(path, complaint)


def test_the_task_file_says_how_recordings_were_made() -> None:
    assert TASK.recordings == PoseArraySpec("demo", 0.05, "frames.yaml")
    for text, complaint in (
        ("{pose_array: demo, frames: f.yaml}", "lacks the key 'period'"),
        ("{pose_array: demo, period: 0, frames: f.yaml}", "time from one pose to the next"),
        ("{pose_array: /demo, period: 0.1, frames: f.yaml}", "relative topic"),
        ("{pose_array: demo, period: 0.1, frames: ../f.yaml}", "lies beside the bags"),
        ("{pose_array: demo, period: 0.1, frames: f.yaml, rate: 3}", "unknown key 'rate'"),
    ):
        with pytest.raises(TaskError, match=complaint):
            Task.from_text(f"{REACH_TASK}recordings: {text}")


@pytest.mark.skipif(not FRANKA.is_dir(), reason="the Franka recordings are not beside the repository")
def test_the_franka_recordings_are_read_whole() -> None:
    """Seven movements of 54 to 278 poses; each starts at its frame `start` and ends at `goal`, within 5 mm."""
    task = Task.load(ROOT / "config" / "franka_bolts.yaml")
    recordings = [read_recording(path, task) for path in find_bags([FRANKA])]
    assert [len(r.times) for r in recordings] == [54, 219, 186, 278, 158, 81, 85]
    for recording in recordings:
        for name, i in (("start", 0), ("goal", -1)):
            assert np.linalg.norm(recording.movement[i, :3] - recording.frames[name][i, :3]) < 0.005
