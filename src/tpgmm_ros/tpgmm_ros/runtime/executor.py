# SPDX-License-Identifier: Apache-2.0
"""One way to run a node: events as they come, a clean end on SIGINT and SIGTERM, pauses of the collector kept out."""

from __future__ import annotations

import argparse
import gc
import inspect
import os
import signal
import sys
import tempfile
from collections.abc import Callable, Sequence
from pathlib import Path
from types import FrameType
from typing import Any

import rclpy
from rclpy.exceptions import InvalidParameterTypeException, InvalidParameterValueException
from rclpy.executors import Executor
from rclpy.logging import get_logger
from rclpy.node import Node
from rclpy.signals import SignalHandlerOptions
from rclpy.utilities import remove_ros_args

from tpgmm_core.common.text import one_line
from tpgmm_ros.runtime.composition import Member, composed, end
from tpgmm_ros.runtime.parameters import Declared
from tpgmm_ros.runtime.rclpy_events import NodeExecutor
from tpgmm_ros.runtime.rclpy_workarounds import init_rclpy
from tpgmm_ros.runtime.scheduling import cores_of, lock_memory, request_realtime, run_on

#: Of every process: nodes that share one agree on them, or the most that one of them asks for is done.
PROCESS = [
    Declared(
        "realtime_priority",
        0,
        "Real-time priority (SCHED_FIFO), 1 to 99; 0: none",
        0,
        99,
        fixed=True,
    ),
    # 2 is a number in YAML, and 2-3 is a text
    Declared("cpu_cores", "", "Cores to run on, such as 2 or 2-3; empty: all", fixed=True, any_type=True),
    Declared("lock_memory", False, "Keep the memory of the process from being paged out", fixed=True),
]


class StopFlag:
    """Set by SIGINT and SIGTERM.

    rclpy's own handlers shut the context down at once, and a controller could no longer publish its last, safe
    command; so they are not installed, and a node gets to end in its own words (``destroy_node``).
    """

    def __init__(self) -> None:
        self.set = False
        for name in (signal.SIGINT, signal.SIGTERM):
            signal.signal(name, self._handle)

    def _handle(self, number: int, frame: FrameType | None) -> None:
        self.set = True


class StartError(ValueError):
    """ROS cannot be started as the arguments and the environment say; the text says why."""


def init(args: list[str]) -> None:
    """Start rclpy; its signal handlers are left out (see `StopFlag`), and so is a log file that cannot be written.

    A robot's controller that does not come up since a disk is full would be worse than one without a log file: what it
    has to say is still on the terminal and on /rosout.

    Parameters
    ----------
    args
        command line with arguments of ROS

    Raises
    ------
    StartError
        arguments that ROS does not take, or an environment that it cannot start in.
    """
    if reason := _no_log_file():
        args = [*args, "--ros-args", "--disable-external-lib-logs"]
    try:
        init_rclpy(args=args, signal_handler_options=SignalHandlerOptions.NO)
    except RuntimeError as error:  # RCLError, UnknownROSArgsError, and what C++ throws
        raise StartError(one_line(error)) from None
    if reason:
        get_logger("rclpy").warning(
            f"no log file is written: {reason}. Set ROS_LOG_DIR to a directory that can be written"
        )


def _no_log_file() -> str:
    """Why ROS's log file cannot be written, in words; empty where it can. The directory is made where it is missing."""
    directory = os.environ.get("ROS_LOG_DIR") or os.path.join(os.environ.get("ROS_HOME") or "~/.ros", "log")
    try:
        path = Path(directory).expanduser()
        path.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=path):
            return ""
    except (OSError, RuntimeError, ValueError) as error:  # no home; a null character
        return one_line(f"{directory}: {getattr(error, 'strerror', None) or error}", 300)


def run(node_class: Callable[[], Node], args: list[str] | None = None) -> int:
    """Create a node, serve it until it is told to stop, and end it.

    A node with a ``loop(executor, stop)`` method is given the thread; any other one answers events.
    A node that cannot start (``ValueError``, ``OSError``, a parameter out of range) ends with status 1 and one line
    that says why; arguments that are not ROS's end with 2.

    Parameters
    ----------
    node_class
        makes the node
    args
        of the command line; None: those of this process

    Returns
    -------
    int
        exit status of the process
    """
    args = sys.argv if args is None else args
    _parser(node_class).parse_args(remove_ros_args(args)[1:])
    return serve([node_class], args)


