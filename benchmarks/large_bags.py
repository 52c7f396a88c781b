# SPDX-License-Identifier: Apache-2.0
"""Memory that `inspect` and `train` take, as bags grow: poses at 100 Hz, mostly beside a camera that nobody wants.

With --bulk poses there is no camera: the poses of the task are all that there is, in recordings of 10 000 samples. Bags
are made in a temporary folder one after the other, and removed: as much free disk is needed as the largest takes. Each
program runs in a process of its own; memory is the largest part of it that was in memory, above what the imports take.
"""

from __future__ import annotations

import argparse
import contextlib
import io
import json
import shutil
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np
from rosbags.rosbag2 import StoragePlugin, Writer
from rosbags.typesys import Stores, get_typestore

from benchmarks.one_by_one import SAMPLES, SETTINGS
from benchmarks.recordings import POSE_STAMPED, TASK, peak_kb, pose_bytes
from benchmarks.recordings import write_bag as write_poses
from benchmarks.report import write_report
from tpgmm_core.common.report import Row
from tpgmm_ros.programs import inspect, train
from tpgmm_ros.recordings.bags import read_demonstration
from tpgmm_ros.task.task_file import Task

IMAGE = "sensor_msgs/msg/CompressedImage"
PICTURE = 200_000
"""Bytes of a picture; noise, which does not compress."""
EACH = 4
"""Poses of the hand, and as many of the object, for each picture."""
PROGRAMS = ["reader", "inspect", "train"]
KB_A_POSE = 2.0
"""That reading, judging and learning may take at once."""
MOST_MB = 64.0
"""By which the memory may grow from the smallest to the largest, beyond what the poses take."""


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


def write_recordings(folder: Path, gigabytes: float) -> int:
    """Recordings of poses alone, copies of one; returns how many."""
    first = folder / "demo_0"
    write_poses(first, 2 * SAMPLES)
    count = max(1, round(gigabytes * 1e9 / size_of(first)))
    for number in range(1, count):
        shutil.copytree(first, folder / f"demo_{number}")
    return count


def size_of(folder: Path) -> int:
    """Bytes of all files."""
    return sum(file.stat().st_size for file in folder.rglob("*") if file.is_file())


def run(program: str, bags: Path, many: bool) -> int:
    """Let a program read bags; returns the number of samples that it found."""
    task = bags.with_name("task.yaml")
    task.write_text(TASK + SETTINGS)
    if program == "reader":
        return len(read_demonstration(bags, Task.from_text(TASK)).times)
    report = bags.with_name("report")
    with contextlib.redirect_stdout(io.StringIO()) as said, contextlib.redirect_stderr(io.StringIO()) as errors:
        if program == "inspect":
            status = inspect.main(["--json", "--separate", "--task", str(task), str(bags)])
        else:
            more = ["--one-by-one", "--every", "10"] if many else []
            given = [
                "--task",
                task,
                "--output",
                bags.with_name("m.tpgmm"),
                "--report",
                report,
                "--separate",
                *more,
                bags,
            ]
            status = train.main([str(argument) for argument in given])
    if status:
        raise RuntimeError(f"{program}: {errors.getvalue()[-500:]}")
    found = json.loads((report / "report.json").read_text() if program == "train" else said.getvalue())
    return int(sum(one["samples"] for one in found["bags" if program == "train" else "demonstrations"]))


def main() -> int:
    """Run the benchmark; returns its exit status."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--gigabytes", type=float, nargs="+", default=[1.0, 2.0, 4.0], help="(default: 1 2 4)")
    parser.add_argument("--bulk", choices=["pictures", "poses"], default="pictures", help="(default: pictures)")
    parser.add_argument("--storage", choices=["mcap", "sqlite3"], default="mcap", help="(with pictures; default: mcap)")
    parser.add_argument("--programs", nargs="+", choices=PROGRAMS, help="(default: all that read such bags)")
    parser.add_argument("--run", nargs=2, metavar=("PROGRAM", "BAGS"), help=argparse.SUPPRESS)
    options = parser.parse_args()
    many = options.bulk == "poses"
    if options.run is not None:
        before, begin = peak_kb(), time.perf_counter()
        count = run(options.run[0], Path(options.run[1]), many)
        print(count, time.perf_counter() - begin, (peak_kb() - before) / 1024.0)
        return 0
    rows: list[Row] = []
    programs = options.programs or (PROGRAMS[1:] if many else PROGRAMS)
    found: dict[str, list[tuple[int, float]]] = {program: [] for program in programs}
    with tempfile.TemporaryDirectory() as folder:
        for size in sorted(options.gigabytes):
            bags = Path(folder) / "bags"
            if many:
                poses = 2 * SAMPLES * write_recordings(bags, size)
            else:
                poses = write_bag(bags, size, StoragePlugin[options.storage.upper()])
            for program in programs:
                command = [sys.executable, __file__, "--bulk", options.bulk, "--run", program, str(bags)]
                done = subprocess.run(command, capture_output=True, text=True)
                if done.returncode:
                    raise RuntimeError(done.stderr)
                samples, seconds, megabytes = map(float, done.stdout.split())
                if not many and 2 * round(samples) != poses:
                    raise RuntimeError(f"{samples} samples came, {poses / 2} are in the bag")
                found[program].append((poses, megabytes))
                rows.append(
                    {
                        "program": program,
                        "GB": size_of(bags) / 1e9,
                        "poses": poses,
                        "samples": round(samples),
                        "s": seconds,
                        "peak MB": megabytes,
                    }
                )
            shutil.rmtree(bags)
    for program, each in found.items():
        grown, more = each[-1][1] - each[0][1], each[-1][0] - each[0][0]
        allowed = MOST_MB + (0.0 if many and program == "train" else KB_A_POSE * more / 1024.0)
        rows.append(
            {"program": f"{program}: growth", "peak MB": grown, "to reach": allowed, "passed": grown <= allowed}
        )
    keys = dict.fromkeys(key for row in rows for key in row)
    name = f"large_bags_{options.bulk}_{options.storage}"
    return write_report(name, [{key: row.get(key) for key in keys} for row in rows])


if __name__ == "__main__":
    sys.exit(main())
