# SPDX-License-Identifier: Apache-2.0
"""record: demonstrations from real topics of every kind, by key and by service, and what is left after every end."""

from __future__ import annotations

import json
import os
import pty
import re
import resource
import select
import signal
import subprocess
import sys
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from geometry_msgs.msg import PoseStamped, TransformStamped
from mcap.reader import make_reader
from mcap_ros2.decoder import DecoderFactory
from nav_msgs.msg import Odometry
from rclpy.node import Node
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64, String
from std_srvs.srv import Trigger
from tf2_msgs.msg import TFMessage
from vision_msgs.msg import Detection3D, Detection3DArray, ObjectHypothesisWithPose

from ros_testing import RunningProcess, StartProcess, spin_until
from tpgmm_ros.messages.qos import LATCHED, MIXED, STREAM, TRANSFORMS_STATIC
from tpgmm_ros.programs.record import main
from tpgmm_ros.recordings.bags import find_bags, read_recording
from tpgmm_ros.recordings.storage.bag_reader import BagReader
from tpgmm_ros.runtime.keys import LINE_START
from tpgmm_ros.task.task_file import Task

TASK = """\
name: pour
base_frame: base
movement: hand/pose
endpoint: left
recordings: {movement: {tf: hand}}
frames:
  cup: {topic: detections, type: vision_msgs/Detection3DArray, class: cup}
  cart: {topic: odom, type: nav_msgs/Odometry}
  table: {tf: table}
  lid: {topic: lid/pose}
"""
RATE = 50.0
START = 90.0
"""A program that imports all of the graph's messages takes long to start on a busy machine, s."""


class Robot:
    """Publishes what a robot and its perception do: all sources that the task names, and more."""

    def __init__(self, node: Node, cup: str = "cup") -> None:
        self.node, self.cup, self.sent = node, cup, 0
        self.publishers = {
            kind: node.create_publisher(message, topic, qos)
            for kind, message, topic, qos in (
                ("tf", TFMessage, "/tf", MIXED),
                ("detections", Detection3DArray, "detections", STREAM),
                ("odometry", Odometry, "odom", STREAM),
                ("joints", JointState, "joint_states", STREAM),
                ("width", Float64, "gripper/width", STREAM),
            )
        }
        once = (
            node.create_publisher(String, "robot_description", LATCHED),
            node.create_publisher(TFMessage, "/tf_static", TRANSFORMS_STATIC),
            node.create_publisher(PoseStamped, "lid/pose", LATCHED),
        )
        lid = PoseStamped()
        lid.header.frame_id, lid.header.stamp = "base", node.get_clock().now().to_msg()
        once[0].publish(String(data="<robot name='r'/>"))
        once[1].publish(TFMessage(transforms=[self._transform("base", "table", 0.5)]))
        once[2].publish(lid)
        self.publishers |= dict(zip(("description", "static", "lid"), once, strict=True))
        node.create_timer(1.0 / RATE, self._send)

    def is_heard(self, but: str = "width") -> bool:
        """Whether somebody subscribes to every topic but one."""
        return all(publisher.get_subscription_count() for name, publisher in self.publishers.items() if name != but)

    def run(self, messages: int = 40) -> None:
        end = self.sent + messages
        spin_until(self.node, lambda: self.sent >= end, message="time to pass")

    def _transform(self, parent: str, child: str, x: float) -> TransformStamped:
        message = TransformStamped()
        message.header.stamp, message.header.frame_id = self.node.get_clock().now().to_msg(), parent
        message.child_frame_id, message.transform.translation.x = child, x
        return message

    def _send(self) -> None:
        self.sent += 1
        now, x = self.node.get_clock().now().to_msg(), 0.3 + 0.001 * self.sent
        self.publishers["tf"].publish(TFMessage(transforms=[self._transform("table", "hand", x)]))
        hypothesis, detection, found = ObjectHypothesisWithPose(), Detection3D(), Detection3DArray()
        hypothesis.hypothesis.class_id, hypothesis.hypothesis.score = self.cup, 0.9
        hypothesis.pose.pose.position.y = 0.2
        detection.results, found.detections = [hypothesis], [detection]
        found.header.frame_id, found.header.stamp = "base", now
        self.publishers["detections"].publish(found)
        odometry = Odometry()
        odometry.header.frame_id, odometry.header.stamp = "base", now
        self.publishers["odometry"].publish(odometry)
        joints = JointState(name=["a"], position=[x])
        joints.header.stamp = now
        self.publishers["joints"].publish(joints)
        self.publishers["width"].publish(Float64(data=0.04))


