# SPDX-License-Identifier: Apache-2.0
"""Bags that hold several demonstrations: cut by times, by rests of the hand, by a topic; the bags stay as they are."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from rosbags.rosbag2 import StoragePlugin, Writer
from rosbags.typesys import Stores, get_typestore

from synthetic_bags import REACH_TASK, START_S, Topic, reach, write_bag
from tpgmm_core.geometry.pose import compose, inverse
from tpgmm_ros.programs import evaluate, inspect, show, train
from tpgmm_ros.recordings.bags import BagError, read_recording, read_recordings, read_takes
from tpgmm_ros.recordings.recorded_topics import topics_of
from tpgmm_ros.task.task_file import Task, TaskError

PAUSE, REACH = 2.0, 4.0
RATE = 25.0


def task_with(takes: str) -> Task:
    return Task.from_text(f"{REACH_TASK}recordings: {{takes: {takes}}}\n")


def lessons(count: int, first_seed: int = 0) -> dict[str, Topic]:
    """The hand rests for 2 s, reaches for 4 s, rests; it is led back within 2 s, and the object is moved meanwhile."""
    hands: list[Any] = []
    objects: list[Any] = []
    reaches = [reach(first_seed + i, samples=round(REACH * RATE) + 1, duration=REACH) for i in range(count)]
    rest, back = round(PAUSE * RATE), round(2.0 * RATE)
    for i, one in enumerate(reaches):
        hand, place = one["/endpoint/pose"].poses, one["/object/pose"].poses
        hands += [np.tile(hand[0], (rest, 1)), hand, np.tile(hand[-1], (rest, 1))]
        objects.append(np.tile(place[0], (2 * rest + len(hand), 1)))
        if i + 1 < count:
            share = np.linspace(0.0, 1.0, back)[:, None]
            way = hand[-1] + share * (reaches[i + 1]["/endpoint/pose"].poses[0] - hand[-1])
            way[:, 3:] /= np.linalg.norm(way[:, 3:], axis=1, keepdims=True)
            hands.append(way)
            objects.append(np.tile(reaches[i + 1]["/object/pose"].poses[0], (back, 1)))
    poses, places = np.vstack(hands), np.vstack(objects)
    times = np.arange(len(poses)) / RATE
    return {"/endpoint/pose": Topic(poses, times), "/object/pose": Topic(places, times)}


#: When the reaches of `lessons` begin, s
BEGINS = [PAUSE + i * (2.0 * PAUSE + REACH + 1.0 / RATE + 2.0) for i in range(4)]


def test_a_bag_is_cut_between_rests_and_stays_as_it_is(tmp_path: Path) -> None:
    topics = lessons(3)
    bag = write_bag(tmp_path / "demo", topics)
    before = {file.name: file.read_bytes() for file in bag.iterdir()}
    takes, bad = read_takes(bag, task_with("{still: 1.0}"))
    assert not bad and [one.name for one in takes] == [f"demo#{i}" for i in range(1, 6)]
    takes, bad = read_takes(bag, task_with("{still: 1.0, every: 2}"))
    assert not bad and [one.name for one in takes] == ["demo#1", "demo#2", "demo#3"]
    for take, begin in zip(takes, BEGINS, strict=False):
        first, last = round((begin) * RATE), round((begin + REACH) * RATE)
        shown = topics["/endpoint/pose"].poses
        np.testing.assert_allclose(take.movement[0, :3], shown[first, :3], atol=0.01)
        np.testing.assert_allclose(take.movement[-1, :3], shown[last, :3], atol=0.01)
        assert REACH - 0.2 <= take.duration <= REACH + 0.8, "half a pause at both sides, less what seems to be rest"
        assert (take.frames["object"] == topics["/object/pose"].poses[first]).all(), "what was seen of this take alone"
        assert not take.doubts
    assert {file.name: file.read_bytes() for file in bag.iterdir()} == before
    assert [one.name for one in read_takes(bag, task_with("{still: 1.0, every: 2}"), every=4)[0]][-1] == "demo#3"
    with pytest.raises(BagError, match="holds 3 takes, expected one"):
        read_recording(bag, task_with("{still: 1.0, every: 2}"))
    still = write_bag(
        tmp_path / "still",
        {**reach(0), "/endpoint/pose": Topic(np.tile([0.4] * 3 + [0, 0, 0, 1], (100, 1)), np.linspace(0, 5, 100))},
    )
    with pytest.raises(BagError, match="no take is found in it: the hand never moves for 0.5 s"):
        read_takes(still, task_with("{still: 1.0}"))


def test_edits_name_takes_and_leave_some_out(tmp_path: Path) -> None:
    bag = write_bag(tmp_path / "demo", lessons(2))
    edits = tmp_path / "demo.edits.yaml"
    edits.write_text("takes:\n- [2.0, 6.0]\n- [12.04, 16.04]\n- [17, 17.2]\n")
    takes, bad = read_takes(bag, Task.from_text(REACH_TASK))
    assert [(one.name, len(one.times)) for one in takes] == [("demo#1", 101), ("demo#2", 101)]
    assert "take 2 of 3: 12.04 to 16.04 s, as its edits say" in takes[1].notes
    assert len(bad) == 1 and "take 3 of 3" in str(bad[0]) and "has 6 samples, expected at least 10" in str(bad[0])
    assert [one.name for one in read_takes(bag, task_with("{still: 9}"))[0]] == ["demo#1", "demo#2"], "edits count"
    edits.write_text("takes: {still: 1.0}\nleave_out: [2]\n")
    assert [one.name for one in read_takes(bag, Task.from_text(REACH_TASK))[0]] == ["demo#1", "demo#3"]
    edits.write_text("takes: {still: 1.0}\nfrom: 7\n")
    assert len(read_takes(bag, Task.from_text(REACH_TASK))[0]) == 2
    good, wrong = read_recordings([bag, tmp_path / "none"], Task.from_text(REACH_TASK))
    assert len(good) == 2 and len(wrong) == 1


@pytest.mark.parametrize(
    ("edits", "words"),
    [
        ("takes: [[3, 2]]", "a list of takes, each"),
        ("takes: [[1, 3], [2, 4]]", "one after the other"),
        ("takes: []", "a list of takes"),
        ("takes: {still: 0}", "a pause of at least 0.05 s, such as 1.0"),
        ("takes: {stil: 1}", "needs exactly one of 'still'"),
        ("takes: [[1, 3], [99, 100]]", "take from 99 s on, and its movement ends after 4.00 s"),
        ("leave_out: [1]", "its edits leave out some of its takes, and it has none"),
        ("takes: [[0, 1]]\nleave_out: [2]", "leave out take 2, and there are 1"),
        ("takes: [[0, 1]]\nleave_out: [1]", "all of its takes are left out"),
        ("takes: {topic: button}", "lacks the topic button; its topics are /endpoint/pose, /object/pose"),
        ('takes: {topic: object/pose, field: "pose.position"}', "is made of other fields"),
        ("takes: {topic: object/pose, field: header.frame_id}", "it is a text"),
        ("takes: {still: 1.0e-9}", "a pause of at least 0.05 s"),
        ("takes: {topic: object/pose, field: pose.weight}", "no field 'weight'; its fields are position, orientation"),
        (
            "takes: {topic: object/pose, field: pose.position.x, above: 9}",
            "above 9 for 0.5 s nowhere.* values are from",
        ),
    ],
)
def test_cuts_that_make_no_sense_are_refused_with_the_reason(edits: str, words: str, tmp_path: Path) -> None:
    bag = write_bag(tmp_path / "demo", reach(0, samples=101, duration=4.0))
    (tmp_path / "demo.edits.yaml").write_text(edits)
    with pytest.raises(BagError, match=words):
        read_takes(bag, Task.from_text(REACH_TASK))


@pytest.mark.parametrize(
    ("takes", "words"),
    [
        ("{topic: /button}", "relative"),
        ("{topic: a, above: 1, below: 2}", "give only one of them"),
        ("{topic: a, lasts: long}", "one of while, until_next"),
        ("{topic: a, field: 'a..b'}", "a field of a message"),
        ("{still: 1, every: 0}", "at least 1"),
        ("7", "expected a mapping"),
    ],
)
def test_task_files_with_other_takes_are_refused(takes: str, words: str) -> None:
    with pytest.raises(TaskError, match=words):
        task_with(takes)


def with_signals(path: Path, topics: dict[str, Topic], late_s: float = 0.0) -> Path:
    """The bag of `lessons`, with a button and a gripper that say when a reach goes on; recorded later than stamped."""
    store = get_typestore(Stores.ROS2_JAZZY)
    types: Any = store.types
    written = write_bag(
        path.with_name(f"{path.name}_poses"),
        {name: Topic(one.poses, one.recorded + late_s, one.recorded) for name, one in topics.items()},
    )
    from rosbags.highlevel import AnyReader

    with AnyReader([written]) as reader, Writer(path, version=9, storage_plugin=StoragePlugin.MCAP) as writer:
        same = {c.id: writer.add_connection(c.topic, c.msgtype, typestore=store) for c in reader.connections}
        button = writer.add_connection("/button", "std_msgs/msg/Bool", typestore=store)
        gripper = writer.add_connection("/gripper/joint_states", "sensor_msgs/msg/JointState", typestore=store)
        for connection, at, raw in reader.messages():
            writer.write(same[connection.id], at, raw)
        header = types["std_msgs/msg/Header"](types["builtin_interfaces/msg/Time"](0, 0), "")
        empty = np.empty(0)
        was: bool | None = None
        for k in range(round(20.0 * RATE)):
            at = k / RATE
            goes = any(begin <= at + 1e-9 <= begin + REACH for begin in BEGINS[:2])
            ns = round((START_S + late_s + at) * 1e9)
            message = types["std_msgs/msg/Bool"](goes)
            if goes is not was:
                writer.write(button, ns, store.serialize_cdr(message, "std_msgs/msg/Bool"))
            was = goes
            position = np.array([0.3, 0.04 - 0.03 * goes])
            state = types["sensor_msgs/msg/JointState"](header, ["arm", "finger"], position, empty, empty)
            writer.write(gripper, ns, store.serialize_cdr(state, "sensor_msgs/msg/JointState"))
    return path


@pytest.mark.parametrize(
    "takes",
    [
        "{topic: button}",
        '{topic: gripper/joint_states, field: "position[finger]", below: 0.02}',
        '{topic: gripper/joint_states, field: "position[1]", below: 0.02, pause: 0.1}',
    ],
)
def test_a_topic_cuts_a_bag_by_the_times_at_which_the_recorder_heard_both(takes: str, tmp_path: Path) -> None:
    bag = with_signals(tmp_path / "demo", lessons(2), late_s=0.4)
    found, bad = read_takes(bag, task_with(takes))
    assert not bad and [one.name for one in found] == ["demo#1", "demo#2"]
    for one in found:
        assert abs(one.duration - REACH) < 2.0 / RATE
        np.testing.assert_allclose(one.movement[0, :3], [0.4, 0.4, 0.4], atol=0.01)
    until_next = read_takes(bag, task_with(f"{takes[:-1]}, lasts: until_next}}"))[0]
    np.testing.assert_allclose(until_next[0].duration, BEGINS[1] - BEGINS[0], atol=2.0 / RATE)


def test_what_a_gripper_holds_goes_with_the_hand_in_a_recording(tmp_path: Path) -> None:
    topics = lessons(1)
    hand = topics["/endpoint/pose"]
    beside = hand.poses[0] + np.array([0.0, 0.0, 0.03, 0.0, 0.0, 0.0, 0.0])
    topics["/object/pose"] = Topic(np.tile(beside, (10, 1)), hand.recorded[:10])  # then the hand covers it
    bag = with_signals(tmp_path / "demo", topics)
    gripper = '{topic: gripper/joint_states, type: sensor_msgs/JointState, field: "position[finger]", below: 0.02}'
    unseen = f"{{topic: object/pose, unseen: {{with: hand, gripper: {gripper}}}"
    task = Task.from_text(REACH_TASK.replace("{topic: object/pose", unseen))
    assert topics_of(task)["gripper/joint_states"] == "sensor_msgs/msg/JointState"
    found = read_recording(bag, task)
    k = [round((BEGINS[0] + at) * RATE) for at in (-0.4, 0.0, 0.5 * REACH, REACH)]  # before, from the beginning on
    np.testing.assert_allclose(found.frames["object"][k[0]], beside, atol=1e-12)
    place = compose(inverse(found.movement[k[1]]), beside)
    for at in k[2:]:
        np.testing.assert_allclose(found.frames["object"][at], compose(found.movement[at], place), atol=1e-9)
    after = found.frames["object"][k[3] + 2 :]
    np.testing.assert_allclose(after, np.tile(after[0], (len(after), 1)), atol=1e-12)
    assert any("moving with the hand" in note for note in found.notes)


def test_a_recorder_of_the_task_records_what_cuts() -> None:
    assert topics_of(task_with("{topic: button}"))["button"] is None


def test_only_what_is_left_of_a_bag_is_doubted(tmp_path: Path) -> None:
    """A pause, a leap and a late frame lie outside of what the edits leave; inside they are said."""
    topics = reach(0, samples=126, duration=5.0)
    hand, place = topics["/endpoint/pose"], topics["/object/pose"]
    kept = (hand.recorded < 0.5) | (hand.recorded > 1.5)
    late = place.recorded > 1.0
    hand.poses[120:, :3] += [0.0, 0.0, 0.7]
    bag = write_bag(
        tmp_path / "demo",
        {
            "/endpoint/pose": Topic(hand.poses[kept], hand.recorded[kept]),
            "/object/pose": Topic(place.poses[late], place.recorded[late]),
        },
    )
    task = Task.from_text(REACH_TASK)
    whole = read_recording(bag, task)
    assert [doubt.kind for doubt in whole.doubts] == ["gap"] and not whole.visible["object"].all()
    assert any("leap" in note for note in whole.notes)
    (tmp_path / "demo.edits.yaml").write_text("from: 2\nto: 4.6\n")
    cut = read_recording(bag, task)
    assert not cut.doubts and cut.visible["object"].all() and len(cut.notes) == 1, cut.notes


# -- clocks of a bag, and of its takes

TAKES = "takes: [[2.0, 6.0], [12.04, 16.04]]\n"


def on_clocks(step: float, at: float, lag: float = 0.0, unstamped_until: float = -1.0) -> dict[str, Topic]:
    """Two reaches; from a time on, all clocks have been set by a step; the object's stamps are late until then."""
    found = {}
    for name, topic in lessons(2).items():
        when = topic.recorded
        shown = when + step * (when >= at)
        stamps = np.where(when < unstamped_until, -START_S, shown - lag * (when < at) * (name == "/object/pose"))
        found[name] = Topic(topic.poses, shown, stamps, written=when)
    return found


