# SPDX-License-Identifier: Apache-2.0
"""Files of bags: what is not needed cannot make them unreadable, each damage has its own text, parts are joined."""

import re
import sqlite3
import struct
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from backports import zstd
from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin, Writer
from rosbags.typesys import Stores, get_typestore

from synthetic_bags import POSE_STAMPED, REACH_TASK, Topic, reach, write_bag
from tpgmm_ros.recordings.bags import BagError, find_bags, join_parts, read_recording
from tpgmm_ros.recordings.storage.bag_reader import BagReader, natural_order
from tpgmm_ros.task.task_file import Task

TASK = Task.from_text(REACH_TASK)
STORE = get_typestore(Stores.ROS2_JAZZY)
POSE_TEXT, _ = STORE.generate_msgdef(POSE_STAMPED, ros_version=2)


def text(value: str | bytes) -> bytes:
    content = value.encode() if isinstance(value, str) else value
    return struct.pack("<I", len(content)) + content


def record(opcode: int, content: bytes) -> bytes:
    return struct.pack("<BQ", opcode, len(content)) + content


def channel(key: int, topic: str, encoding: str, kind: str, form: str, definition: bytes) -> bytes:
    """Records that declare a topic; without a schema where its format is empty."""
    schema = record(3, struct.pack("<H", key) + text(kind) + text(form) + text(definition)) if form else b""
    return schema + record(4, struct.pack("<HH", key, key if form else 0) + text(topic) + text(encoding) + text(b""))


def message(key: int, at: int, raw: bytes) -> bytes:
    return record(5, struct.pack("<HIQQ", key, 0, at, at) + raw)


def whole(records: bytes, profile: str = "ros2") -> bytes:
    """A complete MCAP file without index and statistics."""
    magic = b"\x89MCAP0\r\n"
    end = record(0x0F, struct.pack("<I", 0)) + record(2, struct.pack("<QQI", 0, 0, 0))
    return magic + record(1, text(profile) + text("test")) + records + end + magic


def chunk(records: bytes, compression: str = "", checksum: int = 0) -> bytes:
    head = struct.pack("<QQQI", 0, 0, len(records), checksum)
    return record(6, head + text(compression) + struct.pack("<Q", len(records)) + records)


