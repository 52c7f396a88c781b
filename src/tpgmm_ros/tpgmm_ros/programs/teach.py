# SPDX-License-Identifier: Apache-2.0
"""teach: record a demonstration of a task, from the topics of a robot that is guided by hand.

It records the topics of the task file until Ctrl-C, while you guide the arm of your robot. With ``--scripted``, a
scripted teacher guides a simulated Baxter instead (package tpgmm_demos): ``teach --scripted --help``.
"""

from __future__ import annotations

import argparse
import sys
import time
from importlib import import_module
from pathlib import Path

import rclpy
from rclpy.node import Node

from tpgmm_core.common.text import one_line
from tpgmm_ros.recordings.bag_recorder import BagRecorder
from tpgmm_ros.recordings.recorded_topics import needed_topics, topics_of
from tpgmm_ros.runtime.entry import a_path, missing
from tpgmm_ros.runtime.executor import StopFlag, init
from tpgmm_ros.runtime.rclpy_events import NodeExecutor
from tpgmm_ros.runtime.resources import config_file
from tpgmm_ros.task.task_file import Task, TaskError

#: After Ctrl-C, s
DRAIN_TIME = 0.3


def record_live(task: Task, output: Path) -> dict[str, int]:
    """Record the task's topics until SIGINT or SIGTERM; returns the number of messages by topic that it needs."""
    init([])
    stop = StopFlag()
    node = Node("teach")
    executor = NodeExecutor()
    executor.add_node(node)
    told = time.monotonic()
    with BagRecorder(node, topics_of(task)).into(output) as recorder:
        print(f"recording {', '.join(topics_of(task))}\nCtrl-C ends the demonstration", file=sys.stderr)
        while not stop.set:
            executor.spin_once(timeout_sec=0.1)
            if time.monotonic() - told > 1.0:
                told = time.monotonic()
                told_counts = ", ".join(f"{topic} {count}" for topic, count in recorder.counts.items())
                print(f"\r{told_counts} ", end="", file=sys.stderr, flush=True)
        # On a busy machine the end is known before all that came earlier was looked at
        end = time.monotonic() + DRAIN_TIME
        while time.monotonic() < end:
            executor.spin_once(timeout_sec=0.01)
        counts = recorder.counts
    print(file=sys.stderr)
    rclpy.shutdown()
    return {topic: counts[topic] for topic in (*needed_topics(task), task.space.joint_states)}


def _scripted() -> int:
    """The scripted teacher, with the same arguments."""
    if reason := missing("tpgmm_demos", "teach --scripted"):
        print(f"error: {reason}", file=sys.stderr)
        return 1
    status: int = import_module("tpgmm_demos.teaching.scripted_lessons").main()
    return status


def main() -> int:
    """Record a demonstration; returns the exit status."""
    if "--scripted" in sys.argv[1:]:
        return _scripted()
    parser = argparse.ArgumentParser(
        prog="teach",
        description=__doc__,
        formatter_class=argparse.RawDescriptionHelpFormatter,
        epilog="example:\n  teach --task config/pick_place.yaml --output bags/mine/demo_01",
        allow_abbrev=False,
    )
    default = config_file("pick_place.yaml")
    parser.add_argument("--task", type=a_path, default=default, help="task file (default: %(default)s)")
    parser.add_argument("--output", type=a_path, required=True, help="the new bag")
    parser.add_argument("--scripted", action="store_true", help="a scripted teacher on a simulated Baxter")
    arguments = parser.parse_args()
    try:
        counts = record_live(Task.load(arguments.task), arguments.output)
        silent = [topic for topic, count in counts.items() if not count]
        if silent:
            print(f"warning: no message arrived on {', '.join(silent)}", file=sys.stderr)
        print(f"{arguments.output}: " + ", ".join(f"{topic} {count}" for topic, count in counts.items()))
    except (TaskError, OSError, ValueError) as error:
        print(f"error: {one_line(error)}", file=sys.stderr)
        return 1
    return 0


if __name__ == "__main__":
    sys.exit(main())