@pytest.mark.parametrize("step", [-0.8, -300.0, 300.0])
def test_a_clock_that_steps_between_takes_does_no_harm(step: float, tmp_path: Path) -> None:
    task = Task.from_text(REACH_TASK)
    bags = [write_bag(tmp_path / "steady", lessons(2)), write_bag(tmp_path / "demo", on_clocks(step, 9.0))]
    with pytest.raises(BagError, match="clock steps by .* or select the part before or after the step in the edits"):
        read_recording(bags[1], task)
    for bag, later in zip(bags, (0.0, max(step, 0.0)), strict=True):
        begin, end = 12.04 + later, 16.04 + later - (0.04 if step < 0.0 and bag is bags[1] else 0.0)
        (tmp_path / f"{bag.name}.edits.yaml").write_text(f"takes: [[2.0, 6.0], [{begin}, {end}]]\n")
    steady, found = (read_takes(bag, task) for bag in bags)
    assert not found[1] and len(found[0]) == 2
    for one, other in zip(steady[0], found[0], strict=True):
        count = len(other.times)
        assert len(one.times) - 1 <= count and not other.doubts
        np.testing.assert_allclose(one.times[:count], other.times, atol=1e-6)
        np.testing.assert_array_equal(one.movement[:count], other.movement)
        np.testing.assert_array_equal(one.frames["object"][:count], other.frames["object"])
        assert other.visible["object"].all()