def run_together(classes: Sequence[type[Node]], args: list[str]) -> int:
    """The same for nodes that share this process (see `composition.composed`).

    What one of them raises ends that one alone. The status is 1 then, once the others have been told to stop.

    Parameters
    ----------
    classes
        of the nodes, in the order of the data
    args
        of the command line

    Returns
    -------
    int
        exit status of the process
    """
    return serve(composed(classes), args)


def serve(classes: Sequence[Callable[[], Node]], args: list[str]) -> int:
    """Create nodes, serve them until they are told to stop or the loop of one is over, and end them.

    Parameters
    ----------
    classes
        make the nodes
    args
        of the command line

    Returns
    -------
    int
        exit status of the process

    Raises
    ------
    ValueError
        for several nodes that each make time go on
    """
    try:
        init(args)
    except StartError as error:
        print(f"error: {error}", file=sys.stderr)
        return 1
    stop = StopFlag()
    nodes: list[Node] = []
    try:
        for node_class in classes:
            nodes.append(node_class())
        loops = [node for node in nodes if hasattr(node, "loop")]
        if len(loops) > 1:
            names = " and ".join(node.get_name() for node in loops)
            raise ValueError(f"{names} cannot share a process: each of them controls the simulated time")
        _prepare_process(nodes)
    except (ValueError, OSError, InvalidParameterValueException, InvalidParameterTypeException) as error:
        print(f"error: {one_line(error)}", file=sys.stderr)
        _end(nodes)
        return 1
    # The executor's spin() never calls back in the Jazzy wheels; spin_once() in a loop does, and ends with the flag.
    executor = NodeExecutor()
    for node in nodes:
        executor.add_node(node)
        if isinstance(node, Member) and node.failure is not None:  # at something that another one said as it started
            node.leave()
    try:
        is_over = any([_loop(node, executor, stop) for node in loops])
        while not (is_over or stop.set or all(map(_failed, nodes))):
            executor.spin_once(timeout_sec=0.1)
    finally:
        for node in nodes:
            if not _failed(node):
                executor.remove_node(node)
        ended = _end(nodes)
    return int(not ended or any(map(_failed, nodes)))


def _loop(node: Any, executor: Executor, stop: StopFlag) -> bool:
    """Give a node the thread; whether it came to its end, which is that of the process.

    Where others share the process, what it raises is the end of this node alone.
    """
    try:
        node.loop(executor, stop)
    except Exception as error:
        if not isinstance(node, Member):
            raise
        node.fail(error)
        return False
    return True


def _failed(node: Node) -> bool:
    return isinstance(node, Member) and node.failure is not None


def _end(nodes: Sequence[Node]) -> bool:
    """End nodes in the order of the data: who reads goes on as long as somebody writes. Whether all ended in order."""
    ended = True
    for node in nodes:
        if isinstance(node, Member) and _failed(node):
            node.leave()  # if it has not yet
        else:
            ended &= end(node)  # whatever that raises, the next one still has its last words to say
    rclpy.shutdown()
    return ended


def _prepare_process(nodes: Sequence[Node]) -> None:
    """What a loop needs of its process. Raises ValueError for cores that there are not."""
    given = [
        [node.declare_parameter(item.name, item.default, item.descriptor()).value for item in PROCESS] for node in nodes
    ]
    priorities, cores, locks = zip(*given, strict=True)
    refusals = []
    if chosen := set[int]().union(*(cores_of(str(item)) for item in cores)):
        run_on(chosen)
    # What start-up made stays for good; without this, each full collection walks through all of it.
    gc.collect()
    gc.freeze()
    if any(locks) and (refusal := lock_memory()):
        refusals.append(f"memory is not locked: {refusal}")
    if max(priorities) and (refusal := request_realtime(max(priorities))):
        refusals.append(f"no real-time priority: {refusal}")
    for text in refusals:
        nodes[0].get_logger().warning(text)


def _parser(make_node: Callable[[], Node]) -> argparse.ArgumentParser:
    """`--help` of a node: what it is for, and its parameters. It takes no other argument than those of ROS."""
    module = inspect.getmodule(make_node)
    return argparse.ArgumentParser(
        prog=make_node.__module__.rpartition(".")[2],
        usage="%(prog)s [-h] [--ros-args ...]",
        description="\n".join(
            [inspect.getdoc(module) or "", "", *parameter_help([*getattr(module, "PARAMETERS", ())])]
        ),
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )


def parameter_help(declared: Sequence[Declared]) -> list[str]:
    """Lines of `--help` on the parameters of a node, with those that every process has."""
    lines = [f"  {item.name}: {item.help()}" for item in [*declared, *PROCESS]]
    return ["parameters (--ros-args -p NAME:=VALUE):", *lines]
