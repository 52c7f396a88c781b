# SPDX-License-Identifier: Apache-2.0
"""Task files with several movements: each is a task of its own, seen from the other hands too."""

from pathlib import Path

import pytest
import yaml
from hypothesis import given
from hypothesis import strategies as st

from tpgmm_core.model.derived_frames import HAND, FrameSource
from tpgmm_ros.messages.sources import PoseStampedSource
from tpgmm_ros.task.task_file import Task, TaskError

CONFIG = Path(__file__).resolve().parents[3] / "config"

TWO = {
    "name": "carry",
    "base_frame": "base",
    "movements": {"left": {"topic": "hands/l"}, "right": {"topic": "hands/r", "frames": ["left", "begin"]}},
    "frames": {"table": {"topic": "table/pose"}, "begin": {"hand": "start"}, "above": {"frame": "table"}},
    "model": {"n_components": 3},
}


def two(**changes: object) -> str:
    said = {key: value for key, value in {**TWO, **changes}.items() if value is not None}
    return yaml.safe_dump(said, sort_keys=False)


def test_each_movement_is_a_task_that_sees_the_other_hands() -> None:
    left, right = (Task.from_text(two(), movement=name) for name in ("left", "right"))
    assert (left.name, left.movement, left.endpoint) == ("carry_left", "hands/l", "left")
    assert (right.name, right.movement, right.endpoint) == ("carry_right", "hands/r", "right")
    assert left.sources == {"table": PoseStampedSource("table/pose"), "right": PoseStampedSource("hands/r")}
    assert right.sources == {"left": PoseStampedSource("hands/l")}, "it is seen from what it names alone"
    assert left.derived.sources == {"begin": FrameSource(HAND), "above": FrameSource("table")}
    assert right.derived.sources == {"begin": FrameSource(HAND)}
    assert left.model == right.model == {"n_components": 3}


def test_the_place_of_another_hand_may_be_a_frame_without_its_turn() -> None:
    text = two(
        frames={"place": {"frame": "right", "turned": False}},
        movements={"left": {"topic": "l"}, "right": {"topic": "r"}},
    )
    assert Task.from_text(text, movement="left").derived.sources == {"place": FrameSource("right", turned=False)}


def test_which_movement_is_meant_stands_behind_the_path(tmp_path: Path) -> None:
    path = tmp_path / "carry.yaml"
    path.write_text(two())
    assert Task.load(f"{path}#right").movement == "hands/r"
    assert Task.load(Path(f"{path}#left")).movement == "hands/l"
    odd = tmp_path / "a#b.yaml"  # a file may be called so
    odd.write_text("{name: one, base_frame: base, movement: m, endpoint: e, frames: {a: {topic: a}}}")
    assert Task.load(odd).name == "one"
    with pytest.raises(TaskError, match=r"one movement only: give its path without '#left'"):
        Task.load(f"{odd}#left")
    with pytest.raises(TaskError, match=r"movements left, right: say which one is meant, such as \S+carry.yaml#left"):
        Task.load(path)
    with pytest.raises(TaskError, match=r"'movements' has no 'middle'; expected one of left, right"):
        Task.load(f"{path}#middle")
    with pytest.raises(TaskError, match="cannot be read"):
        Task.load(tmp_path / "none.yaml#left")


def test_the_file_of_the_project_is_read() -> None:
    for hand, other in (("left", "right"), ("right", "left")):
        task = Task.load(f"{CONFIG}/bowl_and_spoon.yaml#{hand}")
        assert task.name == f"bowl_and_spoon_{hand}" and task.topics[other] == f"endpoint/{other}/pose"


@pytest.mark.parametrize(
    ("text", "complaint"),
    [
        (two(movement="m"), "'movements' and 'movement': leave one of them out"),
        (two(endpoint="e"), "'movements' and 'endpoint': leave one of them out"),
        (two(kinematic={}), "'movements' and 'kinematic': leave one of them out"),
        (two(recordings={"pose_array": "a", "takes": {"still": 1}}), "'recordings' has pose_array, which is about one"),
        (two(movements=["left"]), "'movements' is .*, expected a mapping"),
        (two(movements={"left": {"topic": "l"}}), "fewer than two: for one movement write"),
        (two(movements={"left": {"topic": "l"}, "the right": {"topic": "r"}}), "end point 'the right': use letters"),
        (two(movements={"left": {"topic": "l"}, "right": {}}), r"'movements\.right' lacks the key 'topic'"),
        (two(movements={"left": {"topic": "/l"}, "right": {"topic": "r"}}), r"'movements\.left\.topic' .* relative"),
        (two(movements={"left": {"topic": "l"}, "right": {"topic": "r", "frame": ["a"]}}), "did you mean 'frames'"),
        (two(movements={"left": {"topic": "l"}, "right": {"topic": "l"}}), "already used by the movement"),
        (two(movements={"left": {"topic": "l", "frames": []}, "right": {"topic": "r"}}), "a list of names"),
        (
            two(movements={"left": {"topic": "l", "frames": ["left"]}, "right": {"topic": "r"}}),
            r"'movements\.left' is seen from left; expected .*: table, begin, above, right",
        ),
        (
            two(movements={"left": {"topic": "l", "frames": ["above"]}, "right": {"topic": "r"}}),
            "seen from 'above', which is derived from 'table': add that frame too",
        ),
        (two(frames={"right": {"topic": "a"}}), "right in 'frames' and in 'movements': give the frame another name"),
        (two(name=3), "'name' is 3, expected a name"),
    ],
)
def test_what_is_wrong_with_several_movements_is_said(text: str, complaint: str) -> None:
    with pytest.raises(TaskError, match=f"here.yaml.*(?s:{complaint})"):
        Task.from_text(text, source="here.yaml", movement="left")


def test_hands_alone_may_see_each_other() -> None:
    text = two(frames=None, movements={"left": {"topic": "l"}, "right": {"topic": "r"}})
    assert list(Task.from_text(text, movement="right").frames) == ["left"]


_VALUES = st.recursive(
    st.none() | st.booleans() | st.integers() | st.text(max_size=8) | st.sampled_from(["left", "right", "table"]),
    lambda inner: (
        st.lists(inner, max_size=4)
        | st.dictionaries(st.sampled_from(["left", "right", "topic", "frames", "frame", "a b"]), inner, max_size=4)
    ),
    max_leaves=8,
)


@given(st.sampled_from(["movements", "frames", "recordings"]), _VALUES, st.sampled_from(["left", "right", "", None]))
def test_any_movements_are_taken_or_refused(key: str, value: object, movement: str | None) -> None:
    try:
        task = Task.from_text(yaml.safe_dump({**TWO, key: value}), movement=movement)
    except TaskError as error:
        assert str(error).startswith("task: ")
    else:
        assert isinstance(task, Task) and movement in ("left", "right")
