# SPDX-License-Identifier: Apache-2.0
"""Executables and scripts of ours as forks of one process that has done their imports, so that they start in no time.

What a user waits for, some seconds of imports, is most of what a test of a node costs. Tests of the start itself, of
signals during it and of the end of Python take processes that are started as users start them.
"""

from __future__ import annotations

import contextlib
import faulthandler
import multiprocessing
import os
import runpy
import signal
import subprocess
import sys
import tempfile
from collections.abc import Mapping, Sequence
from importlib import import_module
from importlib.metadata import distribution
from pathlib import Path

from tpgmm_ros.runtime.processes import end_with_parent

PACKAGES = ("tpgmm_ros", "tpgmm_demos", "tpgmm_workbench")
#: What each test run imports once; what is missing here is imported by each process that needs it.
PRELOADED = [
    *(f"tpgmm_ros.nodes.{name}" for name in ("frame_tracker", "reproduction", "impedance_controller", "joint_motion")),
    *(f"tpgmm_ros.nodes.{name}" for name in ("joint_reference", "baxter_simulator", "endpoint_poses", "recognition")),
    *(f"tpgmm_ros.programs.{name}" for name in ("compose", "record", "train", "inspect", "evaluate", "show", "teach")),
    *(f"tpgmm_ros.programs.{name}" for name in ("check_robot", "convert", "recognize")),
    *("tpgmm_demos.demo", "tpgmm_demos.figure5"),
]
CONTEXT = multiprocessing.get_context("forkserver")
CONTEXT.set_forkserver_preload(PRELOADED)


def entry_points() -> dict[str, str]:
    """The executables of all packages: module:function by name. Where two have one, that of tpgmm_ros."""
    return {
        point.name: point.value
        for package in reversed(PACKAGES)
        for point in distribution(package).entry_points.select(group="console_scripts")
    }


def _run(what: str, words: Sequence[str], out: str, err: str, folder: str, environment: Mapping[str, str]) -> None:
    os.setsid()
    end_with_parent()
    os.chdir(folder)
    for place, number, how in ((os.devnull, 0, os.O_RDONLY), (out, 1, os.O_WRONLY), (err, 2, os.O_WRONLY)):
        file = os.open(place, how | os.O_APPEND)
        os.dup2(file, number)
        os.close(file)
    os.environ.clear()
    os.environ.update(environment)
    for stream in (sys.stdout, sys.stderr):
        stream.reconfigure(line_buffering=True)  # type: ignore[union-attr]
    faulthandler.enable()
    sys.argv = list(words)
    sys.path[:0] = filter(None, environment.get("PYTHONPATH", "").split(os.pathsep))
    module, _, function = what.partition(":")
    if function:
        sys.exit(getattr(import_module(module), function)())
    elif what.endswith(".py"):
        runpy.run_path(what, run_name="__main__")
    else:
        runpy.run_module(what, run_name="__main__", alter_sys=True)


class ForkedProcess:
    """A running executable, with what tests need of `subprocess.Popen`.

    Parameters
    ----------
    name
        of the executable; or the path of a script (.py), or a module, as after `python -m`
    arguments
        of its command line
    out, err
        files that exist, to which standard output and error are added
    environment
        all of it; as here where None
    """

    def __init__(
        self, name: str, arguments: Sequence[str], out: Path, err: Path, environment: Mapping[str, str] | None = None
    ) -> None:
        what, folder = entry_points().get(name, name), os.getcwd()
        given = dict(os.environ if environment is None else environment)
        self._process = CONTEXT.Process(target=_run, args=(what, [name, *arguments], str(out), str(err), folder, given))
        self._process.start()
        assert self._process.pid is not None
        self.pid = self._process.pid

    def poll(self) -> int | None:
        """Exit status, negative for the signal that ended it; None while it runs."""
        return self._process.exitcode

    def wait(self, timeout: float | None = None) -> int:
        """Exit status of a process that ends by itself. Raises subprocess.TimeoutExpired after `timeout` seconds."""
        self._process.join(timeout)
        status = self._process.exitcode
        if status is None:
            raise subprocess.TimeoutExpired(self._process.name, timeout or 0.0)
        return status

    def send_signal(self, number: signal.Signals) -> None:
        """Send a signal, unless it has ended."""
        if self.poll() is None:
            with contextlib.suppress(ProcessLookupError):
                os.kill(self.pid, number)


def run_all(
    commands: Sequence[Sequence[str]], timeout: float = 120.0, environment: Mapping[str, str] | None = None
) -> list[subprocess.CompletedProcess[str]]:
    """Run executables of ours one after the other, each with its arguments: status and what they wrote.

    Parameters
    ----------
    commands
        words of each, first what is run: see `ForkedProcess`
    timeout
        for each, s
    environment
        of all; as here where None

    Returns
    -------
    list[subprocess.CompletedProcess[str]]
        in the order of the commands

    Raises
    ------
    subprocess.TimeoutExpired
        for one that does not end
    """
    ended = []
    for words in commands:
        with tempfile.TemporaryDirectory() as folder:
            out, err = Path(folder) / "out", Path(folder) / "err"
            out.touch()
            err.touch()
            process = ForkedProcess(words[0], words[1:], out, err, environment)
            try:
                status = process.wait(timeout)
            finally:
                process.send_signal(signal.SIGKILL)
            texts = (file.read_text(errors="replace") for file in (out, err))
            ended.append(subprocess.CompletedProcess(list(words), status, *texts))
    return ended
