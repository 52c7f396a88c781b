# SPDX-License-Identifier: Apache-2.0
"""Nodes as processes of their own: started, watched, ended. For the programs that run a whole graph."""

from __future__ import annotations

import ctypes
import os
import signal
import subprocess
import sys
import time
from collections.abc import Mapping, Sequence
from pathlib import Path
from types import TracebackType

#: For nodes that run in real time, so that what else the machine does costs no ticks; where it is not permitted, the
#: nodes say so in their logs and go on.
REALTIME_PRIORITY = 20

_PR_SET_PDEATHSIG = 1  # linux/prctl.h
_LIBC = ctypes.CDLL(None)  # looked up here: between fork and exec there is no time for it


type Value = bool | float | str | Path
"""Of a parameter."""


class GraphError(RuntimeError):
    """A node did not start, did not answer, or ended on its own."""


class GraphTimeoutError(GraphError):
    """What was waited for did not come in time, and no process ended: on a busy machine, perhaps it would have."""


def end_with_parent() -> None:
    """To be called in a child process: it gets SIGTERM when the thread that started it ends, also by SIGKILL (Linux).

    Nodes that are left behind go on publishing, and whoever takes their ROS domain next meets them.
    """
    if sys.platform == "linux":
        _LIBC.prctl(_PR_SET_PDEATHSIG, signal.SIGTERM)


class NodeProcesses:
    """Starts node processes and ends every one of them, whatever happens in between.

    Parameters
    ----------
    log_directory
        one log file per node is written here; the end of it is shown when a node fails
    environment
        further environment variables, such as ROS_DOMAIN_ID
    """

    def __init__(self, log_directory: Path, environment: Mapping[str, str] | None = None) -> None:
        self.log_directory = log_directory
        log_directory.mkdir(parents=True, exist_ok=True)
        self._environment = {**os.environ, **(environment or {})}
        self._processes: dict[str, subprocess.Popen[bytes]] = {}
        self._shared: dict[str, str] = {}  # node -> the process that it shares

    def start(self, executable: str, **parameters: Value) -> None:
        """Start ``executable`` (a node of this package) with parameters."""
        self._start(executable, [f"tpgmm_ros.nodes.{executable}"], _given(parameters))

    def start_all(self, name: str, nodes: Mapping[str, Mapping[str, Value]], together: bool = True) -> None:
        """Start nodes, each with parameters, named in the order of the data.

        Parameters
        ----------
        name : str
            Of the process that they share.
        nodes : mapping
            Executable -> its parameters.
        together : bool
            False: each of them in a process of its own.
        """
        if not together:
            for node, parameters in nodes.items():
                self.start(node, **parameters)
            return
        given = [item for node, parameters in nodes.items() for item in _given(parameters, f"{node}:")]
        self._start(name, ["tpgmm_ros.programs.compose", *nodes], given)
        self._shared |= dict.fromkeys(nodes, name)

    def _start(self, name: str, module: Sequence[str], parameters: Sequence[str]) -> None:
        self.start_command(name, [sys.executable, "-m", *module, "--ros-args", *parameters])

    def start_command(self, name: str, command: Sequence[str]) -> None:
        """Start a process by its command line; ``name`` is that of its log."""
        with (self.log_directory / f"{name}.log").open("wb") as log:
            # A session of its own: the terminal's Ctrl-C reaches this program only, which then ends the nodes in order.
            self._processes[name] = subprocess.Popen(
                command,
                stdout=log,
                stderr=subprocess.STDOUT,
                env=self._environment,
                start_new_session=True,
                preexec_fn=end_with_parent,
            )

    def check(self) -> None:
        """Check that all processes are running.

        Raises
        ------
        GraphError
            for a process that has ended on its own, with the end of its log
        """
        for name, process in self._processes.items():
            status = process.poll()
            if status is not None:
                raise GraphError(f"{name} ended with status {status}; the end of its log:\n{self.log_tail(name)}")

    def pid(self, name: str) -> int:
        """Process id of a node that was started, or of the process that it shares."""
        return self._processes[self._shared.get(name, name)].pid

    def kill(self, name: str) -> None:
        """End a node as a crash would, by SIGKILL; it may be started again."""
        process = self._processes.pop(name)
        process.kill()
        process.wait()

    def end(self, name: str) -> subprocess.Popen[bytes]:
        """Ask a process to end by SIGTERM; it is not watched any more. Returns it, to be waited for."""
        process = self._processes.pop(name)
        process.terminate()
        return process

    def show_stacks(self, name: str) -> None:
        """Let a node that stands still end, with the stacks of its threads in its log."""
        process = self._processes[self._shared.get(name, name)]
        process.send_signal(signal.SIGABRT)  # `faulthandler` is on in nodes
        process.wait()

    def log_tail(self, name: str, lines: int = 15) -> str:
        """The end of what a node, or the process that it shares, has written."""
        text = (self.log_directory / f"{self._shared.get(name, name)}.log").read_text(errors="replace")
        return "\n".join(text.splitlines()[-lines:])

    def stop(self, timeout: float = 5.0) -> None:
        """End all, in the reverse order of their start: SIGTERM, and SIGKILL for whoever does not follow."""
        for process in reversed(self._processes.values()):
            if process.poll() is None:
                process.send_signal(signal.SIGTERM)
        deadline = time.monotonic() + timeout
        for process in self._processes.values():
            try:
                process.wait(max(0.0, deadline - time.monotonic()))
            except subprocess.TimeoutExpired:
                process.kill()
                process.wait()
        self._processes.clear()

    def __enter__(self) -> NodeProcesses:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.stop()


def _given(parameters: Mapping[str, Value], node: str = "") -> list[str]:
    """Parameters as arguments of ROS."""
    arguments = []
    for key, value in parameters.items():
        text = str(value).lower() if isinstance(value, bool) else str(value)
        arguments += ["-p", f"{node}{key}:={text}"]
    return arguments
