# SPDX-License-Identifier: Apache-2.0
"""Results as a table for people, and as a JSON file for programs."""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping, Sequence
from os import PathLike
from pathlib import Path
from typing import Any

from tpgmm_core.common.atomic_file import write_atomically

type Row = Mapping[str, str | float | bool | None]
"""What one row of a table holds, by column (lower case, with the unit at its end)."""


def format_table(header: Sequence[str], rows: Iterable[Sequence[Any]]) -> str:
    """Align cells in columns: text to the left, numbers (4 significant digits) to the right.

    Parameters
    ----------
    header : sequence of str
        Names of the columns.
    rows : iterable of sequences
        As many cells each; None is shown as "-".

    Returns
    -------
    str
        Lines without a line feed at the end.
    """
    body = [[_text(cell) for cell in row] for row in rows]
    lines = [list(header), *body]
    widths = [max(len(row[i]) for row in lines) for i in range(len(header))]
    numeric = [all(_is_number(row[i]) for row in body) for i in range(len(header))]

    def line(cells: Sequence[str]) -> str:
        return "  ".join(
            cell.rjust(width) if right else cell.ljust(width)
            for cell, width, right in zip(cells, widths, numeric, strict=True)
        ).rstrip()

    return "\n".join([line(header), line(["-" * width for width in widths]), *map(line, body)])


def format_rows(rows: Sequence[Row]) -> str:
    """Make a table of rows with the same columns; at least one row."""
    return format_table(list(rows[0]), (list(row.values()) for row in rows))


def write_json(path: str | PathLike[str], values: Mapping[str, Any] | Sequence[Mapping[str, Any]]) -> None:
    """Write values to a JSON file, which is replaced as a whole; its folder is made where it is missing.

    Raises
    ------
    OSError
        The file cannot be written.
    ValueError
        A number is not finite, which JSON cannot hold.
    """
    text = json.dumps(values, indent=2, allow_nan=False) + "\n"
    Path(path).parent.mkdir(parents=True, exist_ok=True)
    write_atomically(path, lambda draft: draft.write_text(text, encoding="utf-8"))


def _text(cell: Any) -> str:
    if cell is None:
        return "-"
    return f"{cell:.4g}" if isinstance(cell, float) else str(cell)


def _is_number(text: str) -> bool:
    try:
        float(text)
    except ValueError:
        return text == "-"
    return True