@pytest.fixture
def task_file(tmp_path: Path) -> Path:
    (tmp_path / "task.yaml").write_text(TASK)
    return tmp_path / "task.yaml"


@pytest.fixture
def ask(ros_node: Node) -> Callable[[str], Trigger.Response]:
    def call(name: str) -> Trigger.Response:
        client = ros_node.create_client(Trigger, f"/record/{name}")
        spin_until(ros_node, client.service_is_ready, message=f"the service {name}")
        future = client.call_async(Trigger.Request())
        spin_until(ros_node, future.done, message=f"the answer of {name}")
        answer: Trigger.Response = future.result()
        return answer

    return call


def test_a_folder_that_takes_no_bag_is_said_before_anybody_demonstrates(
    task_file: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["record", str(task_file), "--to", "/proc/bags"]) == 1
    assert "cannot be written, as no file can be made in /proc" in capsys.readouterr().err


def record(start_process: StartProcess, *arguments: Any) -> RunningProcess:
    return start_process(sys.executable, "-m", "tpgmm_ros.programs.record", *map(str, arguments))


def contents(bag: Path, whole: bool = True) -> dict[str, int]:
    with BagReader(bag, whole) as reader:
        counts = {topic.name: 0 for topic in reader.topics}
        for topic, _, _ in reader.messages(reader.topics):
            counts[topic.name] += 1
    return counts


def check_by_other_readers(bag: Path, node: Node) -> None:
    """What MCAP's own readers find in a bag, and what rosbag2 asks of its metadata (version 9)."""
    counts = contents(bag)
    (file,) = bag.glob("*.mcap")
    positions = []
    found = dict.fromkeys(counts, 0)
    with file.open("rb") as stream:
        reader = make_reader(stream, decoder_factories=[DecoderFactory()])
        summary = reader.get_summary()
        for _, channel, message, decoded in reader.iter_decoded_messages():
            found[channel.topic] += 1
            if channel.topic == "/joint_states":
                positions.append(decoded.position[0])
                stamp = decoded.header.stamp
                assert abs(stamp.sec + 1e-9 * stamp.nanosec - 1e-9 * message.log_time) < 10.0
    assert found == counts
    np.testing.assert_allclose(np.diff(positions), 0.001, atol=1e-9)
    assert summary is not None and summary.statistics is not None
    statistics = summary.statistics
    about = yaml.safe_load((bag / "metadata.yaml").read_text())["rosbag2_bagfile_information"]
    assert (about["version"], about["storage_identifier"]) == (9, "mcap")
    assert about["message_count"] == statistics.message_count == sum(counts.values())
    assert about["starting_time"]["nanoseconds_since_epoch"] == statistics.message_start_time
    assert about["duration"]["nanoseconds"] == statistics.message_end_time - statistics.message_start_time
    assert about["relative_file_paths"] == [part["path"] for part in about["files"]] == [file.name]
    assert about["files"][0]["message_count"] == about["message_count"]
    assert (about["compression_format"], about["compression_mode"]) == ("", "") and "custom_data" in about
    assert about["ros_distro"]
    hashes = {}
    for topic in about["topics_with_message_count"]:
        known = topic["topic_metadata"]
        assert known["serialization_format"] == "cdr" and topic["message_count"] == counts[known["name"]]
        assert all(
            {"reliability", "durability", "history", "depth"} <= set(qos) for qos in known["offered_qos_profiles"]
        )
        hashes[known["name"]] = known["type_description_hash"]
    offered = {name: node.get_publishers_info_by_topic(name) for name in hashes}
    assert hashes == {name: str(publishers[0].topic_type_hash) for name, publishers in offered.items()}


