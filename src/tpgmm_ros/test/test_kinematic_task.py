# SPDX-License-Identifier: Apache-2.0
"""Kinematic frames in task files, and models that are learned from joint states and poses of objects in bags."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from rosbags.rosbag2 import StoragePlugin, Writer
from rosbags.typesys import Stores, get_typestore

from tpgmm_core import TPGMM
from tpgmm_ros.models.task_model import load_task_model, make_task_retrieval
from tpgmm_ros.programs import train
from tpgmm_ros.recordings.bags import BagError, read_recording
from tpgmm_ros.task.kinematic_section import KinematicSpec
from tpgmm_ros.task.state_space import PoseSpace
from tpgmm_ros.task.task_file import Task, TaskError

ROOT = Path(__file__).resolve().parents[3]
TASK_FILE = ROOT / "config" / "left_first.yaml"
STORE = get_typestore(Stores.ROS2_JAZZY)


def text(**changes: str) -> str:
    """The task file with lines in place of others: what each key's line is to be."""
    lines = TASK_FILE.read_text().replace("robot: baxter.yaml", f"robot: {ROOT}/config/baxter.yaml").splitlines()
    return "\n".join(changes.get(line.split(":")[0].strip(), line) for line in lines)


def test_levels_and_postures_are_frames_and_say_what_they_aim_at() -> None:
    spec = Task.load(TASK_FILE).space
    assert isinstance(spec, KinematicSpec)
    assert list(spec.candidates) == [
        "bar",
        "left below bar",
        "right below bar, left",
        "right below bar",
        "left below bar, right",
        "left + right below bar",
        "posture below bar, left, right",
        "previous",
    ]
    assert set(spec.candidates) - set(spec.aiming) == {"bar", "posture below bar, left, right"}
    assert spec.joints()[:2] == ("left_s0", "left_s1") and len(spec.joints()) == 14
    assert spec.frames().objects == {"left_target", "right_target"}


@pytest.mark.parametrize(
    ("key", "line", "words"),
    [
        ("bar", "    bar: {point: right, relative_to: right}", "has the point 'right' relative to itself"),
        ("left", "    left: {point: left, relative_to: right, aim: object}", "expected one of the task's frames"),
        ("left", "    left: {point: left, part: nose, relative_to: left_target}", "position, orientation, pose"),
        ("together", "    together: [bar, [left, left]]", "each task once"),
        ("together", "    together: [bar, [nose]]", "levels, most important first"),
        ("postures", "  postures: [bar]", "a list of lists of tasks"),
        ("joints", "  joints: []", "joints or groups of joints"),
        ("threshold", "  thresold: 0.1", "did you mean 'threshold'"),
        ("model", "model: {retrieval: dmp}", "unknown key 'retrieval'"),
    ],
)
def test_what_does_not_describe_kinematic_frames_is_refused_with_what_was_expected(
    key: str, line: str, words: str
) -> None:
    source = text(**{key: line}) if key != "threshold" else text(joints=f"  joints: [left_arm, right_arm]\n{line}")
    with pytest.raises(TaskError, match=words):
        Task.from_text(source)


@pytest.mark.parametrize(
    ("key", "line", "words"),
    [
        ("joints", "  joints: [nose]", "unknown joints nose"),
        ("bar", "    bar: {point: nose, relative_to: left}", "nose"),
        ("bar", "    bar: {point: right, relative_to: nose}", "either a frame of the task"),
    ],
)
def test_what_the_robot_has_not_is_refused_when_it_is_there(key: str, line: str, words: str) -> None:
    with pytest.raises(ValueError, match=words):
        Task.from_text(text(**{key: line})).space.joints()


