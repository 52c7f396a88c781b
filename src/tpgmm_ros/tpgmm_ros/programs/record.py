# SPDX-License-Identifier: Apache-2.0
"""record: record demonstrations of a task on any robot, one bag (MCAP) for each, from start to stop.

It records the topics that the task file names (the sources of the hand and of the frames), the joint states, and the
topics that viewers need: robot_description, /tf and /tf_static. At a terminal, space or Enter starts and stops, u
undoes the last demonstration, q quits; the services ~/start, ~/stop and ~/undo (std_srvs/Trigger) do the same. Messages
that are published only once are in every bag. A finished demonstration stays, whatever happens to the program or the
disk; of one that was cut short, all but the last half second is kept in FOLDER/.partial, and `--recover` makes a bag of
it.
"""

from __future__ import annotations

import argparse
import os
import shutil
import sys
import time
from dataclasses import asdict
from pathlib import Path
from typing import Any

import rclpy
from rclpy.executors import Executor
from rclpy.node import Node
from rclpy.utilities import remove_ros_args
from std_srvs.srv import Trigger

from tpgmm_core.common.text import one_line
from tpgmm_ros.nodes.frame_watch import FrameWatch
from tpgmm_ros.programs.record_session import RecordSession, answered
from tpgmm_ros.programs.reporting import json_text, refuse_foreign
from tpgmm_ros.recordings.bag_recorder import BagRecorder
from tpgmm_ros.recordings.recorded_topics import topics_of
from tpgmm_ros.recordings.recovery import recover
from tpgmm_ros.recordings.storage.bag_writer import next_name
from tpgmm_ros.runtime.entry import a_path
from tpgmm_ros.runtime.executor import StopFlag, init
from tpgmm_ros.runtime.keys import LINE_START, Keys, keys_of_terminal
from tpgmm_ros.runtime.rclpy_events import NodeExecutor
from tpgmm_ros.task.task_file import Task

EXAMPLES = """\
examples:
  record config/pick_place.yaml --to bags/mine
  record my_task.yaml --to bags/mine --topic gripper/state --topic /camera/image_raw/compressed
  ros2 service call /record/start std_srvs/srv/Trigger       (from elsewhere: ~/stop and ~/undo too)
  record --to bags/mine --recover bags/mine/.partial/demo_04

exit status: 0 everything was recorded; 1 it was not, the reason is on stderr; 2 wrong arguments
"""
#: After the last signal, s: what came before it is still to be taken.
DRAIN_TIME = 0.3
#: The line of rates is written so often, s.
LINE_PERIOD = 0.5


def main(args: list[str] | None = None) -> int:
    """Record demonstrations; returns the exit status."""
    args = sys.argv if args is None else args
    parser = _parser()
    options = parser.parse_args(remove_ros_args(args)[1:])
    if (options.task is None) == (options.recover is None):
        parser.error("give a task file to record, or --recover and the recordings that were cut off")
    report: dict[str, Any] = {"passed": False, "bags": []}
    try:
        if options.recover is not None:
            _recover(options, report)
        else:
            _record(options, args, report)
        report["passed"] = True
    except (ValueError, OSError, ModuleNotFoundError) as error:
        report["error"] = one_line(error)
        print(f"error: {report['error']}", file=sys.stderr)
    if options.json:
        print(json_text(report))
    return 0 if report["passed"] else 1


def _recover(options: argparse.Namespace, report: dict[str, Any]) -> None:
    for path in options.recover:
        bag = options.to / next_name(options.to)
        duration, counts, left_out = recover(path, bag)
        report["bags"].append({"bag": bag, "duration_s": duration, "messages": counts, "left_out": left_out})
        for text in left_out:
            print(f"left out: {text}", file=sys.stderr)
        if not options.json:
            print(f"{bag}: {duration:.1f} s recovered from {path}")


def _record(options: argparse.Namespace, args: list[str], report: dict[str, Any]) -> None:
    task = Task.load(options.task)
    if options.to.exists() and not options.to.is_dir():
        raise ValueError(f"{options.to} is not a folder; give the folder for the bags")
    refuse_foreign(options.to / "demo_01", b"", "bag")
    init(args)
    stop = StopFlag()
    node = Node("record")
    executor = NodeExecutor()
    executor.add_node(node)
    with keys_of_terminal() as keys:
        screen = _Screen(quiet=options.json)
        try:
            with BagRecorder(node, topics_of(task, options.topic)) as recorder:
                session = RecordSession(recorder, FrameWatch(node, task), options.to, task, screen.say)
                _serve(node, session)
                screen.say(_welcome(options.to, topics_of(task, options.topic), keys, node))
                try:
                    if reason := _loop(executor, stop, keys, session, recorder, screen):
                        raise OSError(reason)
                finally:
                    report["bags"] = [asdict(done) for done in session.done]
        finally:
            screen.clear()
            rclpy.shutdown()


