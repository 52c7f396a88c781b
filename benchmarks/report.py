# SPDX-License-Identifier: Apache-2.0
"""How benchmarks tell what they measured: a table, and the same as JSON in out/bench/NAME.json."""

from __future__ import annotations

import json
import sys
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path

import numpy as np

Row = Mapping[str, str | float | bool | None]
#: Seconds between two lines of progress.
PERIOD = 10.0


def write_report(name: str, rows: Sequence[Row], directory: Path = Path("out/bench")) -> None:
    """Print rows with the same keys (lower case, unit at the end) as a table and write them to directory/name.json."""
    print(f"\n{name}")
    columns = list(rows[0])
    cells = [[_text(row[column]) for column in columns] for row in rows]
    widths = [max(len(line[i]) for line in [columns, *cells]) for i in range(len(columns))]
    for line in [columns, *cells]:
        print("  ".join(cell.rjust(width) for cell, width in zip(line, widths, strict=True)))
    directory.mkdir(parents=True, exist_ok=True)
    (directory / f"{name}.json").write_text(json.dumps([dict(row) for row in rows], indent=2) + "\n")


def progress[T](items: Sequence[T], what: str) -> Iterator[T]:
    """The items, with a line on stderr every ten seconds that says how many are done; none where that is soon over."""
    begun = told = time.monotonic()
    for i, item in enumerate(items):
        yield item
        if (now := time.monotonic()) - told >= PERIOD:
            told = now
            print(f"    {now - begun:4.0f} s  {what}: {i + 1} of {len(items)}", file=sys.stderr, flush=True)


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


def _text(value: str | float | bool | None) -> str:
    if value is None:
        return "-"
    return f"{value:.4g}" if isinstance(value, float) else str(value)