def test_a_clock_that_steps_in_a_take_refuses_that_one_alone(tmp_path: Path) -> None:
    bag = write_bag(tmp_path / "demo", on_clocks(-0.8, 14.0))
    (tmp_path / "demo.edits.yaml").write_text(TAKES)
    good, bad = read_takes(bag, Task.from_text(REACH_TASK))
    assert [one.name for one in good] == ["demo#1"] and len(bad) == 1
    assert "take 2 of 2" in str(bad[0]) and "the clock steps by -0.7" in str(bad[0])
    (tmp_path / "demo.edits.yaml").write_text("to: 13\n")
    assert read_recording(bag, Task.from_text(REACH_TASK)).duration == pytest.approx(13.0, abs=0.05)
    (tmp_path / "demo.edits.yaml").unlink()
    good, bad = read_takes(bag, task_with("{still: 1.0, every: 2}"))
    assert [one.name for one in good] == ["demo#1"] and "the clock steps" in str(bad[0])


def test_each_take_has_the_stamps_and_the_lag_that_it_has(tmp_path: Path) -> None:
    task = Task.from_text(REACH_TASK)
    bag = write_bag(tmp_path / "late", on_clocks(0.0, 9.0, lag=4.0))
    (tmp_path / "late.edits.yaml").write_text(TAKES)
    good, bad = read_takes(bag, task)
    assert not bad and [[doubt.kind for doubt in one.doubts] for one in good] == [["lag"], []]
    bag = write_bag(tmp_path / "unstamped", on_clocks(0.0, 9.0, unstamped_until=8.0))
    (tmp_path / "unstamped.edits.yaml").write_text(TAKES)
    good, bad = read_takes(bag, task)
    assert not bad and [any("recorder's times" in note for note in one.notes) for one in good] == [True, False]
    assert [len(one.times) for one in good] == [101, 101]


