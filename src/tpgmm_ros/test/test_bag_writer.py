# SPDX-License-Identifier: Apache-2.0
"""Bags that are written: definitions as they are installed, and nothing lost that was flushed, however it ends."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
import yaml
from ament_index_python.packages import get_package_share_directory

from tpgmm_ros.recordings.bags import find_bags
from tpgmm_ros.recordings.recorded_topics import needed_topics, topics_of
from tpgmm_ros.recordings.recovery import recover
from tpgmm_ros.recordings.storage.bag_error import BagError
from tpgmm_ros.recordings.storage.bag_reader import BagReader
from tpgmm_ros.recordings.storage.bag_writer import BagWriter, next_name
from tpgmm_ros.recordings.storage.definitions import types_for
from tpgmm_ros.task.task_file import Task

POINT = "geometry_msgs/msg/Point"


def point(x: float) -> bytes:
    types = types_for(POINT)
    return bytes(types.serialize_cdr(types.types[POINT](x=x, y=0.0, z=0.0), POINT))


def write_points(writer: BagWriter, count: int, flush_after: int | None = None) -> None:
    topic = writer.add_topic("/hand", POINT, types_for(POINT))
    for i in range(count):
        writer.write(topic, 1_000 + i, point(float(i)))
        if flush_after == i + 1:
            writer.flush()


def read_points(path: Path, whole: bool = True) -> list[float]:
    with BagReader(path, whole) as reader:
        return [message.x for _, _, message in reader.messages(reader.topics)]


@pytest.mark.parametrize(
    "name", ["sensor_msgs/msg/JointState", "vision_msgs/msg/Detection3DArray", "tf2_msgs/msg/TFMessage"]
)
def test_a_written_definition_is_the_type_that_is_installed_by_its_hash(name: str) -> None:
    package, _, short = name.split("/")
    described = Path(get_package_share_directory(package)) / "msg" / f"{short}.json"
    hashes = {item["type_name"]: item["hash_string"] for item in json.loads(described.read_text())["type_hashes"]}
    assert types_for(name).hash_rihs01(name) == hashes[name]


def test_a_type_that_nobody_knows_is_refused_with_what_to_install() -> None:
    with pytest.raises(ValueError, match="robot_things/msg/Claw is not known: install.*ros-jazzy-robot-things"):
        types_for("robot_things/msg/Claw")


def test_a_bag_is_in_its_place_when_it_is_complete_and_has_the_metadata_that_rosbag2_asks_for(tmp_path: Path) -> None:
    path = tmp_path / "demo_01"
    writer = BagWriter(path)
    write_points(writer, 20, flush_after=7)
    assert not path.exists()
    assert writer.close() == path and read_points(path) == [float(i) for i in range(20)]
    assert [item.name for item in tmp_path.iterdir()] == ["demo_01"]
    about = yaml.safe_load((path / "metadata.yaml").read_text())["rosbag2_bagfile_information"]
    assert (about["version"], about["storage_identifier"], about["message_count"]) == (9, "mcap", 20)
    assert about["relative_file_paths"] == ["demo_01.mcap"] == [item["path"] for item in about["files"]]
    assert about["starting_time"]["nanoseconds_since_epoch"] == 1000 and about["duration"]["nanoseconds"] == 19
    (topic,) = about["topics_with_message_count"]
    assert topic["message_count"] == 20
    assert topic["topic_metadata"]["type_description_hash"].startswith("RIHS01_")
    with pytest.raises(FileExistsError, match="not overwritten"):
        BagWriter(path)


def test_what_was_flushed_is_read_wherever_the_file_ends_and_only_by_those_who_ask_for_it(tmp_path: Path) -> None:
    writer = BagWriter(tmp_path / "demo_01")
    write_points(writer, 20, flush_after=15)
    cut = tmp_path / ".partial" / "demo_01"
    file = cut / "demo_01.mcap"
    assert read_points(cut, whole=False) == [float(i) for i in range(15)], "while it is being written"
    writer.flush()
    content = file.read_bytes()
    with pytest.raises(BagError, match=r"cut off.*record --recover"):
        read_points(cut)
    with pytest.raises(BagError, match="contains none"):
        find_bags([tmp_path])
    lengths = []
    for size in np.linspace(len(content), 9, 12).astype(int).tolist():
        file.write_bytes(content[:size])
        lengths.append(len(read_points(cut, whole=False)))
    assert lengths[0] == 20 and lengths[-1] == 0 and lengths == sorted(lengths, reverse=True)
    assert set(lengths) == {20, 15, 0}, "chunks are there as a whole or not at all"


def test_what_was_cut_off_becomes_a_bag_and_the_original_stays(tmp_path: Path) -> None:
    writer = BagWriter(tmp_path / "demo_01")
    write_points(writer, 20, flush_after=15)
    left = writer.abandon()
    before = (left / "demo_01.mcap").read_bytes()
    assert next_name(tmp_path) == "demo_02", "the name of what was cut off is not given again"
    duration, counts, left_out = recover(left, tmp_path / "demo_02")
    assert (counts, left_out) == ({"/hand": 15}, []) and duration == pytest.approx(14e-9)
    assert read_points(tmp_path / "demo_02") == [float(i) for i in range(15)]
    assert (left / "demo_01.mcap").read_bytes() == before
    (left / "demo_01.mcap").write_bytes(before[:60])
    with pytest.raises(BagError, match="no whole message"):
        recover(left, tmp_path / "demo_03")
    assert not (tmp_path / "demo_03").exists() and not (tmp_path / ".partial" / "demo_03").exists()


def test_a_second_try_under_the_same_name_keeps_what_was_cut_off(tmp_path: Path) -> None:
    writer = BagWriter(tmp_path / "demo")
    write_points(writer, 5)
    writer.flush()
    writer.abandon()
    again = BagWriter(tmp_path / "demo")
    write_points(again, 2)
    again.close()
    assert read_points(tmp_path / "demo") == [0.0, 1.0]
    assert read_points(tmp_path / ".partial" / "demo_2", whole=False) == [0.0, 1.0, 2.0, 3.0, 4.0]
    third = BagWriter(tmp_path / "more")
    third.discard()
    assert not (tmp_path / ".partial" / "more").exists()


TASK = """\
name: pour
base_frame: base
movement: hand/pose
endpoint: left
frames:
  cup: {topic: cup, type: geometry_msgs/PoseWithCovarianceStamped}
  lid: {topic: lid, type: geometry_msgs/TransformStamped, child: lid}
  cart: {topic: odom, type: nav_msgs/Odometry}
  can: {topic: detections, type: vision_msgs/Detection3DArray, class: can}
  table: {tf: table}
  robot: {pose: [0, 0, 0, 0, 0, 0, 1]}
