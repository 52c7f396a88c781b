# SPDX-License-Identifier: Apache-2.0
"""The table of faults: each is a name, a promise in words, and a function that makes it happen."""

from __future__ import annotations

import contextlib
import importlib
import os
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar, Protocol, Self

from rclpy.node import Node

from ros_testing import StartProcess, node_on, own_domain, process_starter
from tpgmm_ros.runtime.processes import REALTIME_PRIORITY

#: In the order of the table.
MODULES = (
    "controller", "controller_states", "controller_references", "controller_ends", "late", "robot", "bag",
    "perception", "movement", "driver", "processes", "composed"
)  # fmt: skip


class Bench(Protocol):
    """Running nodes, and this process on the other side of their topics.

    Attributes:
        realtime: this process has to keep up with nodes that run ahead of ordinary programs.
    """

    name: ClassVar[str]
    realtime: ClassVar[bool]

    @classmethod
    def open(cls, node: Node, start: StartProcess, directory: Path) -> Self:
        """Start the nodes; `directory` is for files that they need."""
        ...

    def prepare(self) -> None:
        """Before each fault: all is well, and nothing is known of what was before."""
        ...

    def settle(self) -> str:
        """After each fault: good inputs lead back to work, without a restart of anything; in words and numbers."""
        ...


@dataclass(frozen=True, slots=True)
class Fault:
    """One row.

    bench : what it happens to
    run : makes it happen; returns in words and numbers what was observed, AssertionError where that was not promised
    quick : it is part of the tests, not only of `make faults`
    """

    name: str
    promise: str
    bench: type[Bench]
    run: Callable[[Any], str]
    quick: bool


_table: list[Fault] = []


def fault[BenchT: Bench](
    bench: type[BenchT], name: str, promise: str, *, quick: bool = True
) -> Callable[[Callable[[BenchT], str]], Callable[[BenchT], str]]:
    """Puts the decorated function into the table."""

    def enter(run: Callable[[BenchT], str]) -> Callable[[BenchT], str]:
        _table.append(Fault(name, promise, bench, run, quick))
        return run

    return enter


def rows_of(bench: type[Bench]) -> list[Fault]:
    """What can happen to a bench, as far as it has been entered."""
    return [row for row in _table if row.bench is bench]


def all_faults() -> list[Fault]:
    """The whole table; faults of one bench are next to each other."""
    for module in MODULES:
        importlib.import_module(f"faults.{module}")
    names = [item.name for item in _table]
    assert len(set(names)) == len(names), "two faults of one name"
    return list(_table)


@contextlib.contextmanager
def _ahead_of_ordinary_programs() -> Iterator[None]:
    """This process, but none that it starts; where it is not permitted, all goes on as it is."""
    with contextlib.suppress(OSError):
        _schedule(os.SCHED_FIFO | os.SCHED_RESET_ON_FORK, REALTIME_PRIORITY - 1)
    try:
        yield
    finally:
        _schedule(os.SCHED_OTHER, 0)


def _schedule(policy: int, priority: int) -> None:
    for thread in Path("/proc/self/task").iterdir():
        os.sched_setscheduler(int(thread.name), policy, os.sched_param(priority))


@contextlib.contextmanager
def _opened(kind: type[Bench], directory: Path) -> Iterator[Bench]:
    directory.mkdir(parents=True, exist_ok=True)
    with (
        own_domain(directory / "ros_log") as domain,
        node_on(domain) as node,
        process_starter(directory) as start,
    ):
        bench = kind.open(node, start, directory)
        # only now: threads that are made later are ordinary ones
        with _ahead_of_ordinary_programs() if kind.realtime else contextlib.nullcontext():
            yield bench


class Benches:
    """Keeps one bench, on a ROS domain of its own, for one fault after the other; after a failure it makes a new one.

    directory : what the nodes write, one directory for each bench
    """

    def __init__(self, directory: Path) -> None:
        self._directory = directory
        self._stack = contextlib.ExitStack()
        self._bench: Bench | None = None
        self._opened = 0

    def run(self, row: Fault) -> str:
        """Make a fault happen; what was observed. AssertionError where a promise was not kept."""
        if type(self._bench) is not row.bench:
            self.close()
            self._opened += 1
            directory = self._directory / f"{self._opened}-{row.bench.name}"
            self._bench = self._stack.enter_context(_opened(row.bench, directory))
        assert self._bench is not None
        try:
            self._bench.prepare()
            observed = row.run(self._bench)
            return f"{observed}; {self._bench.settle()}"
        except BaseException:
            self.close()
            raise

    def close(self) -> None:
        """End all that runs."""
        self._bench = None
        self._stack.close()