def poses(topics: Mapping[str, Topic], form: str = "ros2msg", definition: bytes = POSE_TEXT.encode()) -> bytes:
    """Records of PoseStamped topics, in the order of writing."""
    types = STORE.types
    declared = b"".join(
        channel(i, name, "cdr", POSE_STAMPED, form, definition) for i, name in enumerate(topics, start=1)
    )
    rows = sorted((at, key, i) for key, topic in enumerate(topics.values(), 1) for i, at in enumerate(topic.recorded))
    content = []
    for at, key, i in rows:
        topic = list(topics.values())[key - 1]
        ns = 1_700_000_000_000_000_000 + round(at * 1e9)
        stamp = types["builtin_interfaces/msg/Time"](sec=ns // 10**9, nanosec=ns % 10**9)
        x, y, z, a, b, c, d = map(float, topic.poses[i])
        pose = types["geometry_msgs/msg/Pose"](
            position=types["geometry_msgs/msg/Point"](x=x, y=y, z=z),
            orientation=types["geometry_msgs/msg/Quaternion"](x=a, y=b, z=c, w=d),
        )
        stamped = types[POSE_STAMPED](header=types["std_msgs/msg/Header"](stamp=stamp, frame_id="base"), pose=pose)
        content.append(message(key, ns, bytes(STORE.serialize_cdr(stamped, POSE_STAMPED))))
    return declared + b"".join(content)


def refused(path: Path, *parts: str) -> None:
    with pytest.raises(BagError) as raised:
        read_recording(path, TASK)
    assert raised.value.path == path and str(raised.value).startswith(str(path))
    for part in parts:
        assert re.search(part, str(raised.value)), (part, str(raised.value))


# What is not needed


OTHERS: dict[str, tuple[Any, ...]] = {
    "a damaged definition": ("cdr", "robot_msgs/msg/Odd", "ros2msg", b"float64 x\n)(*&^ not a field at all ==="),
    "a definition that is no text": ("cdr", "robot_msgs/msg/Odd", "ros2msg", b"\xff\xfe\x00\x80"),
    "an IDL with #include": (
        "cdr",
        "robot_msgs/msg/Odd",
        "ros2idl",
        b'#include "other.idl"\nmodule a { struct B {}; };',
    ),
    "json": ("json", "robot.Odd", "jsonschema", b'{"type": "object"}'),
    "protobuf": ("protobuf", "robot.Odd", "protobuf", bytes(range(256))),
    "an encoding without a schema": ("cbor", "", "", b""),
    "a format that nobody knows": ("cdr", "robot_msgs/msg/Odd", "omgidl4", b"?"),
}


@pytest.mark.parametrize("other", OTHERS)
def test_a_topic_that_is_not_needed_is_never_parsed(other: str, tmp_path: Path) -> None:
    path = tmp_path / "demo.mcap"
    odd = channel(9, "/odd", *OTHERS[other]) + message(9, 1_700_000_000_000_000_001, b"\x01\x02\x03")
    path.write_bytes(whole(odd + poses(reach(0))))
    recording = read_recording(path, TASK)
    np.testing.assert_allclose(recording.movement, reach(0)["/endpoint/pose"].poses, atol=1e-12)
    path.write_bytes(whole(chunk(odd) + chunk(poses(reach(0)))))
    assert len(read_recording(path, TASK).times) == 100


def test_an_unknown_definition_in_sqlite_is_not_parsed(tmp_path: Path) -> None:
    """rosbag2 writes the encoding `unknown` where it did not find the definition of a type."""
    path = write_bag(tmp_path / "demo", reach(0) | {"/other": Topic(np.array([0, 0, 0, 0, 0, 0, 1.0]), 0.0)}, "sqlite3")
    with sqlite3.connect(next(path.glob("*.db3"))) as database:
        database.execute("UPDATE message_definitions SET encoding = 'unknown', encoded_message_definition = ''")
    assert len(read_recording(path, TASK).times) == 100, "the standard types are known without a definition"


@pytest.mark.parametrize(
    ("form", "definition"), [("ros2idl", b'#include "Pose.idl"'), ("ros2msg", b"\xff"), ("protobuf", b"?"), ("", b"")]
)
def test_standard_types_are_known_whatever_their_definition(form: str, definition: bytes, tmp_path: Path) -> None:
    path = tmp_path / "demo.mcap"
    if form:
        path.write_bytes(whole(poses(reach(0), form, definition)))
        assert len(read_recording(path, TASK).times) == 100
    else:
        path.write_bytes(whole(channel(1, "/endpoint/pose", "json", POSE_STAMPED, "jsonschema", b"{}") + poses({})))
        refused(path, "holds no message at all; its topics are /endpoint/pose")


def test_ros1_messages_in_an_mcap_file_are_read(tmp_path: Path) -> None:
    """As 'mcap convert' makes them of ROS 1 bags."""
    path = write_bag(tmp_path / "demo.bag", reach(0), "ros1")
    noetic = get_typestore(Stores.ROS1_NOETIC)
    definition, _ = noetic.generate_msgdef(POSE_STAMPED, ros_version=1)
    records = b""
    with BagReader(path) as reader:
        for key, topic in enumerate(reader.topics, start=1):
            records += channel(key, topic.name, "ros1", "geometry_msgs/PoseStamped", "ros1msg", definition.encode())
            for _, at, content in reader.messages([topic]):
                records += message(key, at, bytes(noetic.serialize_ros1(content, POSE_STAMPED)))
    (tmp_path / "demo.mcap").write_bytes(whole(records, "ros1"))
    one, other = (read_recording(tmp_path / name, TASK) for name in ("demo.bag", "demo.mcap"))
    np.testing.assert_array_equal(one.movement, other.movement)


def test_a_needed_topic_of_another_encoding_is_named(tmp_path: Path) -> None:
    path = tmp_path / "demo.mcap"
    odd = channel(8, "/object/pose", "json", POSE_STAMPED, "jsonschema", b"{}") + message(8, 1, b"{}")
    path.write_bytes(whole(odd + poses({"/endpoint/pose": reach(0)["/endpoint/pose"]})))
    refused(path, "/object/pose has messages in the encoding 'json', expected cdr")


# Files as they come


@pytest.mark.parametrize("identifier", ['""', "mcap_v2", "sqlite3"])
def test_the_format_is_that_of_the_file_whatever_the_metadata_say(identifier: str, tmp_path: Path) -> None:
    path = write_bag(tmp_path / "demo", reach(0))
    metadata = path / "metadata.yaml"
    metadata.write_text(re.sub("storage_identifier: .*", f"storage_identifier: {identifier}", metadata.read_text()))
    assert len(read_recording(path, TASK).times) == 100
    metadata.write_text(re.sub("version: 9", "version: 12", metadata.read_text()))
    assert len(read_recording(path, TASK).times) == 100, "metadata of a later version"


@pytest.mark.parametrize("storage", ["mcap", "sqlite3", "ros1"])
def test_files_packed_by_zstd_are_read_and_left_as_they_are(storage: Any, tmp_path: Path) -> None:
    whole_bag = write_bag(tmp_path / ("demo.bag" if storage == "ros1" else "demo"), reach(0), storage)
    file = whole_bag if storage == "ros1" else next(whole_bag.glob("demo.*"))
    packed = tmp_path / "packed" / f"{file.name}.zst"
    packed.parent.mkdir()
    packed.write_bytes(zstd.compress(file.read_bytes()))
    before = packed.read_bytes()
    assert len(read_recording(packed, TASK).times) == 100
    assert [path.name for path in packed.parent.iterdir()] == [packed.name] and packed.read_bytes() == before
    packed.write_bytes(before[: len(before) // 2])
    refused(packed, "packed by zstd, and was cut off")


@pytest.mark.parametrize(
    ("plugin", "mode"),
    [("MCAP", "MESSAGE"), ("MCAP", "FILE"), ("MCAP", "STORAGE"), ("SQLITE3", "MESSAGE"), ("SQLITE3", "FILE")],
)
def test_every_compression_of_rosbag2_is_read(mode: str, plugin: str, tmp_path: Path) -> None:
    plain = write_bag(tmp_path / "plain", reach(0))
    writer = Writer(tmp_path / "demo", version=9, storage_plugin=StoragePlugin[plugin])
    writer.set_compression(CompressionMode[mode], CompressionFormat.ZSTD)
    with writer, BagReader(plain) as reader:
        connections = {t.name: writer.add_connection(t.name, t.type, typestore=STORE) for t in reader.topics}
        for topic, at, content in reader.messages(reader.topics):
            writer.write(connections[topic.name], at, STORE.serialize_cdr(content, topic.type))
    assert len(read_recording(tmp_path / "demo", TASK).times) == 100


def test_what_sqlite_has_only_in_its_log_is_read_and_nothing_is_written(tmp_path: Path) -> None:
    path = write_bag(tmp_path / "demo", reach(0), "sqlite3")
    file = next(path.glob("*.db3"))
    database = sqlite3.connect(file)
    database.execute("PRAGMA journal_mode = WAL")
    database.execute("PRAGMA wal_autocheckpoint = 0")
    database.execute("DELETE FROM messages WHERE id > 150")
    database.commit()
    (path / "metadata.yaml").unlink()
    before = {item.name: item.read_bytes() for item in path.iterdir()}
    assert "demo.db3-wal" in before
    assert len(read_recording(path, TASK).times) == 75
    assert {item.name: item.read_bytes() for item in path.iterdir()} == before
    database.close()


def test_messages_come_in_the_order_of_writing(tmp_path: Path) -> None:
    topics = reach(0, samples=20)
    hand = topics["/endpoint/pose"].recorded
    records = poses(topics)
    late = poses({"/endpoint/pose": Topic(topics["/endpoint/pose"].poses[:3], hand[:3] - 7.0)})
    for name, content in {"plain": whole(records + late), "chunks": whole(chunk(records) + chunk(late))}.items():
        path = tmp_path / f"{name}.mcap"
        path.write_bytes(content)
        with BagReader(path) as reader:
            wanted = [topic for topic in reader.topics if topic.name == "/endpoint/pose"]
            times = [at for _, at, _ in reader.messages(wanted)]
        assert len(times) == 23 and times[:20] == sorted(times[:20]) and times[20] < times[0]
        assert reader.first_ns == min(times)


# What is wrong


WRONG: dict[str, tuple[bytes, str]] = {
    "empty": (b"", r"empty \(0 bytes\)"),
    "pointer": (b"version https://git-lfs.github.com/spec/v1\n", "is a pointer of Git LFS, not the file itself"),
    "text": (b"This is no bag at all, but a letter.", "format is not known; it begins with b'This is no b"),
    "gzip": (b"\x1f\x8b\x08\x00" + bytes(40), "packed by gzip; unpack it first, with 'gunzip'"),
    "zip": (b"PK\x03\x04" + bytes(40), "packed by zip"),
    "a few bytes": (b"\x89MCA", "cut off after 4 bytes"),
    "cut off": (whole(poses(reach(0)))[:-100], "cut off.*without the footer.*mcap recover"),
    "garbage behind": (whole(poses(reach(0))) + b"more" * 9, "it ends after .*something else of 36 bytes follows"),
    "two files": (2 * whole(poses(reach(0))), "another MCAP file of .* bytes follows.*head -c"),
    "two files of other sizes": (
        whole(chunk(poses(reach(0)))) + whole(poses(reach(1, samples=30))),
        "another MCAP file of .* bytes follows",
    ),
    "damaged": (whole(b"\x00" * 90 + poses(reach(0))), "damaged inside.*no whole record"),
    "unknown compression": (
        whole(chunk(poses(reach(0)), "brotli")),
        "compressed with 'brotli'; lz4 and zstd are known",
    ),
    "not what it says": (whole(chunk(poses(reach(0)), "zstd")), "cannot be unpacked by zstd"),
    "a wrong checksum": (whole(chunk(poses(reach(0)), "", 77)), "does not have its size or its checksum"),
    "other SQLite": (b"", "an SQLite file without messages and topics"),
    "no index": (b"", "has no index.*rosbag reindex"),
}


@pytest.mark.parametrize("kind", WRONG)
def test_each_damage_has_a_text_of_its_own(kind: str, tmp_path: Path) -> None:
    content, words = WRONG[kind]
    path = tmp_path / "demo.mcap"
    path.write_bytes(content)
    if kind == "other SQLite":
        path.unlink()
        with sqlite3.connect(path) as database:
            database.execute("CREATE TABLE cups (name)")
        database.close()
    elif kind == "no index":
        path = write_bag(tmp_path / "demo.bag", reach(0), "ros1")
        bag = path.read_bytes()
        at = bag.index(b"index_pos=") + len(b"index_pos=")
        path.write_bytes(bag[:at] + bytes(8) + bag[at + 8 :])
    refused(path, words)


@pytest.mark.parametrize(("column", "value"), [("timestamp", "'soon'"), ("timestamp", "1.5"), ("data", "'text'")])
def test_values_of_other_kinds_in_sqlite_are_damage(column: str, value: str, tmp_path: Path) -> None:
    bag = write_bag(tmp_path / "demo", reach(0), "sqlite3")
    with sqlite3.connect(next(bag.glob("*.db3"))) as database:
        database.execute(f"UPDATE messages SET {column} = {value} WHERE id = 7")
    database.close()
    refused(bag, "damaged inside.*message [0-9]+ has the time .* expected an integer, ns, and bytes")


def test_a_missing_part_is_named(tmp_path: Path) -> None:
    path = split(tmp_path / "demo", 0)
    (path / "demo_1.mcap").unlink()
    refused(path, "demo_1.mcap is missing, which metadata.yaml names")


# Parts of one recording


def halves(seed: int, latched: bool = True) -> tuple[dict[str, Topic], dict[str, Topic]]:
    """A recording in two parts; the object is published once, or all the time."""
    topics = reach(seed)
    parts = []
    for part in (slice(None, 50), slice(50, None)):
        parts.append({name: Topic(topic.poses[part], topic.recorded[part]) for name, topic in topics.items()})
    if latched:
        del parts[1]["/object/pose"]
        parts[0]["/object/pose"] = Topic(topics["/object/pose"].poses[:1], 0.01)
    return parts[0], parts[1]


def split(path: Path, seed: int) -> Path:
    """A recording split into two files, as `ros2 bag record --max-bag-duration` does."""
    path.mkdir()
    for i, topics in enumerate(halves(seed)):
        (path / f"{path.name}_{i}.mcap").write_bytes(whole(poses(topics)))
    (path / "metadata.yaml").write_text(
        "rosbag2_bagfile_information:\n  version: 9\n  storage_identifier: mcap\n"
        f"  relative_file_paths: [{path.name}_0.mcap, {path.name}_1.mcap]\n"
    )
    return path


def whole_movements(paths: list[Path]) -> list[int]:
    """Which of the recordings of `reach` they are, each whole."""
    found = []
    for path in paths:
        movement = read_recording(path, TASK).movement
        for seed in range(6):
            shown = reach(seed)["/endpoint/pose"].poses
            if movement.shape == shown.shape and np.allclose(movement, shown, atol=1e-9):
                found.append(seed)
    assert len(found) == len(paths)
    return found


def test_a_split_recording_is_one(tmp_path: Path) -> None:
    assert whole_movements(find_bags([split(tmp_path / "demo", 3)])) == [3]
    (tmp_path / "demo" / "metadata.yaml").unlink()
    assert whole_movements([tmp_path / "demo"]) == [3]
    paths = join_parts(find_bags([tmp_path / "demo"]), TASK.movement)
    assert whole_movements(paths) == [3]
    assert read_recording(paths[0], TASK).notes == ("goes on in demo_1.mcap: parts of one recording, read as one",)


@pytest.mark.parametrize("names", ["demo_{seed}_{part}", "{part}_of_{seed}", "{seed}{letter}"])
@pytest.mark.parametrize("storage", ["mcap", "sqlite3"])
def test_halves_given_as_bags_of_their_own_are_joined(names: str, storage: Any, tmp_path: Path) -> None:
    """All demonstrations begin at the same time here: the hand tells which half goes on in which."""
    for seed in range(3):
        for part, topics in enumerate(halves(seed, latched=False)):
            name = names.format(seed=seed, part=part, letter="ab"[part])
            write_bag(tmp_path / name, topics, storage)
    paths = find_bags([tmp_path])
    assert len(paths) == 6
    assert sorted(whole_movements(join_parts(paths, TASK.movement))) == [0, 1, 2]
    assert sorted(whole_movements(join_parts(paths))) == [0, 1, 2]


def test_demonstrations_one_after_the_other_are_not_joined(tmp_path: Path) -> None:
    """The hand begins each of them elsewhere than where it ended the last one."""
    for seed in range(3):
        topics = reach(seed)
        for topic in topics.values():
            topic.recorded = topic.recorded + seed * 5.06
            topic.stamps = topic.recorded
        write_bag(tmp_path / f"demo_{seed}", topics)
    paths = find_bags([tmp_path])
    assert join_parts(paths, TASK.movement) == paths


def test_a_folder_of_bare_files_holds_as_many_bags(tmp_path: Path) -> None:
    for seed in range(3):
        (tmp_path / f"demo_{seed}.mcap").write_bytes(whole(poses(reach(seed))))
    assert sorted(whole_movements(join_parts(find_bags([tmp_path]), TASK.movement))) == [0, 1, 2]
    refused(tmp_path, "3 files that were recorded at the same time.*no parts of one recording")


def test_numbers_in_names_count_by_their_values() -> None:
    names = ["demo_10.mcap", "demo_9.mcap", "demo_9_2.mcap", "a1.mcap"]
    found = sorted(map(Path, names), key=natural_order)
    assert [path.name for path in found] == ["a1.mcap", "demo_9.mcap", "demo_9_2.mcap", "demo_10.mcap"]


def test_a_topic_of_two_types_has_the_messages_of_the_wanted_one(tmp_path: Path) -> None:
    topics, other = reach(0), "geometry_msgs/msg/PoseWithCovarianceStamped"
    definition, _ = STORE.generate_msgdef(other, ros_version=2)
    path = tmp_path / "demo.mcap"
    path.write_bytes(whole(poses(topics) + channel(7, "/object/pose", "cdr", other, "ros2msg", definition.encode())))
    recording = read_recording(path, TASK)
    np.testing.assert_array_equal(recording.frames["object"], topics["/object/pose"].poses)


@pytest.mark.parametrize("folder", ["C:\\\\bags\\\\", "/home/somebody/bags/", "demo/"])
def test_metadata_may_name_files_where_they_were_recorded(folder: str, tmp_path: Path) -> None:
    path = write_bag(tmp_path / "demo", reach(0))
    metadata = path / "metadata.yaml"
    metadata.write_text(metadata.read_text().replace("demo.mcap", f'"{folder}demo.mcap"'))
    assert len(read_recording(path, TASK).times) == 100


def test_metadata_without_a_file_are_called_so_and_given_themselves_mean_their_folder(tmp_path: Path) -> None:
    path = write_bag(tmp_path / "demo", reach(0))
    assert find_bags([path / "metadata.yaml", path / "demo.mcap", path]) == [path]
    metadata = path / "metadata.yaml"
    metadata.write_text(
        re.sub(r"relative_file_paths:\n\s*- demo.mcap", "relative_file_paths: []", metadata.read_text())
    )
    refused(path, "its metadata.yaml names no file, as where the recorder was killed. Remove that file")