def test_an_object_seen_once_before_the_clock_stepped_stays_where_it_was(tmp_path: Path) -> None:
    topics = on_clocks(-300.0, 9.0)
    once = topics["/object/pose"]
    assert once.stamps is not None and once.written is not None
    topics["/object/pose"] = Topic(once.poses[:1], once.recorded[:1], once.stamps[:1], written=once.written[:1])
    bag = write_bag(tmp_path / "demo", topics)
    (tmp_path / "demo.edits.yaml").write_text("takes: [[12.0, 15.9]]\n")
    (take,), bad = read_takes(bag, Task.from_text(REACH_TASK))
    assert not bad and take.visible["object"].all() and (take.frames["object"] == once.poses[0]).all()


def test_pauses_within_a_demonstration_are_no_reason_to_cut_it(capsys: pytest.CaptureFixture[str]) -> None:
    """In these bags the hand rests for a second where it grasps."""
    bags = Path(__file__).resolve().parents[3] / "bags" / "pick_place"
    assert inspect.main(["--json", str(bags / "demo_01"), str(bags / "demo_02")]) == 0
    assert json.loads(capsys.readouterr().out)["hints"] == []


def test_programs_see_the_takes(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    write_bag(tmp_path / "bags" / "demo_1", lessons(2))
    write_bag(tmp_path / "bags" / "demo_2", lessons(2, 2))
    bags, suggested = str(tmp_path / "bags"), tmp_path / "suggested.yaml"
    assert inspect.main(["--json", "--write", str(suggested), bags]) == 0
    found = json.loads(capsys.readouterr().out)
    assert len(found["demonstrations"]) == 4 and not found["doubts"], found
    assert found["demonstrations"][1]["name"].endswith("demo_1#2")
    assert "{still: 1.0, every: 2}" in suggested.read_text()
    assert "holds 3 movements between pauses of 1 s; every second one begins" in found["hints"][0]
    task, model = tmp_path / "task.yaml", str(tmp_path / "m.tpgmm")
    task.write_text(f"{REACH_TASK}recordings: {{takes: {{still: 1.0, every: 2}}}}\n")
    assert train.main(["--task", str(task), "--output", model, "--every", "4", "--leave-one-out", bags]) == 0
    assert "demo_2#1" in capsys.readouterr().out
    assert show.main(["--json", model]) == 0
    assert json.loads(capsys.readouterr().out)["learned_from"] == ["demo_1#1", "demo_1#2", "demo_2#1", "demo_2#2"]
    assert evaluate.main(["--task", str(task), "--json", "--methods", "promp", "--every", "4", bags]) == 0
    assert len(json.loads(capsys.readouterr().out)["results"][0]["demonstrations"]) == 4
