# SPDX-License-Identifier: Apache-2.0
"""Bags: what is read from good ones, and that each kind of bad one ends in a BagError that says why."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from rosbags.rosbag2 import StoragePlugin, Writer
from rosbags.typesys import Stores, get_typestore

from synthetic_bags import REACH_TASK, Storage, Topic, reach, write_bag
from tpgmm_core import Frame
from tpgmm_core.geometry import quaternion
from tpgmm_ros.recordings.bags import (
    BagError,
    align,
    find_bags,
    read_demonstration,
    read_demonstrations,
    read_recording,
    read_recordings,
)
from tpgmm_ros.task.task_file import Task

ROOT = Path(__file__).resolve().parents[3]
VALVE = ROOT.parent / "shared" / "data" / "baxter_valve"
TASK = Task.from_text(REACH_TASK)


@pytest.mark.parametrize("storage", ["mcap", "sqlite3", "ros1"])
def test_a_bag_is_read_as_it_was_written(storage: Storage, tmp_path: Path) -> None:
    topics = reach(0)
    path = write_bag(tmp_path / ("demo.bag" if storage == "ros1" else "demo"), topics, storage)
    demonstration = read_demonstration(path, TASK)
    hand, thing = topics["/endpoint/pose"], topics["/object/pose"]
    np.testing.assert_allclose(demonstration.times, hand.recorded, atol=1e-8)
    np.testing.assert_allclose(demonstration.data[:, 0], hand.recorded, atol=1e-8)
    np.testing.assert_allclose(demonstration.data[:, 1:], hand.poses, atol=1e-12)
    expected = Frame.from_pose(thing.poses[0, :3], thing.poses[0, 3:]).with_time()
    np.testing.assert_allclose(demonstration.frames["object"].at(0).A, expected.A, atol=1e-12)
    np.testing.assert_allclose(demonstration.frames["robot"].A, np.eye(8), atol=1e-12)
    assert demonstration.is_visible("object").all() and demonstration.is_visible("robot").all()


def test_a_storage_file_without_its_directory_is_read(tmp_path: Path) -> None:
    path = write_bag(tmp_path / "demo", reach(0))
    assert len(read_recording(next(path.glob("*.mcap")), TASK).times) == 100


def test_a_frame_holds_its_latest_pose(tmp_path: Path) -> None:
    topics = reach(0, samples=11, duration=1.0)
    moved = np.array([[1.0, 0, 0, 0, 0, 0, 1], [2.0, 0, 0, 0, 0, 0, 1]])
    topics["/object/pose"] = Topic(moved, [0.0, 0.55])
    recording = read_recording(write_bag(tmp_path / "demo", topics), TASK)
    np.testing.assert_array_equal(recording.frames["object"][:, 0], [1.0] * 6 + [2.0] * 5)
    assert recording.to_demonstration().frames["object"].is_time_varying


@pytest.mark.parametrize(("unseen", "known"), [("stays", [1] * 11), ("0.25", [1, 1, 1, 1, 0, 0, 1, 1, 1, 0, 0])])
def test_how_long_a_frame_out_of_sight_is_where_it_was_the_task_says(
    unseen: str, known: list[int], tmp_path: Path
) -> None:
    topics = reach(0, samples=11, duration=1.0)
    topics["/object/pose"] = Topic(np.tile([1.0, 0, 0, 0, 0, 0, 1], (3, 1)), [0.0, 0.1, 0.55])
    task = Task.from_text(REACH_TASK.replace("{topic: object/pose", f"{{topic: object/pose, unseen: {unseen}"))
    recording = read_recording(write_bag(tmp_path / "demo", topics), task)
    assert recording.visible["object"].astype(int).tolist() == known
    notes = [note for note in recording.notes if "object" in note]
    lost = known.count(0)
    assert notes == ([f"object: not known in {lost} of 11 samples, 0.25 s after it was last seen"] if lost else [])


@pytest.mark.parametrize("carried", [True, False])
def test_what_was_seen_to_move_with_the_hand_does_so_out_of_sight_and_other_things_stay(
    carried: bool, tmp_path: Path
) -> None:
    topics = reach(0, samples=41, duration=4.0)
    hand = topics["/endpoint/pose"].poses
    beside = Topic(hand[:21] if carried else hand[20:21], 0.1 * np.arange(21 if carried else 1))
    topics["/object/pose"] = beside  # its place in the hand is the hand's own
    task = Task.from_text(REACH_TASK.replace("{topic: object/pose", "{topic: object/pose, unseen: {with: hand}"))
    recording = read_recording(write_bag(tmp_path / "demo", topics), task)
    assert np.linalg.norm(hand[40, :3] - hand[20, :3]) > 0.05
    assert recording.visible["object"].all()
    assert any("moving with the hand" in note for note in recording.notes) == carried
    np.testing.assert_allclose(recording.frames["object"][40], hand[40 if carried else 20], atol=1e-9)


def test_a_pose_with_the_stamp_of_a_sample_belongs_to_it(tmp_path: Path) -> None:
    topics = reach(0)
    topics["/object/pose"].poses[:, 0] += 1e-3 * np.arange(100)
    recording = read_recording(write_bag(tmp_path / "demo", topics), TASK)
    np.testing.assert_allclose(recording.frames["object"], topics["/object/pose"].poses, atol=1e-12)


def test_a_frame_is_invisible_before_it_was_first_seen(tmp_path: Path) -> None:
    topics = reach(0, samples=11, duration=2.0)
    topics["/object/pose"] = Topic([[1.0, 0, 0, 0, 0, 0, 1]], [0.7])
    recording = read_recording(write_bag(tmp_path / "demo", topics), TASK)
    np.testing.assert_array_equal(recording.visible["object"], recording.times >= 0.7)
    assert any("object: not seen in the first 4 of 11" in note for note in recording.notes)
    assert np.isfinite(recording.frames["object"]).all()


def test_topics_may_start_in_any_order(tmp_path: Path) -> None:
    topics = reach(0, samples=11, duration=2.0)
    topics["/object/pose"] = Topic([[1.0, 0, 0, 0, 0, 0, 1]], [0.45])
    recording = read_recording(write_bag(tmp_path / "demo", topics), TASK)
    assert recording.visible["object"].all() and not recording.notes


def test_a_latched_pose_with_an_old_stamp_is_taken(tmp_path: Path) -> None:
    topics = reach(0)
    topics["/object/pose"].stamps = np.full(100, -600.0)
    recording = read_recording(write_bag(tmp_path / "demo", topics), TASK)
    assert recording.visible["object"].all()
    assert recording.notes == ("/object/pose: 99 messages with repeated stamps dropped",)


def test_stamps_go_before_the_times_of_the_recorder(tmp_path: Path) -> None:
    topics = reach(0)
    hand = topics["/endpoint/pose"]
    stamps = hand.recorded.copy()
    hand.recorded = stamps + np.random.default_rng(0).uniform(0.0, 0.02, len(stamps)).cumsum() * 0.1
    hand.stamps = stamps
    np.testing.assert_allclose(read_recording(write_bag(tmp_path / "demo", topics), TASK).times, stamps, atol=1e-8)


@pytest.mark.parametrize(
    ("spoil", "note"),
    [
        (lambda stamps: None, "stamps of zero|never change"),
        (lambda stamps: stamps[::-1].copy(), "run backwards"),
        (lambda stamps: np.zeros_like(stamps), "never change"),
    ],
)
def test_insane_stamps_give_way_to_the_recorder_and_it_says_so(
    spoil: Callable[[np.ndarray], np.ndarray | None], note: str, tmp_path: Path
) -> None:
    topics = reach(0)
    hand = topics["/endpoint/pose"]
    assert hand.stamps is not None
    hand.stamps = spoil(hand.stamps)
    recording = read_recording(write_bag(tmp_path / "demo", topics), TASK)
    np.testing.assert_allclose(recording.times, hand.recorded, atol=1e-8)
    assert len(recording.notes) == 1
    assert any(part in recording.notes[0] for part in note.split("|"))
    assert "recorder" in recording.notes[0]


@pytest.mark.parametrize("offset", [5.0, -0.4, -4.0, -60.0, -1e6])
def test_a_topic_that_is_stamped_by_another_clock_is_set_right_and_it_says_so(offset: float, tmp_path: Path) -> None:
    topics = reach(0)
    thing = topics["/object/pose"]
    thing.poses[:, 0] += np.linspace(0.0, 0.5, 100)
    recorded = read_recording(write_bag(tmp_path / "right", topics), TASK)
    thing.stamps = thing.recorded + offset
    recording = read_recording(write_bag(tmp_path / "demo", topics), TASK)
    np.testing.assert_allclose(recording.frames["object"], recorded.frames["object"], atol=0.006)
    assert recording.visible["object"].all() and not recording.notes
    (doubt,) = recording.doubts
    assert doubt.kind == "lag" and f"/object/pose is stamped {offset:+.2f} s away from /endpoint/pose" in doubt.text


def test_repeated_stamps_are_dropped_and_counted(tmp_path: Path) -> None:
    topics = reach(0)
    hand = topics["/endpoint/pose"]
    hand.stamps = hand.recorded.copy()
    hand.stamps[[10, 50, 51]] = hand.stamps[[9, 49, 49]]
    recording = read_recording(write_bag(tmp_path / "demo", topics), TASK)
    assert len(recording.times) == 97 and (np.diff(recording.times) > 0).all()
    assert recording.notes == ("/endpoint/pose: 3 messages with repeated stamps dropped",)


def test_quaternion_signs_and_norms_are_tidied(tmp_path: Path) -> None:
    topics = reach(0)
    shown = topics["/endpoint/pose"].poses.copy()
    topics["/endpoint/pose"].poses[:, 3:] *= np.where(np.arange(100) % 3, -1.02, 0.99)[:, None]
    movement = read_recording(write_bag(tmp_path / "demo", topics), TASK).movement
    np.testing.assert_allclose(np.linalg.norm(movement[:, 3:], axis=1), 1.0, atol=1e-12)
    assert (np.sum(movement[1:, 3:] * movement[:-1, 3:], axis=1) > 0.0).all()
    np.testing.assert_allclose(quaternion.angle_between(movement[:, 3:], shown[:, 3:]), 0.0, atol=1e-7)


def test_every_nth_sample_keeps_the_end(tmp_path: Path) -> None:
    path = write_bag(tmp_path / "demo", reach(0, samples=100))
    whole, thin = read_recording(path, TASK), read_recording(path, TASK, every=7)
    assert len(thin.times) == 16 and thin.times[-1] == whole.times[-1]
    np.testing.assert_array_equal(thin.movement[1], whole.movement[7])


def test_a_bag_recorded_in_a_namespace_is_understood(tmp_path: Path) -> None:
    topics = {f"/robot1{name}": topic for name, topic in reach(0).items()}
    topics["/robot2/endpoint/pose"] = reach(1)["/endpoint/pose"]
    recording = read_recording(write_bag(tmp_path / "demo", topics), TASK)
    np.testing.assert_allclose(recording.movement, topics["/robot1/endpoint/pose"].poses, atol=1e-12)


def test_two_namespaces_are_told_apart_by_nobody(tmp_path: Path) -> None:
    topics = {f"/{robot}{name}": topic for robot in ("one", "two") for name, topic in reach(0).items()}
    with pytest.raises(BagError, match="several namespaces.*one/.*two/"):
        read_recording(write_bag(tmp_path / "demo", topics), TASK)


def test_demonstrations_get_the_mean_duration(tmp_path: Path) -> None:
    paths = [write_bag(tmp_path / f"demo_{i}", reach(i, duration=4.0 + i)) for i in range(3)]
    demonstrations, duration = read_demonstrations(paths, TASK)
    assert duration == pytest.approx(5.0)
    for demonstration in demonstrations:
        assert demonstration.times[-1] == demonstration.data[-1, 0] == pytest.approx(5.0)
        assert demonstration.times[50] == pytest.approx(5.0 * 50 / 99)


def test_nothing_to_align_is_said() -> None:
    with pytest.raises(ValueError, match="no recordings"):
        align([])


# Bad bags


def refused(path: Path, complaint: str, task: Task = TASK) -> None:
    """Reading raises a BagError that names the bag and says `complaint`."""
    with pytest.raises(BagError, match=complaint) as raised:
        read_recording(path, task)
    assert str(raised.value).startswith(str(path)) and raised.value.path == path


@pytest.mark.parametrize("storage", ["mcap", "sqlite3", "ros1"])
@pytest.mark.parametrize("absent", ["/endpoint/pose", "/object/pose"])
def test_an_absent_topic_is_named_with_those_that_are_there(absent: str, storage: Storage, tmp_path: Path) -> None:
    topics = reach(0)
    topics["/other/pose"] = topics.pop(absent)
    path = write_bag(tmp_path / ("demo.bag" if storage == "ros1" else "demo"), topics, storage)
    refused(path, f"lacks the topic {absent[1:]};.*topics are .*/other/pose")


def test_a_bag_without_topics_says_so(tmp_path: Path) -> None:
    refused(write_bag(tmp_path / "demo", {}), "holds no message at all|cannot be read")


def test_a_topic_without_messages_is_refused(tmp_path: Path) -> None:
    topics = reach(0)
    topics["/object/pose"] = Topic(np.empty((0, 7)), np.empty(0))
    refused(write_bag(tmp_path / "demo", topics), "object/pose is there, but without a message")


def test_a_topic_of_another_type_is_refused(tmp_path: Path) -> None:
    typestore = get_typestore(Stores.ROS2_JAZZY)
    with Writer(tmp_path / "demo", version=9, storage_plugin=StoragePlugin.MCAP) as writer:
        text = "std_msgs/msg/String"
        for topic in ("/endpoint/pose", "/object/pose"):
            connection = writer.add_connection(topic, text, typestore=typestore)
            writer.write(connection, 1, typestore.serialize_cdr(typestore.types[text](data="here"), text))
    refused(tmp_path / "demo", "is of type std_msgs/msg/String, expected geometry_msgs/msg/PoseStamped")


@pytest.mark.parametrize("storage", ["mcap", "sqlite3", "ros1"])
@pytest.mark.parametrize("share", [0.0, 0.01, 0.3, 0.6, 0.99])
def test_a_truncated_bag_is_refused(share: float, storage: Storage, tmp_path: Path) -> None:
    path = write_bag(tmp_path / ("demo.bag" if storage == "ros1" else "demo"), reach(0, samples=300), storage)
    file = path if storage == "ros1" else next(path.glob("demo.*"))
    content = file.read_bytes()
    file.write_bytes(content[: int(share * len(content))])
    refused(path, "cannot be read|lost messages")


@pytest.mark.parametrize("storage", ["mcap", "sqlite3"])
def test_a_zeroed_block_never_passes_for_a_whole_bag(storage: Storage, tmp_path: Path) -> None:
    for i, place in enumerate((0.2, 0.5, 0.8)):
        path = write_bag(tmp_path / f"demo_{i}", reach(0, samples=500), storage)
        file = next(path.glob("demo_*"))
        content = bytearray(file.read_bytes())
        begin = int(place * len(content))
        content[begin : begin + 8192] = bytes(8192)
        file.write_bytes(content)
        refused(path, "cannot be read|lost messages|lacks the topic|finite|norm|in the frame")


def test_fewer_messages_than_recorded_are_a_loss(tmp_path: Path) -> None:
    path = write_bag(tmp_path / "demo", reach(0))
    metadata = path / "metadata.yaml"
    metadata.write_text(metadata.read_text().replace("message_count: 100", "message_count: 150"))
    refused(path, "lost messages: /endpoint/pose holds 100 of the 150")


def test_a_folder_without_metadata_and_files_is_refused(tmp_path: Path) -> None:
    path = write_bag(tmp_path / "demo", reach(0))
    for file in path.iterdir():
        file.unlink()
    refused(path, "neither metadata.yaml nor a .mcap, .db3 or .bag file")


@pytest.mark.parametrize("content", ["", "{}", "[", "rosbag2_bagfile_information: 3", "\x00"])
def test_a_damaged_metadata_file_is_refused(content: str, tmp_path: Path) -> None:
    path = write_bag(tmp_path / "demo", reach(0))
    (path / "metadata.yaml").write_text(content)
    refused(path, "cannot be read")


def test_a_storage_file_that_is_gone_is_refused(tmp_path: Path) -> None:
    path = write_bag(tmp_path / "demo", reach(0))
    next(path.glob("*.mcap")).unlink()
    refused(path, "cannot be read.*missing")


@pytest.mark.parametrize("size", [0, 3, 20, 60])
def test_a_short_payload_is_refused(size: int, tmp_path: Path) -> None:
    typestore = get_typestore(Stores.ROS2_JAZZY)
    whole = write_bag(tmp_path / "whole", reach(0))
    assert read_recording(whole, TASK)
    with Writer(tmp_path / "demo", version=9, storage_plugin=StoragePlugin.MCAP) as writer:
        for topic in ("/endpoint/pose", "/object/pose"):
            connection = writer.add_connection(topic, "geometry_msgs/msg/PoseStamped", typestore=typestore)
            writer.write(connection, 1, bytes([0, 1, 0, 0] + [0] * 100)[:size])
    refused(tmp_path / "demo", "cannot be read")


NO_POSES = [
    (1, np.nan, "not finite"),
    (2, np.inf, "not finite"),
    (5, np.nan, "not finite"),
    (0, 1e12, "implausibly large"),
    (slice(3, 7), 0.0, "zero quaternion"),
]


@pytest.mark.parametrize("topic", ["/endpoint/pose", "/object/pose"])
@pytest.mark.parametrize(("column", "value", "kind"), NO_POSES)
def test_a_pose_that_is_none_is_left_out_and_said(
    topic: str, column: int | slice, value: float, kind: str, tmp_path: Path
) -> None:
    topics = reach(0)
    whole = read_recording(write_bag(tmp_path / "whole", topics), TASK)
    topics[topic].poses[[7, 50], column] = value
    recording = read_recording(write_bag(tmp_path / "demo", topics), TASK)
    kept = np.delete(np.arange(100), [7, 50]) if topic == "/endpoint/pose" else np.arange(100)
    np.testing.assert_array_equal(recording.movement, whole.movement[kept])
    np.testing.assert_array_equal(recording.frames["object"], whole.frames["object"][kept])
    assert len(recording.notes) == 1
    assert f"{topic}: 2 of 100 poses left out, the first is number 7: {kind}" in recording.notes[0]


@pytest.mark.parametrize("topic", ["/endpoint/pose", "/object/pose"])
@pytest.mark.parametrize(("column", "value", "kind"), NO_POSES)
def test_a_topic_whose_poses_are_mostly_none_is_refused(
    topic: str, column: int | slice, value: float, kind: str, tmp_path: Path
) -> None:
    topics = reach(0)
    topics[topic].poses[20:80, column] = value
    refused(write_bag(tmp_path / "demo", topics), f"{topic} has 60 of 100 poses that cannot be used.* 20: {kind}")


def test_quaternions_of_any_length_are_scaled_and_said(tmp_path: Path) -> None:
    topics = reach(0)
    whole = read_recording(write_bag(tmp_path / "whole", topics), TASK)
    topics["/object/pose"].poses[:, 3:] *= 1.3
    recording = read_recording(write_bag(tmp_path / "demo", topics), TASK)
    np.testing.assert_allclose(recording.frames["object"], whole.frames["object"], atol=1e-12)
    assert recording.notes == ("/object/pose: 100 of 100 quaternions have other lengths than 1 and were scaled",)


def test_a_leading_slash_of_the_frame_id_makes_no_difference(tmp_path: Path) -> None:
    topics = reach(0)
    topics["/object/pose"].frame_id = "/base"
    assert not read_recording(write_bag(tmp_path / "demo", topics), TASK).notes


@pytest.mark.parametrize("frame_id", ["camera", ""])
def test_poses_in_another_frame_are_refused(frame_id: str, tmp_path: Path) -> None:
    topics = reach(0)
    topics["/object/pose"].frame_id = frame_id
    refused(write_bag(tmp_path / "demo", topics), f"/object/pose has poses in the frame '?{frame_id}'?, .*base")


def test_too_few_samples_are_refused(tmp_path: Path) -> None:
    refused(write_bag(tmp_path / "demo", reach(0, samples=9)), "9 samples, expected at least 10")


def test_a_frame_seen_only_after_the_movement_is_refused(tmp_path: Path) -> None:
    topics = reach(0)
    topics["/object/pose"] = Topic([[1.0, 0, 0, 0, 0, 0, 1]], [60.0])
    refused(write_bag(tmp_path / "demo", topics), "first seen after the movement")


def test_one_bad_bag_does_not_lose_the_others(tmp_path: Path) -> None:
    paths = [write_bag(tmp_path / f"demo_{i}", reach(i)) for i in range(4)]
    (paths[1] / "metadata.yaml").write_text("")
    next(paths[2].glob("*.mcap")).unlink()
    seen: list[Path] = []
    good, bad = read_recordings(paths, TASK, progress=seen.append)
    assert [recording.path for recording in good] == [paths[0], paths[3]]
    assert [error.path for error in bad] == [paths[1], paths[2]] and seen == paths
    with pytest.raises(BagError) as raised:
        read_demonstrations(paths, TASK)
    assert raised.value.path == paths[1] and str(paths[2]) in raised.value.__notes__[0]


# Finding bags


def test_a_clock_that_is_set_forward_is_told_from_a_hand_that_went_on(tmp_path: Path) -> None:
    def pause(moved: float) -> str:
        topics = reach(0)
        for topic in topics.values():
            topic.recorded = topic.stamps = topic.recorded + 5.0 * (np.arange(100) >= 50)
        topics["/endpoint/pose"].poses[50:, :3] += moved
        recording = read_recording(write_bag(tmp_path / f"demo_{moved}", topics), TASK)
        return next(doubt.text for doubt in recording.doubts if doubt.kind == "gap")

    assert "pauses for 5.05 s" in pause(0.0) and "it rested, or a clock was set forward" in pause(0.0001)
    assert "what happened there is not known" in pause(0.1)


@pytest.mark.parametrize("factor", [25.0, 1e6])
def test_positions_in_another_unit_that_pass_for_leaps_are_called_so(factor: float, tmp_path: Path) -> None:
    topics = reach(0, duration=2.0)
    topics["/endpoint/pose"].poses[:, :3] *= factor
    with pytest.raises(BagError, match="goes on smoothly, but at .* m/s, .*its positions are not in m"):
        read_recording(write_bag(tmp_path / "demo", topics), TASK)


def test_bags_are_found_in_order_and_once(tmp_path: Path) -> None:
    two, one = (write_bag(tmp_path / name, reach(0)) for name in ("demo_2", "demo_1"))
    old = write_bag(tmp_path / "demo_3.bag", reach(0), "ros1")
    (tmp_path / "README.md").write_text("about the bags")
    (tmp_path / "pictures").mkdir()
    assert find_bags([tmp_path, one]) == [one, two, old]
    assert find_bags([two, one]) == [two, one]


def test_what_holds_no_bag_is_refused(tmp_path: Path) -> None:
    with pytest.raises(BagError, match="does not exist"):
        find_bags([tmp_path / "none"])
    with pytest.raises(BagError, match="is not a bag and contains none"):
        find_bags([tmp_path])
    (tmp_path / "text.txt").write_text("")
    with pytest.raises(BagError, match="is not a bag and contains none"):
        find_bags([tmp_path / "text.txt"])


def test_what_may_hold_bags_but_is_none_is_named(tmp_path: Path) -> None:
    (tmp_path / "demo_1.mcap.gz").write_bytes(b"")
    with pytest.raises(BagError, match="files that are packed; unpack them first: demo_1.mcap.gz"):
        find_bags([tmp_path])
    (tmp_path / "demo_2.mcap").symlink_to(tmp_path / "elsewhere.mcap")
    with pytest.raises(BagError, match="links to what is not there: demo_2.mcap"):
        find_bags([tmp_path])


def test_folders_of_folders_are_named_and_what_is_hidden_is_passed_over(tmp_path: Path) -> None:
    bags = [write_bag(tmp_path / kind / "demo_1", reach(0)) for kind in ("left", "right")]
    (tmp_path / "pictures").mkdir()
    with pytest.raises(BagError, match="bags lie in its folders: left, right. Give those"):
        find_bags([tmp_path])
    (tmp_path / "left" / ".trash").mkdir()
    for name in (".trash/old.mcap", "._demo_1.mcap"):
        (tmp_path / "left" / name).write_bytes(b"")
    assert find_bags([tmp_path / "left"]) == bags[:1]


def test_a_bag_that_is_given_twice_by_other_paths_is_one(tmp_path: Path) -> None:
    bag = write_bag(tmp_path / "demo_1", reach(0))
    (tmp_path / "link").symlink_to(bag)
    assert find_bags([bag, tmp_path / "link", next(bag.glob("*.mcap"))]) == [bag]


# Recordings that nobody here made


@pytest.mark.skipif(not VALVE.is_dir(), reason="the recordings of a real Baxter are not beside the repository")
def test_the_recordings_of_a_real_baxter_are_read() -> None:
    recordings, bad = read_recordings(find_bags([VALVE]), Task.load(ROOT / "config" / "baxter_valve.yaml"))
    assert not bad and len(recordings) == 6
    for recording in recordings:
        assert len(recording.times) == 200 and recording.duration == pytest.approx(19.9) and not recording.notes
        assert (np.sum(recording.movement[1:, 3:] * recording.movement[:-1, 3:], axis=1) > 0.0).all()
        np.testing.assert_array_equal(recording.frames["valve"][0], recording.frames["valve"][-1])
