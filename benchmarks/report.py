# SPDX-License-Identifier: Apache-2.0
"""How benchmarks tell what they measured: a table, the same as JSON in out/bench/NAME.json, and an exit status."""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np

from tpgmm_core.common.report import Row, format_rows, write_json


def without_options(description: str | None) -> None:
    """Let a benchmark that has no options answer `--help`, and refuse arguments instead of running for minutes.

    Parameters
    ----------
    description
        what it measures

    Raises
    ------
    SystemExit
        for any argument
    """
    argparse.ArgumentParser(description=description, formatter_class=argparse.RawDescriptionHelpFormatter).parse_args()


def write_report(name: str, rows: Sequence[Row], directory: Path = Path("out/bench")) -> int:
    """Print rows as a table, write them to directory/name.json, and judge them.

    Parameters
    ----------
    name
        of the table
    rows
        with the same keys: lower case, unit at the end. `passed` is the verdict of a row; None, or no such key, where
        it has nothing to reach
    directory
        made where it is missing

    Returns
    -------
    int
        the exit status: 1 where a row did not pass, else 0
    """
    print(f"\n{name}\n{format_rows(rows)}")
    write_json(directory / f"{name}.json", rows)
    failed = [row for row in rows if row.get("passed") not in (None, True)]
    for row in failed:
        print(f"{name}: not reached: {', '.join(f'{key} {value}' for key, value in row.items() if value is not None)}")
    return 1 if failed else 0


def durations(function: Callable[[], object], repetitions: int, warm_up: int = 3) -> np.ndarray:
    """Wall-clock time of each call, s, shape (repetitions,), after some calls that are not counted."""
    for _ in range(warm_up):
        function()
    result = np.empty(repetitions)
    for i in range(repetitions):
        start = time.perf_counter()
        function()
        result[i] = time.perf_counter() - start
    return result


def alternating(
    first: Callable[[], object], second: Callable[[], object], rounds: int, repetitions: int = 1
) -> tuple[np.ndarray, np.ndarray]:
    """Durations of two functions, s, in turns, so that what else the machine does meets both alike."""
    a, b = [], []
    for _ in range(rounds):
        a.append(durations(first, repetitions, warm_up=1))
        b.append(durations(second, repetitions, warm_up=1))
    return np.concatenate(a), np.concatenate(b)
