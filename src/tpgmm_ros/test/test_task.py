# SPDX-License-Identifier: Apache-2.0
"""Task files: what is read, and that whatever is wrong ends in a TaskError that says what and where."""

import inspect
from pathlib import Path

import pytest
import yaml
from hypothesis import given
from hypothesis import strategies as st

from tpgmm_core.common.old_names import RENAMED
from tpgmm_core.common.safe_yaml import MAX_BYTES
from tpgmm_core.model.derived_frames import HAND, FrameSource
from tpgmm_core.retrieval.methods import ALL_METHODS, METHODS
from tpgmm_ros.messages.sources import JointStateSource, PoseStampedSource
from tpgmm_ros.task.frames_section import TaskFrameSpec
from tpgmm_ros.task.task_file import Task, TaskError

CONFIG = Path(__file__).resolve().parents[3] / "config"

GOOD = {
    "name": "pick_place",
    "base_frame": "base",
    "movement": "endpoint/left/pose",
    "endpoint": "left",
    "frames": {"object": {"topic": "object/pose"}, "robot": {"pose": [0, 0, 0, 0, 0, 0, 1]}},
    "tracking": {"visible_timeout": 0.25},
    "model": {"n_components": 5, "reg_covar": 1.0e-6, "init": "time"},
}


def changed(**changes: object) -> str:
    return yaml.safe_dump({**GOOD, **changes})


