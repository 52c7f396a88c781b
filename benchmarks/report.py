# SPDX-License-Identifier: Apache-2.0
"""How benchmarks tell what they measured: a table, and the same as JSON in out/bench/NAME.json."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np

from tpgmm_core.common.report import Row, format_rows, write_json


def write_report(name: str, rows: Sequence[Row], directory: Path = Path("out/bench")) -> None:
    """Print rows with the same keys (lower case, unit at the end) as a table and write them to directory/name.json."""
    print(f"\n{name}\n{format_rows(rows)}")
    write_json(directory / f"{name}.json", rows)


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
