# SPDX-License-Identifier: Apache-2.0
"""Text of others in our own sentences: on one line, without control characters, and short.

Names in messages and files, parameters, and topics of bags may be megabytes long, hold line breaks that look like new
lines of a log, or codes that a terminal obeys. Whatever comes from outside passes through here before it is part of an
error, a log, a diagnostic or a status.
"""

from __future__ import annotations

import re
from collections.abc import Iterable
from itertools import islice
from typing import Any

NAME_LIMIT = 60
"""Characters of a name or value in a sentence."""
LINE_LIMIT = 2000
"""Characters of a whole message."""
_NAME = re.compile(r"[A-Za-z0-9_./~-]+")


def shown(value: Any, limit: int = NAME_LIMIT) -> str:
    """A value as Python writes it, texts in quotes, short enough for a sentence.

    Parameters
    ----------
    value
        anything
    limit
        most characters that are shown of it

    Returns
    -------
    str
        `repr(value)`, cut to the limit
    """
    if isinstance(value, str | bytes):
        value = value[: limit + 1]  # what is not shown need not be escaped
    try:
        text = repr(value)
    except ValueError:  # integers beyond Python's limit of digits have no text
        text = f"{type(value).__name__} too large to show"
    return one_line(text, limit)


def listed(values: Iterable[Any], most: int = 12) -> str:
    """Names or values separated by commas, and how many more there are beyond `most`; "nothing" where there are none.

    Names of letters, digits and the signs that topics and files have are shown as they are, all others as by `shown`.

    Parameters
    ----------
    values
        names, or anything else
    most
        how many of them are written out

    Returns
    -------
    str
        one line
    """
    rest = iter(values)
    parts = [_plain(value) for value in islice(rest, most)]
    others = sum(1 for _ in rest)
    if others:
        parts.append(f"… and {others} more")
    return ", ".join(parts) or "nothing"


def counted(count: int | str, noun: str) -> str:
    """So many of a thing, count and noun, in words: 1 bag, 2 bags, ? bags."""
    return f"{count} {noun}" if count == 1 else f"{count} {noun}s"


def _plain(value: Any) -> str:
    if isinstance(value, str) and len(value) <= NAME_LIMIT and _NAME.fullmatch(value):
        return value
    return shown(value)


def one_line(text: object, limit: int = LINE_LIMIT) -> str:
    """A text without quotes: line breaks and spaces as one space, what cannot be printed escaped, cut to `limit`.

    Of an error of the system, its file and its reason, without the number.

    Parameters
    ----------
    text
        or an error
    limit
        characters

    Returns
    -------
    str
        one line; "…" at its end where it was cut
    """
    whole = str(text)
    if isinstance(text, OSError) and text.strerror and text.filename is not None:
        whole = f"{text.filename}: {text.strerror}"
    line = " ".join(whole[: 2 * limit].split())
    if not line.isprintable():
        line = "".join(c if c.isprintable() else c.encode("unicode_escape").decode("ascii") for c in line)
    return line if len(line) <= limit and len(whole) <= 2 * limit else line[:limit] + "…"
