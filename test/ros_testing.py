# SPDX-License-Identifier: Apache-2.0
"""Tests on the level of topics: real processes on a ROS domain of their own, polled with deadlines.

The fixtures of this module are there for every test of the repository. A test that asks for `ros_domain`,
`ros_node` or `start_process` is alone on its domain, also when several test runs share the machine. Starting a node
takes a while: `module_domain`, `module_node` and `start_module_process` are shared by the tests of one file.
"""

from __future__ import annotations

import contextlib
import itertools
import os
import random
import shlex
import signal
import subprocess
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest

from forked_processes import ForkedProcess
from tpgmm_ros.runtime.processes import end_with_parent

if TYPE_CHECKING:
    from rclpy.node import Node

# Processes that are started as users do start Python twice and import much; a busy machine takes long for both
STARTUP_TIMEOUT = 60.0
# What Python writes where nobody has thought of an error
TRACEBACK = "Traceback (most recent call last)"
# Time from one signal to the next, stronger one [s]
STOP_TIMEOUT = 5.0


class RunningProcess:
    """A process in a process group of its own, with standard output and error going to a file.

    A command that begins with a path is started as a user starts it, one that begins with the name of an executable of
    ours as a fork of a process that has done the imports.

    Attributes
    ----------
    is_made_to_fail
        whether the test puts an error into its code, so that a traceback is what it is to write
    """

    is_made_to_fail = False

    def __init__(self, command: list[str], output_path: Path, env: dict[str, str] | None = None) -> None:
        self.command = command
        self._output_path = output_path
        environment = {**os.environ, "PYTHONUNBUFFERED": "1", "PYTHONFAULTHANDLER": "1", **(env or {})}
        output_path.touch()
        self._process: subprocess.Popen[bytes] | ForkedProcess
        if os.sep not in command[0]:
            self._process = ForkedProcess(command[0], command[1:], output_path, output_path, environment)
            return
        with output_path.open("wb") as output:
            self._process = subprocess.Popen(
                command,
                stdin=subprocess.DEVNULL,
                stdout=output,
                stderr=subprocess.STDOUT,
                env=environment,
                start_new_session=True,
                preexec_fn=end_with_parent,
            )

    @property
    def pid(self) -> int:
        return self._process.pid

    @property
    def returncode(self) -> int | None:
        """Exit status, None while the process runs."""
        return self._process.poll()

    @property
    def output(self) -> str:
        """What the process has written so far."""
        return self._output_path.read_text(errors="replace")

    def wait(self, timeout: float) -> int:
        """Exit status of a process that ends by itself; AssertionError after `timeout` seconds, with its stack."""
        try:
            return self._process.wait(timeout)
        except subprocess.TimeoutExpired:
            self._process.send_signal(signal.SIGABRT)  # Python's fault handler writes where it hangs
            self._process.wait(STOP_TIMEOUT)
            raise AssertionError(f"{self} still ran after {timeout} s; its output:\n{self.output}") from None

    def send_signal(self, number: signal.Signals) -> None:
        """Send a signal to the process alone, as a user or a supervisor would."""
        self._process.send_signal(number)

    def stop(self) -> int:
        """End the process group by SIGINT, SIGTERM, SIGKILL in turn; return the exit status."""
        for number in (signal.SIGINT, signal.SIGTERM):
            if self._process.poll() is not None:
                break
            self._signal_group(number)
            try:
                self._process.wait(STOP_TIMEOUT)
            except subprocess.TimeoutExpired:
                continue
        # Also after an orderly end: children may have outlived their parent
        self._signal_group(signal.SIGKILL)
        return self._process.wait()

    def _signal_group(self, number: signal.Signals) -> None:
        try:
            os.killpg(self.pid, number)
        except ProcessLookupError:  # no group: it has ended, or is a fork that has just begun
            self._process.send_signal(number)

    def __str__(self) -> str:
        return shlex.join(self.command)[:200]


StartProcess = Callable[..., RunningProcess]


def executable(name: str, package: str = "tpgmm_ros") -> str:
    """Path of an executable of a package, where `ros2 run` finds it too."""
    from ament_index_python.packages import get_package_prefix

    path = Path(get_package_prefix(package)) / "lib" / package / name
    if not os.access(path, os.X_OK):
        raise FileNotFoundError(f"no executable {name!r} at {path}: is it in setup.py? run `make setup`")
    return str(path)