def _welcome(folder: Path, topics: dict[str, str | None], keys: Keys, node: Node) -> str:
    how = "space or Enter: start and stop, u: undo the last one, q: end; or " if keys.there else ""
    name = node.get_fully_qualified_name()
    return f"demonstrations go to {folder}, from {', '.join(topics)}\n{how}services {name}/start, /stop, /undo"


def _serve(node: Node, session: RecordSession) -> None:
    """The services; each answers what happened."""

    def service(act: Any) -> Any:
        def serve(_: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
            response.success, response.message = answered(act)
            return response

        return serve

    for name, act in (("start", session.start), ("stop", session.stop), ("undo", session.undo)):
        node.create_service(Trigger, f"~/{name}", service(act))


def _loop(
    executor: Executor,
    stop: StopFlag,
    keys: Keys,
    session: RecordSession,
    recorder: BagRecorder,
    screen: _Screen,
) -> str:
    """Serve until the end; returns why a recording broke off, in words."""
    acts = {" ": session.toggle, "\n": session.toggle, "u": session.undo}
    told, said = 0.0, set[str]()
    over = False
    while not (over or stop.set or recorder.failure):
        executor.spin_once(timeout_sec=0.05)
        for key in keys.pressed():
            over = over or key in "qQ\x04"
            if not over and (act := acts.get(key.lower())):
                succeeded, words = answered(act)
                if not succeeded:
                    screen.say(f"not done: {words}")
        for topic, trouble in recorder.troubles().items():
            if topic not in said:
                said.add(topic)
                screen.say(f"{topic} is not recorded: {trouble}")
        if time.monotonic() - told > LINE_PERIOD:
            told = time.monotonic()
            screen.line(session.line())
    end = time.monotonic() + (DRAIN_TIME if recorder.recording else 0.0)
    while time.monotonic() < end:
        executor.spin_once(timeout_sec=0.01)
    session.end()
    return recorder.failure


class _Screen:
    """What is said, and below it one line that changes, where there is a terminal."""

    def __init__(self, quiet: bool) -> None:
        self._out = sys.stderr if quiet else sys.stdout
        self._live = sys.stderr.isatty()
        self._colours = self._live and "NO_COLOR" not in os.environ
        self._shown = ""

    def say(self, text: str) -> None:
        self.clear()
        print(text, file=self._out, flush=True)

    def line(self, text: str) -> None:
        if self._live:
            text = text[: shutil.get_terminal_size().columns - 1]
            if self._colours:
                text = text.replace("MISSING", "\x1b[31mMISSING\x1b[0m")
            self._shown = text
            print(f"{LINE_START}{text}", end="", file=sys.stderr, flush=True)

    def clear(self) -> None:
        if self._shown:
            self._shown = ""
            print(LINE_START, end="", file=sys.stderr, flush=True)


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="record",
        usage="%(prog)s [-h] TASK --to FOLDER [--topic NAME ...] [--json] [--ros-args ...]\n"
        "       %(prog)s --to FOLDER --recover CUT [CUT ...]",
        description=__doc__,
        epilog=EXAMPLES,
        formatter_class=argparse.RawDescriptionHelpFormatter,
        allow_abbrev=False,
    )
    parser.add_argument("task", metavar="TASK", nargs="?", type=a_path, help="task file: what is recorded")
    parser.add_argument(
        "--to", metavar="FOLDER", type=a_path, required=True, help="folder of the bags, which are demo_01, demo_02, ..."
    )
    parser.add_argument(
        "--topic",
        metavar="NAME",
        action="append",
        default=[],
        help="record this topic too, of any type; may be repeated",
    )
    parser.add_argument(
        "--recover",
        metavar="CUT",
        nargs="+",
        type=a_path,
        help="make bags of recordings that were cut off",
    )
    parser.add_argument("--json", action="store_true", help="at the end, print what was recorded as JSON")
    return parser


if __name__ == "__main__":
    sys.exit(main())
