# SPDX-License-Identifier: Apache-2.0
"""Reports: a table for people, a JSON file for programs."""

import json
import os
import tempfile
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path
from typing import Any


def format_table(header: Sequence[str], rows: Iterable[Sequence[Any]]) -> str:
    """Plain table: text to the left, numbers (4 significant digits) to the right."""
    body = [[f"{cell:.4g}" if isinstance(cell, float) else str(cell) for cell in row] for row in rows]
    rows = [list(header), *body]
    widths = [max(len(row[i]) for row in rows) for i in range(len(header))]
    numeric = [all(_is_number(row[i]) for row in body) for i in range(len(header))]

    def line(cells: Sequence[str]) -> str:
        return "  ".join(
            cell.rjust(width) if right else cell.ljust(width)
            for cell, width, right in zip(cells, widths, numeric, strict=True)
        ).rstrip()

    return "\n".join([line(header), line(["-" * width for width in widths]), *map(line, body)])


def _is_number(text: str) -> bool:
    try:
        float(text)
    except ValueError:
        return text == "-"
    return True


def write_report(directory: str | Path, values: dict[str, Any] | list[dict[str, Any]]) -> Path:
    """Write `values` to report.json in a directory, which is made where it is missing.

    Raises:
        OSError: the directory cannot be made or written.
        ValueError: a number is not finite, which JSON cannot hold.
    """
    path = Path(directory) / "report.json"
    text = json.dumps(values, indent=2, allow_nan=False) + "\n"
    write_atomically(path, lambda draft: draft.write_text(text, encoding="utf-8"))
    return path


def write_atomically(path: Path, write: Callable[[Path], Any]) -> None:
    """Have a file written beside `path`, and put it in its place only when that succeeded.

    Args:
        path: the file; its directory is made where it is missing.
        write: writes the file of the name it is given.
    """
    path.parent.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory(dir=path.parent, prefix=f".{path.name}.") as directory:
        draft = Path(directory) / path.name
        write(draft)
        os.replace(draft, path)