"""


def test_a_recording_holds_the_sources_of_every_kind_that_a_task_names() -> None:
    task = Task.from_text(TASK)
    assert needed_topics(task) == {
        "hand/pose": "geometry_msgs/msg/PoseStamped",
        "cup": "geometry_msgs/msg/PoseWithCovarianceStamped",
        "lid": "geometry_msgs/msg/TransformStamped",
        "odom": "nav_msgs/msg/Odometry",
        "detections": "vision_msgs/msg/Detection3DArray",
        "/tf": "tf2_msgs/msg/TFMessage",
        "/tf_static": "tf2_msgs/msg/TFMessage",
    }
    topics = topics_of(task, ["gripper/width"])
    assert needed_topics(task).items() <= topics.items()
    assert topics["joint_states"] == "sensor_msgs/msg/JointState"
    assert topics["robot_description"] is None and topics["gripper/width"] is None


@pytest.mark.parametrize(
    ("recordings", "topic", "kind"),
    [
        (
            "{movement: {joint_states: arm/states, robot: r.yaml, link: tool}}",
            "arm/states",
            "sensor_msgs/msg/JointState",
        ),
        ("{movement: {topic: tool, type: nav_msgs/Odometry}}", "tool", "nav_msgs/msg/Odometry"),
        ("{pose_array: path, period: 0.1, frames: frames.yaml}", "path", "geometry_msgs/msg/PoseArray"),
    ],
)
def test_a_movement_is_recorded_where_recordings_have_it(recordings: str, topic: str, kind: str) -> None:
    needed = needed_topics(Task.from_text(f"{TASK}recordings: {recordings}\n"))
    assert needed[topic] == kind and "hand/pose" not in needed