def test_every_kind_of_source_is_recorded_and_read_and_what_was_published_once_is_in_each_bag(
    ros_node: Node,
    start_process: StartProcess,
    task_file: Path,
    tmp_path: Path,
    ask: Callable[[str], Trigger.Response],
) -> None:
    robot, folder = Robot(ros_node), tmp_path / "bags"
    process = record(start_process, task_file, "--to", folder, "--topic", "gripper/width", "--json")
    spin_until(ros_node, lambda: robot.is_heard(but=""), START, "the recorder to listen", (process,))
    assert not ask("stop").success and "start first" in ask("stop").message
    for number in range(1, 4):
        started = ask("start")
        assert started.success and f"demo_0{number}" in started.message
        assert not ask("start").success
        robot.run()
        assert ask("stop").success
    undone = ask("undo")
    assert undone.success and (folder / ".undone" / "demo_03").is_dir() and not (folder / "demo_03").exists()
    assert ask("start").message.endswith("demo_04"), "a name is not given twice"
    robot.run()
    process.send_signal(signal.SIGINT)
    spin_until(ros_node, lambda: process.returncode is not None, message="the end")
    assert process.returncode == 0 and "will not draw" not in process.output, process.output
    assert [bag.name for bag in find_bags([folder])] == ["demo_01", "demo_02", "demo_04"]

    task = Task.load(task_file)
    check_by_other_readers(folder / "demo_01", ros_node)
    for bag in find_bags([folder]):
        counts = contents(bag)
        assert counts["/robot_description"] == counts["/tf_static"] == counts["/lid/pose"] == 1
        assert min(counts[name] for name in ("/tf", "/detections", "/odom", "/joint_states", "/gripper/width")) > 20
        recording = read_recording(bag, task)
        assert set(recording.frames) == {"cup", "cart", "table", "lid"}
        assert all(mask.all() for mask in recording.visible.values())
        np.testing.assert_allclose(np.diff(recording.movement[:, 0]), 0.001, atol=1e-9)
        np.testing.assert_allclose(recording.frames["cup"][:, 1], 0.2)
    report = json.loads(process.output[process.output.index("{\n") :])
    assert report["passed"] and [Path(bag["bag"]).name for bag in report["bags"]] == ["demo_01", "demo_02", "demo_04"]
    assert all(bag["missing"] == [] and bag["duration_s"] > 0.5 for bag in report["bags"])


def test_after_sigkill_finished_demonstrations_are_there_and_the_current_one_is_recovered(
    ros_node: Node,
    start_process: StartProcess,
    task_file: Path,
    tmp_path: Path,
    ask: Callable[[str], Trigger.Response],
) -> None:
    robot, folder = Robot(ros_node, cup="can"), tmp_path / "bags"
    process = record(start_process, task_file, "--to", folder)
    spin_until(ros_node, robot.is_heard, START, "the recorder to listen", (process,))
    ask("start")
    robot.run()
    stopped = ask("stop").message
    assert "MISSING: frame cup" in stopped, "detections come, but not of the cup"
    ask("start")
    robot.run(100)  # two seconds, of which the last half may be lost
    process.send_signal(signal.SIGKILL)
    spin_until(ros_node, lambda: process.returncode is not None, message="the end")
    assert [bag.name for bag in find_bags([folder])] == ["demo_01"] and contents(folder / "demo_01")["/tf"] > 20
    cut = folder / ".partial" / "demo_02"
    saved = contents(cut, whole=False)
    assert saved["/tf"] > 40 and saved["/robot_description"] == 1
    ended = subprocess.run(
        [sys.executable, "-m", "tpgmm_ros.programs.record", "--to", str(folder), "--recover", str(cut)],
        capture_output=True,
        text=True,
        timeout=60,
    )
    assert ended.returncode == 0 and "demo_03" in ended.stdout, ended.stderr
    assert contents(folder / "demo_03") == saved and contents(cut, whole=False) == saved


