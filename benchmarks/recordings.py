# SPDX-License-Identifier: Apache-2.0
"""How fast messages of a bag become a demonstration, against rosbags alone deserialising them; and the memory of both.

Half of the messages are of the hand, half of an object. Each way runs in a process of its own, by turns.
"""

from __future__ import annotations

import argparse
import struct
import subprocess
import sys
import tempfile
import time
from functools import cache
from pathlib import Path

import numpy as np
from rosbags.highlevel import AnyReader
from rosbags.rosbag2 import StoragePlugin, Writer
from rosbags.typesys import Stores, get_typestore

from benchmarks.report import write_report
from tpgmm_core.common.report import Row
from tpgmm_ros.recordings.bags import read_demonstration
from tpgmm_ros.task.task_file import Task

POSE_STAMPED = "geometry_msgs/msg/PoseStamped"
TASK = """\
name: reach
base_frame: base
movement: hand/pose
endpoint: left
frames: {object: {topic: object/pose}}
"""
RATE_HZ = 1000.0
SHARE = 0.8
"""Of the speed of rosbags alone that is to be reached."""
MOST_KB = 1.0
"""For each message, at the peak."""


def pose_bytes(ns: int, angle: float, beside: int) -> bytes:
    """A serialised pose at a time, ns, on a circle; `beside` it that many times 0.2 m."""
    raw = bytearray(_first())
    struct.pack_into("<iI", raw, 4, ns // 1_000_000_000, ns % 1_000_000_000)
    struct.pack_into("<dd", raw, len(raw) - 56, 0.4 + 0.2 * np.cos(angle), 0.2 * beside + 0.2 * np.sin(angle))
    return bytes(raw)


@cache
def _first() -> bytes:
    store = get_typestore(Stores.ROS2_JAZZY)
    kinds = store.types
    stamp = kinds["builtin_interfaces/msg/Time"](0, 0)
    pose = kinds["geometry_msgs/msg/Pose"](
        kinds["geometry_msgs/msg/Point"](0.0, 0.0, 0.0), kinds["geometry_msgs/msg/Quaternion"](0.0, 0.0, 0.0, 1.0)
    )
    first = kinds[POSE_STAMPED](kinds["std_msgs/msg/Header"](stamp, "base"), pose)
    return bytes(store.serialize_cdr(first, POSE_STAMPED))


def write_bag(path: Path, count: int) -> None:
    """A hand on a slow curve, and an object beside it, without noise; `count` messages in all."""
    store = get_typestore(Stores.ROS2_JAZZY)
    with Writer(path, version=9, storage_plugin=StoragePlugin.MCAP) as writer:
        topics = [writer.add_connection(name, POSE_STAMPED, typestore=store) for name in ("/hand/pose", "/object/pose")]
        for k in range(count // 2):
            ns = round(1e9 * (1.0 + k / RATE_HZ))
            for i, topic in enumerate(topics):
                writer.write(topic, ns, pose_bytes(ns, 6.0 * k / (count // 2), i))


def deserialise(path: Path) -> int:
    """What rosbags does alone; returns the number of messages."""
    with AnyReader([path]) as reader:
        return sum(1 for topic, _, raw in reader.messages() if reader.deserialize(raw, topic.msgtype) is not None)


def demonstrate(path: Path) -> int:
    """What the programs do; returns the number of messages that the demonstration is made of, frame and hand."""
    demonstration = read_demonstration(path, Task.from_text(TASK))
    return 2 * len(demonstration.times)


def measured(way: str, path: Path, count: int) -> tuple[float, float]:
    """Time in s, and peak of the memory above what the imports take, MB, in a process of its own."""
    run = subprocess.run(
        [sys.executable, __file__, "--way", way, str(path), str(count)], capture_output=True, text=True, check=True
    )
    seconds, megabytes = run.stdout.split()
    return float(seconds), float(megabytes)


def _run(way: str, path: Path, expected: int) -> None:
    before, begin = peak_kb(), time.perf_counter()
    count = deserialise(path) if way == "rosbags" else demonstrate(path)
    seconds = time.perf_counter() - begin
    if count != expected:
        raise RuntimeError(f"{count} messages came by {way}, {expected} are in the bag")
    print(seconds, (peak_kb() - before) / 1024.0)


def peak_kb() -> int:
    """Largest memory of this process so far; what getrusage says is that of its parent, too."""
    return int(next(line for line in Path("/proc/self/status").read_text().splitlines() if "VmHWM" in line).split()[1])


def main() -> int:
    """Run the benchmark; returns its exit status."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--messages", type=int, default=1_000_000, help="in the bag (default: 1000000)")
    parser.add_argument("--repeat", type=int, default=3, help="times that each way runs (default: 3)")
    parser.add_argument("--way", nargs=3, metavar=("WAY", "BAG", "COUNT"), help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.way is not None:
        _run(options.way[0], Path(options.way[1]), int(options.way[2]))
        return 0
    with tempfile.TemporaryDirectory() as folder:
        bag = Path(folder) / "bag"
        write_bag(bag, options.messages)
        count = options.messages // 2 * 2
        found = [[measured(way, bag, count) for way in ("rosbags", "demonstration")] for _ in range(options.repeat)]
    alone, ours = np.median(np.array(found), axis=0)
    share = float(alone[0] / ours[0])
    grown = 1024.0 * float(ours[1]) / options.messages
    rows: list[Row] = [
        {"way": "rosbags alone", "messages": options.messages, "s": float(alone[0]), "peak MB": float(alone[1])},
        {"way": "demonstration", "messages": options.messages, "s": float(ours[0]), "peak MB": float(ours[1])},
        {"way": "share of the speed of rosbags", "s": share, "to reach": SHARE, "passed": share >= SHARE},
        {"way": "memory, kB a message", "peak MB": grown, "to reach": MOST_KB, "passed": grown <= MOST_KB},
    ]
    return write_report(
        "recordings", [{key: row.get(key) for key in dict.fromkeys(k for r in rows for k in r)} for row in rows]
    )


if __name__ == "__main__":
    sys.exit(main())
