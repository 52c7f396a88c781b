# SPDX-License-Identifier: Apache-2.0
"""Memory that `inspect` and `train` take, as bags grow: poses at 100 Hz, mostly beside a camera that nobody wants.

With --bulk poses there is no camera: the poses of the task are all that there is, in recordings of 10 000 samples. Bags
are made in a temporary folder one after the other, and removed: as much free disk is needed as the largest takes. Each
program runs in a process of its own; memory is the largest part of it that was in memory, above what the imports take.
"""

from __future__ import annotations

import argparse
import shutil
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np
from rosbags.rosbag2 import StoragePlugin, Writer
from rosbags.typesys import Stores, get_typestore

from benchmarks.recordings import POSE_STAMPED, TASK, peak_kb, pose_bytes
from benchmarks.report import write_report
from tpgmm_core.common.report import Row
from tpgmm_ros.recordings.bags import read_demonstration
from tpgmm_ros.task.task_file import Task

IMAGE = "sensor_msgs/msg/CompressedImage"
PICTURE = 200_000
"""Bytes of a picture; noise, which does not compress."""
EACH = 4
"""Poses of the hand, and as many of the object, for each picture."""
MOST_MB = 64.0
"""By which the memory may grow from the smallest bag to the largest, beyond what the poses take."""


def write_bag(path: Path, gigabytes: float, storage: StoragePlugin) -> int:
    """A bag of this size; returns the number of messages with poses."""
    store = get_typestore(Stores.ROS2_JAZZY)
    pictures = round(gigabytes * 1e9 / PICTURE)
    noise = np.random.default_rng(0).bytes(4 * PICTURE)
    with Writer(path, version=9, storage_plugin=storage) as writer:
        hand, thing = (
            writer.add_connection(name, POSE_STAMPED, typestore=store) for name in ("/hand/pose", "/object/pose")
        )
        camera = writer.add_connection("/camera", IMAGE, typestore=store)
        for k in range(EACH * pictures):
            ns = round(1e9 * (1.0 + 0.01 * k))
            for i, topic in enumerate((hand, thing)):
                writer.write(topic, ns, pose_bytes(ns, 6.0 * k / (EACH * pictures), i))
            if k % EACH == 0:
                begin = (k * 977) % (3 * PICTURE)
                writer.write(camera, ns, noise[begin : begin + PICTURE])
    return 2 * EACH * pictures


def main() -> int:
    """Run the benchmark; returns its exit status."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--gigabytes", type=float, nargs="+", default=[0.5, 1.0, 2.0], help="(default: 0.5 1 2)")
    parser.add_argument("--storage", choices=["mcap", "sqlite3"], default="mcap", help="(default: mcap)")
    parser.add_argument("--read", type=Path, help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.read is not None:
        before, begin = peak_kb(), time.perf_counter()
        count = len(read_demonstration(options.read, Task.from_text(TASK)).times)
        print(count, time.perf_counter() - begin, (peak_kb() - before) / 1024.0)
        return 0
    rows: list[Row] = []
    found: list[tuple[int, float]] = []
    with tempfile.TemporaryDirectory() as folder:
        for size in sorted(options.gigabytes):
            bag = Path(folder) / "bag"
            poses = write_bag(bag, size, StoragePlugin[options.storage.upper()])
            there = sum(file.stat().st_size for file in bag.iterdir())
            run = subprocess.run(
                [sys.executable, __file__, "--read", str(bag)], capture_output=True, text=True, check=True
            )
            samples, seconds, megabytes = map(float, run.stdout.split())
            shutil.rmtree(bag)
            if 2 * round(samples) != poses:
                raise RuntimeError(f"{samples} samples came, {poses / 2} are in the bag")
            found.append((poses, megabytes))
            rows.append(
                {"storage": options.storage, "GB": there / 1e9, "poses": poses, "s": seconds, "peak MB": megabytes}
            )
    grown = found[-1][1] - found[0][1]
    allowed = MOST_MB + (found[-1][0] - found[0][0]) / 1024.0
    rows.append({"storage": "growth", "peak MB": grown, "to reach": allowed, "passed": grown <= allowed})
    keys = dict.fromkeys(key for row in rows for key in row)
    return write_report(f"large_bags_{options.storage}", [{key: row.get(key) for key in keys} for row in rows])


if __name__ == "__main__":
    sys.exit(main())