def test_a_full_disk_ends_the_recording_with_the_reason_and_what_was_written_can_be_read(
    ros_node: Node,
    start_process: StartProcess,
    task_file: Path,
    tmp_path: Path,
    ask: Callable[[str], Trigger.Response],
) -> None:
    robot, folder = Robot(ros_node), tmp_path / "bags"
    process = record(start_process, task_file, "--to", folder, "--json")
    spin_until(ros_node, robot.is_heard, START, "the recorder to listen", (process,))
    ask("start")
    robot.run()
    ask("stop")
    ask("start")
    file = folder / ".partial" / "demo_02" / "demo_02.mcap"
    spin_until(ros_node, lambda: file.stat().st_size > 4000, message="the first flush")
    # no file of the process may grow by more than this: the disk is full for it, as for any other writer
    resource.prlimit(process.pid, resource.RLIMIT_FSIZE, (file.stat().st_size + 4000, resource.RLIM_INFINITY))
    spin_until(ros_node, lambda: process.returncode is not None, message="the end")
    assert process.returncode == 1, process.output
    assert "broke off (File too large)" in process.output and "record --recover" in process.output
    report = json.loads(process.output[process.output.index("{\n") :])
    assert not report["passed"] and [Path(bag["bag"]).name for bag in report["bags"]] == ["demo_01"]
    assert contents(folder / "demo_01")["/tf"] > 20
    assert contents(file.parent, whole=False)["/tf"] > 5


def test_keys_of_a_terminal_start_stop_undo_and_end_and_the_line_says_what_is_missing(
    ros_node: Node, task_file: Path, tmp_path: Path
) -> None:
    robot, folder = Robot(ros_node, cup="can"), tmp_path / "bags"
    ros_node.destroy_publisher(robot.publishers.pop("description"))
    master, slave = pty.openpty()
    command = [sys.executable, "-m", "tpgmm_ros.programs.record", str(task_file), "--to", str(folder)]
    with subprocess.Popen(command, stdin=slave, stdout=slave, stderr=slave) as process:
        os.close(slave)
        shown = ""

        def shows(text: str) -> bool:
            nonlocal shown
            while select.select([master], [], [], 0.0)[0]:
                try:
                    shown += os.read(master, 4096).decode()
                except OSError:  # the other end is closed
                    break
            return text in shown

        def wait_for(condition: Callable[[], bool], what: str) -> None:
            try:
                spin_until(ros_node, condition, START)
            except AssertionError:
                raise AssertionError(f"{what!r} did not come; shown: {shown[-1500:]!r}") from None

        def all_come() -> bool:
            return shows("") and re.search(rate, shown.rsplit(LINE_START, 1)[-1]) is not None

        rate = r"^ready \| cup \x1b\[31mMISSING\x1b\[0m \| .*/tf \d+ Hz .*detections \d+ Hz .*odom \d+ Hz"
        try:
            wait_for(all_come, rate)
            for key, text in ((b"u", "nothing to undo"), (b" ", "recording ")):
                os.write(master, key)
                wait_for(partial(shows, text), text)
            robot.run()
            for key, text in ((b"\n", "MISSING: frame cup"), (b"u", "undone"), (b" ", "demo_02 ")):
                os.write(master, key)
                wait_for(partial(shows, text), text)
            os.write(master, b"q")
            wait_for(lambda: shows("") and process.poll() is not None, "the end")
            assert process.returncode == 0, shown
        finally:
            process.kill()
            os.close(master)
    assert "space or Enter" in shown and "rerun will not draw the robot" in shown
    assert [bag.name for bag in find_bags([folder])] == ["demo_02"]