def spin_until(
    node: Node,
    condition: Callable[[], Any],
    timeout: float = STARTUP_TIMEOUT,
    message: str = "",
    processes: tuple[RunningProcess, ...] = (),
) -> None:
    """Serve the callbacks of `node`, one of this module's fixtures, until `condition()` is true.

    AssertionError with `message` after `timeout` seconds, or at once when one of `processes` has ended.
    """
    executor = node.executor
    assert executor is not None
    deadline = time.monotonic() + timeout
    while not condition():
        for process in processes:
            if process.returncode is not None:
                raise AssertionError(f"{process} ended with {process.returncode}:\n{process.output}")
        if time.monotonic() > deadline:
            raise AssertionError(f"not within {timeout} s: {message or condition}")
        executor.spin_once(timeout_sec=0.02)


#: Each domain rests for a while: what a process of the last test on it has left is not met by the next one.
DOMAINS = itertools.cycle(random.Random(os.getpid()).sample(range(1, 101), 100))


@contextlib.contextmanager
def own_domain(log_directory: Path) -> Iterator[int]:
    """A ROS domain that nobody else on this machine uses, in the environment of this process and its children."""
    from domain_coordinator import domain_id

    with domain_id(DOMAINS.__next__) as domain, pytest.MonkeyPatch.context() as environment:
        environment.setenv("ROS_DOMAIN_ID", str(domain))
        environment.setenv("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
        environment.setenv("ROS_LOG_DIR", str(log_directory))
        yield domain


@contextlib.contextmanager
def node_on(domain: int) -> Iterator[Node]:
    """A node on a domain, whose callbacks `spin_until` serves."""
    import rclpy
    from rclpy.action import ActionClient
    from rclpy.context import Context
    from rclpy.node import Node

    from tpgmm_ros.runtime.rclpy_events import NodeExecutor
    from tpgmm_ros.runtime.rclpy_workarounds import init_rclpy

    context = Context()
    init_rclpy(context=context, domain_id=domain)
    node = Node("test", context=context)
    executor = NodeExecutor(context)
    executor.add_node(node)
    try:
        yield node
    finally:
        # An executor keeps what it serves, and the traceback of a failed test may keep the executor: whoever is next on
        # this domain would meet the node of that test
        executor.remove_node(node)
        executor.shutdown()
        # They keep the node alive, and a node does not destroy them (rclpy 7.1)
        for client in [item for item in node.waitables if isinstance(item, ActionClient)]:
            client.destroy()
        node.destroy_node()
        rclpy.shutdown(context=context)


@contextlib.contextmanager
def process_starter(directory: Path) -> Iterator[StartProcess]:
    """Starts processes whose output goes to a directory, and ends them all.

    None may write a traceback, also where the test looks at something else, and the process goes on after it.
    """
    started: list[RunningProcess] = []

    def start(program: str, *arguments: str, env: dict[str, str] | None = None) -> RunningProcess:
        output_path = directory / f"{len(started)}-{Path(program).name}.log"
        started.append(RunningProcess([program, *arguments], output_path, env))
        return started[-1]

    try:
        yield start
    finally:
        for process in reversed(started):
            process.stop()
        for process in started:
            # pytest shows this for failed tests only
            print(f"--- {process} (exit status {process.returncode})\n{process.output}")
    for process in started:
        at = process.output.find(TRACEBACK)
        assert at == -1 or process.is_made_to_fail, f"{process}: {process.output[max(0, at - 500) :][:4000]}"


@pytest.fixture
def ros_domain(tmp_path: Path) -> Iterator[int]:
    """A ROS domain of this test's own, set in the environment of this process and its children."""
    with own_domain(tmp_path / "log") as domain:
        yield domain


@pytest.fixture
def ros_node(ros_domain: int) -> Iterator[Node]:
    """A node in the test's own process, on the test's own domain; serve its callbacks with `spin_until`."""
    with node_on(ros_domain) as node:
        yield node


@pytest.fixture
def start_process(ros_domain: int, tmp_path: Path) -> Iterator[StartProcess]:
    """Starts processes on the test's domain: `start_process("frame_tracker", "--ros-args", ..., env={...})`.

    The first argument is an executable of ours, or a path (of `executable`, to start it as users do). All processes and
    their children are ended with the test; what they wrote is shown when the test fails.
    """
    with process_starter(tmp_path) as start:
        yield start


@pytest.fixture(scope="module")
def module_domain(tmp_path_factory: pytest.TempPathFactory) -> Iterator[int]:
    """As `ros_domain`, for all tests of a file."""
    with own_domain(tmp_path_factory.mktemp("ros_log")) as domain:
        yield domain


@pytest.fixture(scope="module")
def module_node(module_domain: int) -> Iterator[Node]:
    """As `ros_node`, for all tests of a file."""
    with node_on(module_domain) as node:
        yield node


@pytest.fixture(scope="module")
def start_module_process(module_domain: int, tmp_path_factory: pytest.TempPathFactory) -> Iterator[StartProcess]:
    """As `start_process`, for all tests of a file."""
    with process_starter(tmp_path_factory.mktemp("processes")) as start:
        yield start
