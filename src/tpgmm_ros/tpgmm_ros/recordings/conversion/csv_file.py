# SPDX-License-Identifier: Apache-2.0
"""Text files with columns of numbers, as the programs of many countries write them."""

from __future__ import annotations

import csv
import re
from collections.abc import Collection, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np

from tpgmm_core.common.text import shown
from tpgmm_core.common.types import Array
from tpgmm_ros.recordings.conversion.conversion_error import ConversionError

MISSING = frozenset({"", "nan", "na", "n/a", "null", "none", "-", "#n/a"})
"""What stands, in any case of letters, where nothing was measured."""
_MARKS = {b"\xff\xfe": "utf-16", b"\xfe\xff": "utf-16"}
_DATE = re.compile(r"\d{4}-\d{2}-\d{2}|\d{1,2}[./]\d{1,2}[./]\d{4}|\d{1,2}:\d{2}:\d{2}")
_THOUSANDS = re.compile(r"[-+]?\d{1,3}([.,' \u00a0\u202f]\d{3})+([.,]\d*)?")
_FORTRAN = re.compile(r"([-+]?[\d.]+)[dD]([-+]?\d+)")
_TRUTHS = {"true": 1.0, "false": 0.0}
_COMMENTS = ("#", "%", "//")
_SEPARATOR = re.compile(r'"?sep=(.)"?')
_COMMAS = "; are these decimal commas? Then separate the columns by ; or by tabs"


class _Line(NamedTuple):
    number: int
    text: str


def read_csv(path: Path, wanted: Collection[str] | None = None, labels: str | None = None) -> dict[str, Array]:
    """Read a table.

    Columns are separated by ``;``, tabs, ``|``, commas or blanks, the first of these that the first line has. Where it
    is not the comma, numbers may have decimal commas. Excel's first line ``sep=;`` is understood. Passed over are blank
    lines, lines that begin with #, % or // but for names above the columns, and separators at the end of each line. An
    empty cell, nan, n/a and the like is a number that is not finite, true and false are 1 and 0. A name that is given
    twice becomes name(1) and name(2). Where a column that is not wanted holds texts, these are not finite either.

    Parameters
    ----------
    path
        a text in UTF-8, in UTF-16 with its mark, or in Latin-1
    wanted
        names of the columns that are used; with "" among them, also columns by number; None: all
    labels
        name of a column whose texts become numbers, the same for the same text

    Returns
    -------
    dict[str, Array]
        columns (T,) by the names in the first line, where it holds names, and all of them (T, k) as ""

    Raises
    ------
    ConversionError
        the file is no text, or has no numbers, lines of different lengths, or cells of wanted columns that are no
        numbers.
    """
    everything = [_Line(i, text) for i, text in enumerate(_text_of(path).splitlines(), 1) if text.strip()]
    said = _SEPARATOR.fullmatch(everything[0].text.strip()) if everything else None
    everything = everything[1:] if said else everything
    lines = [line for line in everything if not line.text.lstrip().startswith(_COMMENTS)]
    if not everything:
        raise ConversionError(f"{path}: is empty")
    above = everything[: everything.index(lines[0])] if lines else everything
    first = (lines or above)[0].text
    delimiter = said[1] if said else next((mark for mark in (";", "\t", "|", ",") if mark in first), None)
    names: list[str] = []
    if lines and _holds_names(lines, delimiter):
        names, lines = [word.strip() for word in _words(lines[0].text, delimiter)], lines[1:]
    if not lines:
        raise ConversionError(f"{path}: holds names and no numbers")
    while delimiter is not None and all(line.text.rstrip(" ").endswith(delimiter) for line in lines):
        if len(_words(lines[0].text, delimiter)) == len(names):
            break  # the last column is empty, but it has a name
        lines = [_Line(number, text.rstrip(" ").removesuffix(delimiter)) for number, text in lines]
    below = _words(lines[0].text, delimiter)
    if not all(map(_is_number, below)) and not any(_is_measured(word, delimiter) for word in below):
        raise ConversionError(
            f"{path}: line {lines[0].number} holds no number below the names; if it holds units or more names, delete "
            "it, and give units by --unit and --time-unit; if the names stand further down, put # before what is above"
        )
    width = len(_words(lines[0].text, delimiter))
    if not names and above:
        words = [word.strip() for word in _words(above[-1].text.lstrip("#%/ "), delimiter)]
        names = words if len(words) == width and not all(map(_is_number, words)) else []
    while len(names) > width and not names[-1]:
        names.pop()
    values = _values(path, lines, delimiter, names, wanted, labels)
    if names and len(names) != values.shape[1]:
        hint = _COMMAS if delimiter == "," and values.shape[1] > len(names) else ""
        raise ConversionError(f"{path}: has {len(names)} names in its first line and {values.shape[1]} columns{hint}")
    return {"": values} | {name: values[:, k] for k, name in enumerate(_told_apart(names)) if name}


