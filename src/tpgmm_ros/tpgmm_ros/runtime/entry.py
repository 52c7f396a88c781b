# SPDX-License-Identifier: Apache-2.0
"""Where every executable begins: what a signal does comes first, then the imports, which take seconds.

Python's own answer to Ctrl-C during an import is a page of traceback. Until a program knows better, nothing was begun
that would have to be ended in order, so that the process just ends: with 130 as a program that was interrupted does, or
with 0 as nodes do that are told to stop. This module imports nothing that takes time.
"""

from __future__ import annotations

import errno
import os
import signal
import sys
from collections.abc import Callable
from importlib import import_module
from importlib.util import find_spec
from pathlib import Path
from types import FrameType

INTERRUPTED = 130
"""Exit status of programs that were interrupted: 128 and the number of SIGINT."""


def program(module: str) -> Callable[[], int]:
    """What runs `main` of a module; there, Ctrl-C is a KeyboardInterrupt."""

    def start() -> int:
        status = INTERRUPTED
        _end_with(status, signal.SIGINT)
        main = import_module(module).main
        try:
            signal.signal(signal.SIGINT, signal.default_int_handler)
            status = main()
            if sys.stdout is not None:  # closed by who started this
                sys.stdout.flush()
        except KeyboardInterrupt:
            print("interrupted", file=sys.stderr)
        except BrokenPipeError:  # who read what this prints has gone: `| head`
            _say_no_more()
            status = 1
        except OSError as error:
            if error.errno != errno.ENOSPC or error.filename is not None:
                raise
            _say_no_more()
            print("error: the disk is full, so that the output could not be written: make room", file=sys.stderr)
            status = 1
        finally:  # what is left is Python's own end, which has nothing to say to a user
            _end_with(status, signal.SIGINT)
        return status

    return start


def _say_no_more() -> None:
    """What is still to be printed goes nowhere, instead of ending Python with a traceback."""
    os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())


def node(module: str) -> Callable[[], int]:
    """The same of a module that runs a node, whose `executor.StopFlag` takes the signals over."""

    def start() -> int:
        _end_with(0, signal.SIGINT, signal.SIGTERM)
        status: int = import_module(module).main()
        _end_with(status, signal.SIGINT, signal.SIGTERM)
        return status

    return start


def _end_with(status: int, *signals: signal.Signals) -> None:
    def end(number: int, frame: FrameType | None) -> None:
        os._exit(status)

    for number in signals:
        signal.signal(number, end)


def missing(package: str, what: str) -> str:
    """Why something of another package cannot run, in words; empty where that package is installed."""
    if find_spec(package) is not None:
        return ""
    return (
        f"{what} is part of the package {package}, which is not installed: `make setup` installs it, on a full ROS "
        f"installation `colcon build --packages-up-to {package}` in the workspace"
    )


def a_path(text: str) -> Path:
    """A path among the arguments of a program; shells leave ~ as it is behind the = of an option."""
    return Path(os.path.expanduser(text))
