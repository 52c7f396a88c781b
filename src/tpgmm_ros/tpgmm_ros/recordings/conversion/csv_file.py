# SPDX-License-Identifier: Apache-2.0
"""Text files with columns of numbers, as the programs of many countries write them."""

from __future__ import annotations

import csv
import re
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np

from tpgmm_core.common.text import listed, shown
from tpgmm_core.common.types import Array
from tpgmm_ros.recordings.conversion.conversion_error import ConversionError

MISSING = frozenset({"", "nan", "na", "n/a", "null", "none", "-", "#n/a"})
"""What stands, in any case of letters, where nothing was measured."""
_MARKS = {b"\xff\xfe": "utf-16", b"\xfe\xff": "utf-16"}
_DATE = re.compile(r"\d{4}-\d{2}-\d{2}|\d{1,2}[./]\d{1,2}[./]\d{4}|\d{1,2}:\d{2}:\d{2}")
_COMMAS = "; are these decimal commas? Then separate the columns by ; or by tabs"


class _Line(NamedTuple):
    number: int
    text: str


def read_csv(path: Path) -> dict[str, Array]:
    """Read a table.

    Columns are separated by ``;``, by tabs, by commas or by blanks, the first of these that the first line has. Where
    it is not the comma, numbers may have decimal commas. Blank lines are passed over, and lines that begin with # but
    for names above the columns. An empty cell, nan, n/a and the like is a number that is not finite.

    Parameters
    ----------
    path
        a text in UTF-8, in UTF-16 with its mark, or in Latin-1

    Returns
    -------
    dict[str, Array]
        columns (T,) by the names in the first line, where it holds names, and all of them (T, k) as ""

    Raises
    ------
    ConversionError
        the file is no text, or has no numbers, names twice, lines of different lengths, or cells that are no numbers.
    """
    everything = [_Line(i, text) for i, text in enumerate(_text_of(path).splitlines(), 1) if text.strip()]
    lines = [line for line in everything if not line.text.lstrip().startswith("#")]
    if not everything:
        raise ConversionError(f"{path}: is empty")
    above = everything[: everything.index(lines[0])] if lines else everything
    delimiter = next((mark for mark in (";", "\t", ",") if mark in (lines or above)[0].text), None)
    names: list[str] = []
    if lines and not all(map(_is_number, _words(lines[0].text, delimiter))):
        names, lines = [word.strip() for word in _words(lines[0].text, delimiter)], lines[1:]
    if not lines:
        raise ConversionError(f"{path}: holds names and no numbers")
    values = _values(path, lines, delimiter, names)
    if not names and above:
        words = [word.strip() for word in _words(above[-1].text.lstrip("# "), delimiter)]
        names = words if len(words) == values.shape[1] and not all(map(_is_number, words)) else []
    if names and len(names) != values.shape[1]:
        hint = _COMMAS if delimiter == "," and values.shape[1] > len(names) else ""
        raise ConversionError(f"{path}: has {len(names)} names in its first line and {values.shape[1]} columns{hint}")
    if len(set(names)) != len(names):
        raise ConversionError(f"{path}: has the same name twice in its first line: {listed(names)}")
    return {"": values} | {name: values[:, k] for k, name in enumerate(names)}


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


def _values(path: Path, lines: Sequence[_Line], delimiter: str | None, names: Sequence[str]) -> Array:
    """Numbers (T, k); where numpy's own reader does not take them, cell by cell, so that the bad one can be named."""
    texts = [line.text if delimiter == "," else line.text.replace(",", ".") for line in lines]
    try:
        return np.loadtxt(texts, delimiter=delimiter, ndmin=2, quotechar='"', comments=None)
    except ValueError:
        pass
    rows: list[list[float]] = []
    for line, text in zip(lines, texts, strict=True):
        words = _words(text, delimiter)
        if rows and len(words) != len(rows[0]):
            hint = _COMMAS if delimiter == "," and len(words) != len(names) else ""
            if line is lines[-1] and len(words) < len(rows[0]):
                hint = "; it is the last line: the file was cut off. Delete this line"
            raise ConversionError(
                f"{path}: line {line.number} has {len(words)} values, the lines before have {len(rows[0])}{hint}"
            )
        rows.append([_number(path, line.number, k, word, names) for k, word in enumerate(words)])
    return np.array(rows)


def _number(path: Path, line: int, column: int, word: str, names: Sequence[str]) -> float:
    word = word.strip()
    if word.lower() in MISSING:
        return float("nan")
    try:
        return float(word)
    except ValueError:
        name = f" ({names[column]})" if column < len(names) else ""
        hint = "; it looks like a date or a time of day: write seconds" if _DATE.search(word) else ""
        raise ConversionError(f"{path}: line {line}, column {column}{name}: {shown(word)} is no number{hint}") from None


def _words(text: str, delimiter: str | None) -> list[str]:
    return text.split() if delimiter is None else next(csv.reader([text], delimiter=delimiter, skipinitialspace=True))


def _is_number(word: str) -> bool:
    word = word.strip()
    if word.lower() in MISSING:
        return True
    try:
        float(word.replace(",", "."))
    except ValueError:
        return bool(_DATE.search(word))
    return True
