# SPDX-License-Identifier: Apache-2.0
"""Reports: a table for people, a JSON file for programs."""

import json
import sys
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path
from typing import Any

from tpgmm_core.common.atomic_file import write_atomically
from tpgmm_core.common.text import one_line
from tpgmm_ros.runtime.entry import INTERRUPTED


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

    Raises
    ------
    OSError
        the directory cannot be made or written.
    ValueError
        a number is not finite, which JSON cannot hold.
    """
    path = Path(directory) / "report.json"
    text = json.dumps(values, indent=2, allow_nan=False) + "\n"
    path.parent.mkdir(parents=True, exist_ok=True)
    write_atomically(path, lambda draft: draft.write_text(text, encoding="utf-8"))
    return path


def run_with_report(
    directory: Path,
    run: Callable[[], bool],
    errors: tuple[type[Exception], ...],
    cause_of: Callable[[Exception], str] = lambda error: "",
) -> int:
    """Run a program that leaves a report, whatever happens; returns its exit status.

    Parameters
    ----------
    directory
        of report.json. One of an earlier success never stands beside a failure.
    run
        does the work, writes its report, and returns the verdict
    errors
        what may go wrong, besides the disk; said in one line
    cause_of
        the likely cause of an error, where there is one to tell
    """
    status, cause = 1, ""
    try:
        (directory / "report.json").unlink(missing_ok=True)
        return 0 if run() else 1
    except Exception as error:
        if not isinstance(error, (OSError, ValueError, *errors)):
            raise
        reason, cause = one_line(error), cause_of(error)
        print(f"error: {reason}", file=sys.stderr)
        if cause:
            print(f"likely cause: {cause}", file=sys.stderr)
    except KeyboardInterrupt:
        reason, status = "interrupted", INTERRUPTED
        print(reason, file=sys.stderr)
    try:
        write_report(directory, {"passed": False, "error": reason, "cause": cause})
    except OSError as error:
        print(f"error: the report could not be written: {one_line(error)}", file=sys.stderr)
    return status
