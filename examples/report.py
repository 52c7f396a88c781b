# SPDX-License-Identifier: Apache-2.0
"""What the scripts print: a table of the results, which they also write as JSON; and how far they are, on stderr."""

from __future__ import annotations

import sys
import time
from collections.abc import Iterator, Sequence
from pathlib import Path

from tpgmm_core.common.report import Row, format_rows, write_json

PERIOD = 10.0  # s, between two lines


def write_report(name: str, rows: Sequence[Row], directory: Path) -> None:
    """Print rows with the same columns as a table and write them to directory/name.json."""
    print(f"\n{name}\n{format_rows(rows)}")
    write_json(directory / f"{name}.json", rows)


def progress[T](items: Sequence[T], what: str) -> Iterator[T]:
    """The items, with a line on stderr every ten seconds that says how many are done; none where that is soon over."""
    begun = told = time.monotonic()
    for i, item in enumerate(items):
        yield item
        if (now := time.monotonic()) - told >= PERIOD:
            told = now
            print(f"    {now - begun:4.0f} s  {what}: {i + 1} of {len(items)}", file=sys.stderr, flush=True)
