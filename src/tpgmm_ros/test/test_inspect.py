# SPDX-License-Identifier: Apache-2.0
"""`inspect`: what it shows of bags, which task file it suggests, and that `train` refuses what it refuses."""

import json
from pathlib import Path

import numpy as np
import pytest
from rosbags.rosbag2 import StoragePlugin, Writer
from rosbags.typesys import Stores, get_typestore

from synthetic_bags import REACH_TASK, Topic, reach, write_bag, write_pose_arrays
from tpgmm_ros.programs import show, train
from tpgmm_ros.programs.inspect import main
from tpgmm_ros.programs.reporting import json_text
from tpgmm_ros.task.task_file import Task

ROOT = Path(__file__).resolve().parents[3]
DATA = ROOT.parent / "shared" / "data"


def bags(directory: Path, count: int = 4) -> Path:
    for i in range(count):
        write_bag(directory / f"demo_{i}", reach(i))
    return directory


def inspected(capsys: pytest.CaptureFixture[str], *arguments: object) -> dict:
    status = main([*map(str, arguments), "--json"])
    found = json.loads(capsys.readouterr().out)
    assert status == (0 if found["passed"] else 1)
    return found


def test_topics_are_shown_with_rates_and_what_moves(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    found = inspected(capsys, bags(tmp_path))
    assert found["passed"] and not found["doubts"] and not found["bad_bags"] and len(found["bags"]) == 4
    hand, thing = found["bags"][0]["topics"]
    assert (hand["name"], hand["messages"], hand["moves"]) == ("/endpoint/pose", 100, True)
    assert hand["rate_hz"] == pytest.approx(99 / 5.0, rel=1e-3) and hand["longest_gap_s"] == 0.0
    assert (thing["name"], thing["moves"], thing["frame_ids"]) == ("/object/pose", False, ["base"])
    assert main([str(tmp_path)]) == 0
    text = capsys.readouterr().out
    assert "no doubts" in text and "stands still in each bag, elsewhere from bag to bag" in text


def test_of_one_bag_nothing_is_said_of_others_and_what_is_no_bag_is_json_too(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    suggested = inspected(capsys, bags(tmp_path, 1))["suggested_task"]
    assert "{topic: object/pose}  # stands still\n" in suggested
    assert "does not exist" in inspected(capsys, tmp_path / "nothing")["error"]
    assert show.main(["--json", str(tmp_path / "nothing")]) == 1
    assert json.loads(capsys.readouterr().out)["passed"] is False


def test_the_suggested_task_file_trains(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    directory, file = bags(tmp_path / "bags"), tmp_path / "task.yaml"
    assert inspected(capsys, "--write", file, directory)["written"] == str(file)
    task = Task.load(file)
    assert task.movement == "endpoint/pose" and task.topics == {"object": "object/pose"} and task.base_frame == "base"
    model = tmp_path / "model.tpgmm"
    assert train.main(["--task", str(file), "--output", str(model), "--components", "3", str(directory)]) == 0
    assert main(["--write", str(file), str(directory)]) == 1
    assert "exists, and is not overwritten" in capsys.readouterr().err


def test_what_makes_no_sense_is_said_by_inspect_and_by_train(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    directory, task = bags(tmp_path / "bags"), tmp_path / "task.yaml"
    task.write_text(REACH_TASK)
    topics = reach(7)
    stamps = topics["/object/pose"].recorded - 4.0
    topics["/object/pose"].stamps = stamps
    write_bag(directory / "late", topics)
    (doubt,) = inspected(capsys, "--task", task, directory)["doubts"]
    assert doubt["kind"] == "lag" and doubt["about"] == [str(directory / "late")]
    arguments = ["--task", str(task), "--output", str(tmp_path / "model"), "--report", str(tmp_path), str(directory)]
    assert train.main(arguments) == 0
    assert f"doubt: {directory / 'late'}: /object/pose is stamped -4.00 s away" in capsys.readouterr().err
    assert json.loads((tmp_path / "report.json").read_text())["doubts"] == [doubt]
    (tmp_path / "model").unlink()
    assert train.main(["--strict", *arguments]) == 1 and main(["--strict", str(directory)]) == 1
    assert "--strict refuses all" in capsys.readouterr().err and not (tmp_path / "model").exists()


def test_mixed_units_are_refused_and_can_be_left_out(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    directory, task = bags(tmp_path / "bags"), tmp_path / "task.yaml"
    task.write_text(REACH_TASK)
    topics = reach(7)
    for topic in topics.values():
        topic.poses[:, :3] *= 1000.0
    write_bag(directory / "odd", topics)
    assert not inspected(capsys, "--task", task, directory)["passed"]
    arguments = ["--task", str(task), "--output", str(tmp_path / "model"), str(directory)]
    assert train.main(arguments) == 1 and not (tmp_path / "model").exists()
    error = capsys.readouterr().err
    assert f"doubt: {directory / 'odd'}: the hand moves by" in error and "units differ" in error
    assert train.main(["--skip-bad", *arguments]) == 0
    assert f"left out: {directory / 'odd'}" in capsys.readouterr().err


def test_a_closed_path_is_refused_for_a_dynamical_system(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    task = tmp_path / "task.yaml"
    task.write_text(REACH_TASK)
    for i in range(4):
        topics = reach(i)
        hand = topics["/endpoint/pose"].poses
        angle = 2.0 * np.pi * np.linspace(0.0, 1.0, 100) ** 2 * (3.0 - 2.0 * np.linspace(0.0, 1.0, 100))
        place = topics["/object/pose"].poses[0, :3]
        hand[:, :3] = place + 0.1 * np.column_stack([np.cos(angle), np.sin(angle), 0.0 * angle])
        hand[:, 3:] = [0.0, 0.0, 0.0, 1.0]
        write_bag(tmp_path / "bags" / f"demo_{i}", topics)
    arguments = ["--task", str(task), "--output", str(tmp_path / "model"), str(tmp_path / "bags")]
    assert train.main(["--retrieval", "dynamical_system", *arguments]) == 1
    assert "from where it began" in capsys.readouterr().err
    assert train.main(["--retrieval", "dmp", *arguments]) == 0


def test_a_bag_that_cannot_be_read_is_named(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    directory = bags(tmp_path)
    (directory / "broken.mcap").write_bytes(b"\x89MCAP0\r\n" + bytes(10))
    found = inspected(capsys, directory)
    assert not found["passed"] and "cut off" in found["bad_bags"][0]["error"] and found["suggested_task"]


def test_pose_arrays_with_frames_beside_them_are_suggested(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    for i in range(3):
        write_pose_arrays(tmp_path / f"demo_{i}.bag", [reach(i)["/endpoint/pose"].poses])
    place = "position: [0.5, 0.0, 0.1], orientation_xyzw: [0, 0, 0, 1]"
    (tmp_path / "frames.yaml").write_text("".join(f"demo_{i}.bag: {{object: {{{place}}}}}\n" for i in range(3)))
    task = Task.from_text(inspected(capsys, tmp_path)["suggested_task"])
    assert task.recordings is not None and task.recordings.pose_array == "demo" and list(task.frames) == ["object"]


@pytest.mark.skipif(not DATA.is_dir(), reason="recordings of real robots are not beside the repository")
@pytest.mark.parametrize("name", ["baxter_valve", "franka_bolts"])
def test_nearly_the_task_files_of_real_recordings_are_suggested(name: str, capsys: pytest.CaptureFixture[str]) -> None:
    found = Task.from_text(inspected(capsys, DATA / name)["suggested_task"])
    ours = Task.load(ROOT / "config" / f"{name}.yaml")
    assert (found.base_frame, found.movement, found.recordings) == (ours.base_frame, ours.movement, ours.recordings)
    assert list(found.frames) == list(ours.frames)


def test_sources_of_other_types_are_named(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    typestore = get_typestore(Stores.ROS2_JAZZY)
    kinds = {
        "/tf": "tf2_msgs/msg/TFMessage",
        "/joint_states": "sensor_msgs/msg/JointState",
        "/odom": "nav_msgs/msg/Odometry",
    }
    with Writer(tmp_path / "demo", version=9, storage_plugin=StoragePlugin.MCAP) as writer:
        for name, kind in kinds.items():
            writer.write(writer.add_connection(name, kind, typestore=typestore), 10**18, b"\0\1\0\0")
    assert main(["--json", str(tmp_path)]) == 0
    found = json.loads(capsys.readouterr().out)
    assert not found["suggested_task"] and "no topic of PoseStamped" in found["no_task_because"]
    hints = " ".join(found["hints"])
    assert "{tf: FRAME}" in hints and "{joint_states: TOPIC" in hints
    assert "{topic: odom, type: nav_msgs/Odometry}" in hints


def test_without_a_bag_there_is_an_error_in_json_too(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    write_bag(tmp_path / "left" / "demo_1", reach(0))
    assert main(["--json", str(tmp_path)]) == 1
    said = capsys.readouterr()
    assert not json.loads(said.out)["passed"] and "bags lie in its folders: left" in json.loads(said.out)["error"]
    assert "bags lie in its folders: left" in said.err
    write_bag(tmp_path / "empty", {})
    assert main(["--json", str(tmp_path / "empty")]) == 1
    assert "holds no message at all" in json.loads(capsys.readouterr().out)["bad_bags"][0]["error"]


def test_numbers_that_are_not_finite_are_null_in_json() -> None:
    values = {"a": [float("nan"), 1.5, True, None], "b": (float("inf"), Path("x"))}
    assert json.loads(json_text(values)) == {"a": [None, 1.5, True, None], "b": [None, "x"]}


def test_a_topic_that_no_task_file_can_name_is_said_and_the_others_are_suggested(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    topics = reach(0)
    strange = Topic(topics["/endpoint/pose"].poses, topics["/endpoint/pose"].recorded, frame_id="a\nb\x1b[2J")
    write_bag(tmp_path / "demo", {"/esc\x1b[31m": strange, "/a b: c": strange, f"/x{'y' * 3000}": strange, **topics})
    found = inspected(capsys, tmp_path)
    assert found["passed"] and "movement: endpoint/pose" in found["suggested_task"]
    assert any("this is no name of ROS" in hint and "/a b: c" in hint for hint in found["hints"])


def test_orientations_that_were_never_recorded_and_far_places_of_the_task_are_said(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    topics = reach(0)
    topics["/endpoint/pose"].poses[:, 3:] = [0.0, 0.0, 0.0, 1.0]
    write_bag(tmp_path / "demo", topics)
    (tmp_path / "task.yaml").write_text(REACH_TASK.replace("robot: {pose: [0,", "robot: {pose: [500,"))
    notes = " ".join(inspected(capsys, "--task", tmp_path / "task.yaml", tmp_path / "demo")["notes"])
    assert "every orientation is 0 0 0 1: none was recorded" in notes
    assert "the pose of robot in the task file lies 500 m from the origin" in notes