def test_paths_in_a_file_are_from_its_folder_and_the_home_folder_is_known(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    folder = tmp_path / "two  spaces"
    folder.mkdir()
    monkeypatch.setenv("HOME", str(tmp_path))
    for robot, path in (("~/arm.yaml", tmp_path / "arm.yaml"), ("arm.yaml", folder / "arm.yaml")):
        entry = {"joint_states": "joint_states", "robot": robot, "link": "hand"}
        (folder / "task.yaml").write_text(changed(recordings={"movement": entry}))
        source = Task.load(folder / "task.yaml").recorded_movement
        assert isinstance(source, JointStateSource) and source.robot == path


def test_a_robot_file_is_called_so() -> None:
    with pytest.raises(TaskError, match="panda.yaml: the file is a robot file, as it has 'urdf'; expected a task file"):
        Task.load(CONFIG / "panda.yaml")


def gripped(gripper: dict[str, object]) -> str:
    return changed(frames={"object": {"topic": "a", "unseen": {"with": "hand", "gripper": gripper}}})


def without(key: str) -> str:
    return yaml.safe_dump({name: value for name, value in GOOD.items() if name != key})


def test_a_task_file_is_read() -> None:
    task = Task.from_text(yaml.safe_dump(GOOD))
    assert task.movement == "endpoint/left/pose" and task.endpoint == "left"
    assert task.frames["object"] == TaskFrameSpec("object", PoseStampedSource("object/pose"))
    assert task.frames["robot"] == TaskFrameSpec("robot", pose=(0, 0, 0, 0, 0, 0, 1))
    assert task.topics == {"object": "object/pose"}
    assert task.tracking == {"visible_timeout": 0.25}
    assert task.model == {"n_components": 5, "reg_covar": 1e-6, "init": "time"}


@pytest.mark.parametrize("method", ALL_METHODS)
def test_the_model_section_takes_every_setting_of_an_estimator_that_a_file_can_hold(method: str) -> None:
    estimator = ALL_METHODS[method].estimator
    others = {"manifold", "covariance_options", "transitions"}  # of the space and of arrays
    settings = {
        name: parameter.default
        for name, parameter in inspect.signature(estimator).parameters.items()
        if name not in others and parameter.default is not None
    }
    assert "prior_strength" in settings
    assert Task.from_text(changed(model={"retrieval": method, **settings})).model == {"retrieval": method, **settings}


def test_names_of_earlier_versions_are_read_as_the_present_ones() -> None:
    for old, new in RENAMED.items():
        if new in METHODS:
            assert Task.from_text(changed(model={"retrieval": old})).model == {"retrieval": new}


def test_tracking_and_model_may_be_left_out() -> None:
    needed = {key: value for key, value in GOOD.items() if key not in ("tracking", "model")}
    task = Task.from_text(yaml.safe_dump(needed))
    assert task.tracking == {} and task.model == {}


@pytest.mark.parametrize("path", sorted(CONFIG.glob("*.yaml")), ids=lambda path: path.stem)
def test_every_task_file_of_the_project_is_read(path: Path) -> None:
    if "movement:" not in path.read_text():
        pytest.skip("holds parameters of nodes, not a task")
    assert Task.load(path).name == path.stem


def test_frames_keep_the_order_of_the_file() -> None:
    frames = {name: {"topic": f"{name}/pose"} for name in ("zebra", "ant", "moose")}
    text = yaml.safe_dump({**GOOD, "frames": frames}, sort_keys=False)
    assert list(Task.from_text(text).frames) == list(frames)


def test_frames_may_be_derived_from_others_and_from_where_the_hand_starts() -> None:
    frames = {
        "object": {"topic": "object/pose"},
        "place": {"frame": "object", "turned": False},
        "begin": {"hand": "start", "turned": False},
        "grasp": {"hand": "start"},
    }
    task = Task.from_text(changed(frames=frames))
    assert list(task.frames) == ["object"] and list(task.topics) == ["object"]
    assert task.derived.sources == {
        "place": FrameSource("object", turned=False),
        "begin": FrameSource(HAND, turned=False),
        "grasp": FrameSource(HAND),
    }
    assert set(task.space.frame_names) == set(frames)


def test_a_written_quaternion_is_normalised() -> None:
    task = Task.from_text(changed(frames={"table": {"pose": [1, 2, 3, 0, 0, 0.7071, 0.7071]}}))
    pose = task.frames["table"].pose
    assert pose is not None and pose[:3] == (1, 2, 3)
    assert sum(number * number for number in pose[3:]) == pytest.approx(1.0, abs=1e-15)


def test_exponents_without_a_point_are_numbers() -> None:
    assert Task.from_text(changed().replace("1.0e-06", "1e-6")).model["reg_covar"] == 1e-6


@pytest.mark.parametrize("key", ["name", "base_frame", "movement", "endpoint", "frames"])
def test_a_missing_key_is_named(key: str) -> None:
    with pytest.raises(TaskError, match=rf"here\.yaml.*lacks the key '{key}'"):
        Task.from_text(without(key), source="here.yaml")


@pytest.mark.parametrize(
    ("text", "complaint"),
    [
        (changed(mvoement="x"), "unknown key 'mvoement'.*did you mean 'movement'"),
        (changed(name=3), "'name' is 3, expected a name"),
        (changed(base_frame="/base"), "'base_frame'.*without a leading slash"),
        (changed(movement="/endpoint/pose"), "'movement'.*relative topic"),
        (changed(frames={}), "'frames' is empty"),
        (changed(frames=["object"]), r"'frames' is \['object'\], expected a mapping"),
        (changed(frames={"an object": {"topic": "a"}}), "frame name 'an object'"),
        (
            changed(frames={"object": {"topics": "a"}}),
            r"'frames\.object' has the unknown key 'topics'.*'topic'",
        ),
        (changed(frames={"object": {}}), "needs exactly one of 'topic'"),
        (changed(frames={"object": {"topic": "a", "pose": [0, 0, 0, 0, 0, 0, 1]}}), "needs exactly one of"),
        (changed(frames={"object": {"topic": "a", "turned": False}}), "'turned', which is for frames with 'frame'"),
        (changed(frames={"object": {"topic": "a", "unseen": "gone"}}), "'stays' .* or the time in s after which"),
        (changed(frames={"object": {"topic": "a", "unseen": -1}}), "'stays' .* or the time in s after which"),
        (changed(frames={"object": {"topic": "a", "unseen": {"with": "tray"}}}), "{with: hand} .* if it was last seen"),
        (gripped({"topic": "width"}), "lacks the key 'type'"),
        (gripped({"topic": "width", "type": "Float64"}), "the type of the messages, such as sensor_msgs/JointState"),
        (gripped({"topic": "w", "type": "a/B", "above": 1, "below": 1}), "'above' and 'below': give only one"),
        (gripped({"topic": "w", "type": "a/B", "pause": 1}), "pause"),
        (changed(frames={"a": {"topic": "a"}, "b": {"frame": "a", "unseen": "stays"}}), "'unseen', which is for"),
        (changed(frames={"object": {"topic": "a"}, "b": {"frame": "obj"}}), "derived from 'obj'; expected .*: object"),
        (changed(frames={"a": {"topic": "a"}, "b": {"frame": "a"}, "c": {"frame": "b"}}), "derived from 'b'"),
        (changed(frames={"object": {"topic": "a"}, "b": {"frame": "object", "turned": 0}}), "true or false"),
        (changed(frames={"begin": {"hand": "end"}}), "one of start"),
        (changed(frames={"object": {"topic": "a"}, "cup": {"topic": "a"}}), "already used by the frame"),
        (changed(frames={"object": {"topic": "endpoint/left/pose"}}), "already used by the movement"),
        (changed(frames={"table": {"pose": [0, 0, 0, 0, 0, 0, 0]}}), r"'frames\.table\.pose'.*norm 1"),
        (changed(frames={"table": {"pose": [0, 0, 0, 1]}}), "seven finite numbers"),
        (changed(frames={"table": {"pose": [float("nan"), 0, 0, 0, 0, 0, 1]}}), "seven finite numbers"),
        (changed(frames={"table": {"pose": "here"}}), "seven finite numbers"),
        (changed(tracking={"hold_time": -1}), r"'tracking\.hold_time' is -1.*at least 0"),
        (changed(model={"components": 3}), "unknown key 'components'.*did you mean 'n_components'"),
        (changed(model={"n_components": 0}), r"'model\.n_components' is 0.*at least 1"),
        (changed(model={"n_components": True}), "whole number"),
        (changed(model={"init": "random"}), "one of time, kmeans, bins"),
        (changed(model={"reg_covar": "tiny"}), "finite number"),
        (changed(model={"retrieval": "fortune"}), "one of adapt_regress, "),
        (
            changed(model={"decay_rate": 2.0}),
            "'model' does not fit together: unknown settings decay_rate of adapt_regress",
        ),
        (changed(model={"retrieval": "dmp", "stiffness": 0}), "stiffness is 0.0, expected 10 to 10000"),
        ("on: 1", "in quotes"),
        ("name: a\nname: b", "is given twice"),
        ("a: &x 1\nb: *x", "aliases"),
        ("a: 010", "'010' begins with 0, so that YAML reads it as octal"),
        ("a: [", "is not a YAML file"),
        ("a: 1\na: 2", "is not a YAML file that can be read: the key 'a' is given twice in line 2, column 1"),
        ("!!python/object/apply:os.getcwd []", "is not a YAML file"),
        ("!!bool maybe", "is not a YAML file"),
        ("[" * 20_000, "nested too deeply|not a YAML file"),
        ("", "the file is empty, expected a mapping"),
        ("1" * 5000, "expected a mapping|not a YAML file"),
    ],
)
def test_what_is_wrong_is_said(text: str, complaint: str) -> None:
    with pytest.raises(TaskError, match=f"here.yaml.*(?s:{complaint})"):
        Task.from_text(text, source="here.yaml")


def test_files_that_cannot_be_a_task_are_refused(tmp_path: Path) -> None:
    with pytest.raises(TaskError, match="cannot be read"):
        Task.load(tmp_path / "none.yaml")
    with pytest.raises(TaskError, match="cannot be read"):
        Task.load(tmp_path)
    (tmp_path / "binary.yaml").write_bytes(b"\xff\xfe\x00")
    with pytest.raises(TaskError, match="UTF-8"):
        Task.load(tmp_path / "binary.yaml")
    (tmp_path / "large.yaml").write_bytes(b"#" * (MAX_BYTES + 1))
    with pytest.raises(TaskError, match="larger than"):
        Task.load(tmp_path / "large.yaml")


@given(st.text(max_size=200))
def test_garbage_ends_in_a_task_error(text: str) -> None:
    with pytest.raises(TaskError):
        Task.from_text(text)


_VALUES = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | st.text(max_size=8) | st.dates(),
    lambda inner: st.lists(inner, max_size=8) | st.dictionaries(st.text(max_size=8) | st.integers(), inner, max_size=4),
    max_leaves=8,
)


@given(st.sampled_from(sorted(GOOD)), _VALUES)
def test_any_value_under_a_known_key_is_taken_or_refused(key: str, value: object) -> None:
    try:
        task = Task.from_text(changed(**{key: value}))
    except TaskError as error:
        assert str(error).startswith("task: ")
    else:
        assert isinstance(task, Task)


@given(st.integers(0, len(changed())), st.text(min_size=1, max_size=5))
def test_a_task_with_a_typing_slip_is_taken_or_refused(place: int, slip: str) -> None:
    text = changed()
    try:
        Task.from_text(text[:place] + slip + text[place:])
    except TaskError as error:
        assert str(error).startswith("task: ")