def write_bag(path: Path, task: Task, broken: str = "") -> None:
    """Both hands rest while the targets come nearer; joints in another order, with an unknown one among them."""
    names = [*reversed(task.space.joints()), "head_pan"]
    if broken == "joint":
        names = names[1:]
    types = STORE.types
    Time, Header = types["builtin_interfaces/msg/Time"], types["std_msgs/msg/Header"]
    Pose, Point = types["geometry_msgs/msg/Pose"], types["geometry_msgs/msg/Point"]
    Quaternion, PoseStamped = types["geometry_msgs/msg/Quaternion"], types["geometry_msgs/msg/PoseStamped"]
    JointState = types["sensor_msgs/msg/JointState"]
    rng = np.random.default_rng(len(path.name))
    with Writer(path, version=9, storage_plugin=StoragePlugin.MCAP) as writer:
        poses = {
            topic: writer.add_connection(f"/{topic}", "geometry_msgs/msg/PoseStamped", typestore=STORE)
            for topic in (task.movement, *task.topics.values())
        }
        states = writer.add_connection("/joint_states", "sensor_msgs/msg/JointState", typestore=STORE)
        for i in range(60):
            ns = 1_000_000_000 + i * 20_000_000
            header = Header(stamp=Time(sec=ns // 10**9, nanosec=ns % 10**9), frame_id=task.base_frame)
            for j, connection in enumerate(poses.values()):
                if broken == "object" and i < 40 and j == 1:
                    continue
                place = Point(x=0.6 + 0.001 * i + 0.01 * rng.normal(), y=0.2 * (1 - j), z=0.1)
                message = PoseStamped(header, Pose(place, Quaternion(x=0.0, y=0.0, z=0.0, w=1.0)))
                writer.write(connection, ns, STORE.serialize_cdr(message, message.__msgtype__))
            if broken == "late" and i < 40:
                continue
            if broken == "clock":  # that of the robot's driver is ahead
                header = Header(stamp=Time(sec=ns // 10**9 + 30, nanosec=ns % 10**9), frame_id=task.base_frame)
            positions = np.arange(len(names)) + 0.01 * i
            if broken == "nan":
                positions[3] = np.nan
            empty = np.zeros(0)
            several = [(names, positions)]
            if broken == "parts":  # of two drivers, and those of a gripper between them
                fingers = (["finger", "finger"], np.full(2, np.nan))
                several = [(names[:6], positions[:6]), fingers, (names[6:], positions[6:])]
            for part, values in several:
                state = JointState(header, part, values, empty, empty)
                writer.write(states, ns, STORE.serialize_cdr(state, state.__msgtype__))


def test_configurations_are_read_by_joint_names(tmp_path: Path) -> None:
    task = Task.load(TASK_FILE)
    write_bag(tmp_path / "good", task)
    recording = read_recording(tmp_path / "good", task, every=2)
    assert recording.configurations is not None and recording.configurations.shape == (len(recording.times), 14)
    np.testing.assert_allclose(recording.configurations[0], np.arange(14)[::-1])
    np.testing.assert_allclose(np.diff(recording.configurations[:-1], axis=0), 0.02, atol=1e-9)
    assert read_recording(tmp_path / "good", replace(task, space=PoseSpace(tuple(task.frames)))).configurations is None
    write_bag(tmp_path / "clock", task, "clock")
    recorded = read_recording(tmp_path / "clock", task, every=2)
    # the joints of these bags go up to 13, which looks like degrees
    assert [doubt.kind for doubt in recorded.doubts] == ["lag", "units"] and recorded.configurations is not None
    np.testing.assert_allclose(recorded.configurations, recording.configurations, atol=1e-9)
    write_bag(tmp_path / "part", task, "parts")
    parts = read_recording(tmp_path / "part", task, every=2)
    assert parts.configurations is not None
    np.testing.assert_array_equal(parts.configurations, recording.configurations)


@pytest.mark.parametrize(
    ("broken", "words"),
    [
        ("joint", "never has all joints of the task: missing right_w2"),
        ("nan", "not finite"),
        ("late", "does not cover the movement, by 0.8 s"),
    ],
)
def test_joint_states_that_cannot_be_used_are_named(tmp_path: Path, broken: str, words: str) -> None:
    task = Task.load(TASK_FILE)
    write_bag(tmp_path / "bad", task, broken)
    with pytest.raises(BagError, match=words):
        read_recording(tmp_path / "bad", task)


def test_an_object_that_was_not_seen_from_the_start_is_named(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    task = Task.load(TASK_FILE)
    for name, broken in (("good", ""), ("late", "object")):
        write_bag(tmp_path / "bags" / name, task, broken)
    output = str(tmp_path / "model.tpgmm")
    assert train.main(["--task", str(TASK_FILE), "--output", output, str(tmp_path / "bags")]) == 1
    said = capsys.readouterr().err
    assert "late: left_target: not seen in the first 40" in said
    assert "demonstration 1: left_target was not seen from the start" in said


def test_a_model_fits_the_task_that_it_was_learned_for_and_no_other(tmp_path: Path) -> None:
    task, path = Task.load(TASK_FILE), tmp_path / "model.tpgmm"
    for name in ("one", "other"):
        write_bag(tmp_path / "bags" / name, task)
    arguments = ["--task", str(TASK_FILE), "--output", str(path), str(tmp_path / "bags")]
    assert train.main([*arguments, "--retrieval", "dmp"]) == 1
    assert train.main([*arguments, "--every", "3"]) == 0
    model = load_task_model(path, task)
    assert model.dimensions_ == task.space.joints()
    np.testing.assert_array_equal(model.means_["left below bar"], 0.0)
    assert np.abs(model.means_["bar"]).max() > 0.1
    movement = make_task_retrieval(model, task)
    assert movement.frame_names == ("left_target", "right_target") and movement.manifold.dim == 14
    with pytest.raises(ValueError, match="by one method, kinematic; got 'dmp'"):
        make_task_retrieval(model, task, "dmp")
    with pytest.raises(ValueError, match="phase 'state' is for .*: kinematic .* leave 'phase' at 'clock'"):
        make_task_retrieval(model, task, phase="state")
    other = Task.from_text(text(together="    together: [[left, right]]"))
    with pytest.raises(ValueError, match="kinematic frames differ from those"):
        load_task_model(path, other)
    TPGMM(1).fit_projected({"a": np.random.default_rng(0).normal(size=(20, 2))}).save(path)
    with pytest.raises(ValueError, match="not learned from the task.s kinematic frames"):
        load_task_model(path, task)
