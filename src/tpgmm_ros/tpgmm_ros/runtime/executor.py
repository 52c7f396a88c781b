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
from collections.abc import Callable
from pathlib import Path
from types import FrameType

import rclpy
from rclpy.exceptions import InvalidParameterTypeException, InvalidParameterValueException
from rclpy.experimental import EventsExecutor
from rclpy.logging import get_logger
from rclpy.node import Node
from rclpy.signals import SignalHandlerOptions
from rclpy.utilities import remove_ros_args

from tpgmm_core.common.text import one_line
from tpgmm_ros.runtime.parameters import Declared
from tpgmm_ros.runtime.rclpy_workarounds import init_rclpy
from tpgmm_ros.runtime.scheduling import request_realtime

REALTIME = Declared(
    "realtime_priority", 0, "Run ahead of ordinary programs (SCHED_FIFO), 1 to 99; 0: as one of them", 0, 99, fixed=True
)


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


def run(make_node: Callable[[], Node], args: list[str] | None = None) -> int:
    """Create a node, serve it until it is told to stop, and end it. Returns the process's exit status.

    A node with a ``loop(executor, stop)`` method is given the thread; any other one answers events.
    A node that cannot start (``ValueError``, ``OSError``, a parameter out of range) ends with status 1 and one line
    that says why; arguments that are not ROS's end with 2.
    """
    args = sys.argv if args is None else args
    _parser(make_node).parse_args(remove_ros_args(args)[1:])
    try:
        init(args)
    except StartError as error:
        print(f"error: {error}", file=sys.stderr)
        return 1
    stop = StopFlag()
    try:
        node = make_node()
    except (ValueError, OSError, InvalidParameterValueException, InvalidParameterTypeException) as error:
        print(f"error: {one_line(error)}", file=sys.stderr)
        rclpy.shutdown()
        return 1
    # The executor's spin() never calls back in the Jazzy wheels; spin_once() in a loop does, and ends with the flag.
    executor = EventsExecutor()
    executor.add_node(node)
    priority = node.declare_parameter(REALTIME.name, REALTIME.default, REALTIME.descriptor()).value
    if priority and (refusal := request_realtime(priority)):
        node.get_logger().warning(f"no real-time priority: {refusal}")
    # What start-up made stays for good; without this, each full collection walks through all of it.
    gc.collect()
    gc.freeze()
    try:
        loop = getattr(node, "loop", None)
        if loop is not None:
            loop(executor, stop)
        else:
            while not stop.set:
                executor.spin_once(timeout_sec=0.1)
    finally:
        executor.remove_node(node)
        node.destroy_node()
        rclpy.shutdown()
    return 0


def _parser(make_node: Callable[[], Node]) -> argparse.ArgumentParser:
    """`--help` of a node: what it is for, and its parameters. It takes no other argument than those of ROS."""
    module = inspect.getmodule(make_node)
    text = [inspect.getdoc(module) or "", "", "parameters (--ros-args -p NAME:=VALUE):"]
    text += [f"  {item.name}: {item.help()}" for item in [*getattr(module, "PARAMETERS", ()), REALTIME]]
    return argparse.ArgumentParser(
        prog=make_node.__module__.rpartition(".")[2].removesuffix("_node"),
        usage="%(prog)s [-h] [--ros-args ...]",
        description="\n".join(text),
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
