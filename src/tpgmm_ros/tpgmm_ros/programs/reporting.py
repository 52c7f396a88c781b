# SPDX-License-Identifier: Apache-2.0
"""Programs that leave a report, whatever happens."""

import json
import math
import os
import sys
import tempfile
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from tpgmm_core.common.report import write_json
from tpgmm_core.common.text import one_line
from tpgmm_ros.runtime.entry import INTERRUPTED


def json_text(values: Any) -> str:
    """Values as JSON that every program reads: numbers that are not finite become null, paths become text."""
    return json.dumps(_plain(values), indent=2, allow_nan=False)


def _plain(value: Any) -> Any:
    if isinstance(value, Mapping):
        return {str(key): _plain(one) for key, one in value.items()}
    if isinstance(value, (list, tuple)):
        return [_plain(one) for one in value]
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    return value if value is None or isinstance(value, (str, int, bool)) else str(value)


def write_report(directory: str | Path, values: dict[str, Any] | list[dict[str, Any]]) -> Path:
    """Write values to report.json.

    Parameters
    ----------
    directory
        made where it is missing
    values
        what JSON can hold

    Returns
    -------
    Path
        the file

    Raises
    ------
    OSError
        the directory cannot be made or written.
    ValueError
        a number is not finite, which JSON cannot hold.
    """
    path = Path(directory) / "report.json"
    write_json(path, values)
    return path


MODEL, PAGE, JSON = b"PK", b"<!doctype html>", b"{"
"""How files begin that programs write: a model, a page, numbers."""


def refuse_foreign(path: Path | None, begins: bytes, what: str) -> None:
    """Refuse to write where something else is, or nothing can be: a slip must cost neither a bag nor a training.

    Parameters
    ----------
    path
        where a file is to be written; None: nowhere
    begins
        how such files begin
    what
        they are, in words

    Raises
    ------
    ValueError
        there is another file, or the folder takes none.
    OSError
        it cannot be read.
    """
    if path is None:
        return
    if above := next((folder for folder in path.parents if folder.exists() and not folder.is_dir()), None):
        raise ValueError(f"{path}: {above} is a file, so that nothing can be written in it; name a folder")
    if path.is_file() and path.stat().st_size:
        with path.open("rb") as file:
            if not file.read(len(begins)).startswith(begins):
                raise ValueError(f"{path} exists and is no {what}, so that it is not overwritten: give another name")
    folder = next(folder for folder in Path(os.path.abspath(path)).parents if folder.exists())
    try:
        tempfile.TemporaryFile(dir=folder).close()
    except OSError as error:
        why = f"{path} cannot be written, as no file can be made in {folder} ({error.strerror})"
        raise ValueError(f"{why}: name another folder") from None


def run_with_report(
    directory: Path,
    run: Callable[[], bool],
    errors: tuple[type[Exception], ...],
    cause_of: Callable[[Exception], str] = lambda error: "",
) -> int:
    """Run a program that leaves a report, whatever happens.

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

    Returns
    -------
    int
        exit status of the program

    Raises
    ------
    Exception
        what `run` raises, where it is none of `errors`
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