def _holds_names(lines: Sequence[_Line], delimiter: str | None) -> bool:
    """Whether the first line has names: texts alone, or texts where the next one has none, or numbers of columns."""
    first, *others = (_words(line.text, delimiter) for line in lines[:2])
    if all(map(_is_number, first)):
        return False
    numbers = [_number(word, delimiter) for word in first if _is_measured(word, delimiter)]
    if not others or numbers in (list(range(len(numbers))), list(range(1, len(numbers) + 1))):
        return True
    return any(_is_number(below) for word, below in zip(first, others[0], strict=False) if not _is_number(word))


def _told_apart(names: Sequence[str]) -> list[str]:
    """Names that are given several times get numbers, as MATLAB counts."""
    twice = {name for name in names if name and names.count(name) > 1}
    return [f"{name}({names[:k].count(name) + 1})" if name in twice else name for k, name in enumerate(names)]


def _text_of(path: Path) -> str:
    raw = path.read_bytes()
    encoding = _MARKS.get(raw[:2], "utf-8-sig")
    try:
        text = raw.decode(encoding)
    except UnicodeDecodeError:
        text = raw.decode("latin-1")
    if any(ord(character) < 32 and character not in "\t\r\n\f\v" for character in text[:2000]):
        raise ConversionError(f"{path}: is no text: it begins with {shown(raw[:12])}; expected columns of numbers")
    return text


def _values(
    path: Path,
    lines: Sequence[_Line],
    delimiter: str | None,
    names: Sequence[str],
    wanted: Collection[str] | None,
    labels: str | None,
) -> Array:
    """Numbers (T, k); where numpy's own reader does not take them, cell by cell, so that the bad one can be named."""
    texts = [line.text if delimiter == "," else line.text.replace(",", ".") for line in lines]
    try:
        return np.loadtxt(texts, delimiter=delimiter, ndmin=2, quotechar='"', comments=None)
    except ValueError:
        pass
    rows: list[list[str]] = []
    for line in lines:
        words = _words(line.text, delimiter)
        if rows and len(words) != len(rows[0]):
            hint = _COMMAS if delimiter == "," and len(words) != len(names) else ""
            if line is lines[-1] and len(words) < len(rows[0]):
                hint = "; it is the last line: the file was cut off. Delete this line"
            raise ConversionError(
                f"{path}: line {line.number} has {len(words)} values, the lines before have {len(rows[0])}{hint}"
            )
        rows.append([word.strip() for word in words])
    values = np.full((len(rows), len(rows[0])), np.nan)
    for k in range(len(rows[0])):
        column = [_number(row[k], delimiter) for row in rows]
        values[:, k] = [np.nan if number is None else number for number in column]
        if None in column and labels is not None and labels in names[k : k + 1]:
            values[:, k] = np.unique([row[k] for row in rows], return_inverse=True)[1]
        elif None in column and _is_wanted(
            names[k] if k < len(names) else "", wanted, bool(np.isfinite(values[:, k]).any())
        ):
            bad = column.index(None)
            raise ConversionError(f"{path}: {_no_number(lines[bad].number, k, rows[bad][k], names)}")
    return values


def _is_wanted(name: str, wanted: Collection[str] | None, has_numbers: bool) -> bool:
    """Whether all cells of a column have to be numbers; columns that are meant by number are not texts throughout."""
    if wanted is None or (name and ({name, name.partition("[")[0].strip()} & set(wanted))):
        return True
    return "" in wanted and has_numbers


def _number(word: str, delimiter: str | None) -> float | None:
    """A cell as a number; None where it is none."""
    word = word.strip().replace("\u2212", "-")  # the minus sign of typesetters
    if word.lower() in MISSING:
        return float("nan")
    if word.lower() in _TRUTHS:
        return _TRUTHS[word.lower()]
    if delimiter != "," or not _THOUSANDS.fullmatch(word):  # else the comma stood in quotes, and may be either
        word = word.replace(",", ".")
    try:
        return float(_FORTRAN.sub(r"\1e\2", word))
    except ValueError:
        return None


def _is_measured(word: str, delimiter: str | None) -> bool:
    number = _number(word, delimiter)
    return number is not None and np.isfinite(number)


def _no_number(line: int, column: int, word: str, names: Sequence[str]) -> str:
    """Where a cell is that is no number, and what it may be."""
    name = f" ({names[column]})" if column < len(names) else ""
    hint = "; it looks like a date or a time of day: write seconds" if _DATE.search(word) else ""
    if word in names:
        hint = "; it is a name of a column: were files joined? Cut them apart"
    elif _THOUSANDS.fullmatch(word):
        hint = "; write numbers with decimal points, and without signs between thousands"
    return f"line {line}, column {column}{name}: {shown(word)} is no number{hint}"


def _words(text: str, delimiter: str | None) -> list[str]:
    return text.split() if delimiter is None else next(csv.reader([text], delimiter=delimiter, skipinitialspace=True))


def _is_number(word: str) -> bool:
    return _number(word, None) is not None or bool(_DATE.search(word))
