# SPDX-License-Identifier: Apache-2.0
"""Readers of single values of YAML files: each makes a value, or raises ValueError with what was expected."""

from __future__ import annotations

import json
import math
import re
from collections.abc import Callable
from typing import Any

import yaml

from tpgmm_core.common.text import shown

_NAME = re.compile(r"[A-Za-z_][A-Za-z0-9_]*")
_TOPIC = re.compile(r"[A-Za-z_][A-Za-z0-9_]*(/[A-Za-z_][A-Za-z0-9_]*)*")
_QUATERNION_TOLERANCE = 1e-3
"""How far from 1 the norm of a written quaternion may be: three or four digits are what people type."""


def is_name(text: str) -> bool:
    """Letters, digits and underscores, no digit first."""
    return _NAME.fullmatch(text) is not None


def is_topic(text: str) -> bool:
    """A relative topic: names with slashes between."""
    return _TOPIC.fullmatch(text) is not None


def quoted(text: str) -> str:
    """A text as YAML reads it as such, in quotes where it would be a number, a truth or anything else without."""
    is_plain = _TOPIC.fullmatch(text) and yaml.safe_load(text) == text
    return text if is_plain else json.dumps(text)


def checked_text(is_valid: Callable[[str], object], expected: str) -> Callable[[Any], str]:
    """A reader of texts that fulfil a condition; `expected` says in words which."""

    def read(value: Any) -> str:
        if not isinstance(value, str) or not is_valid(value):
            raise ValueError(expected)
        return value

    return read


a_name = checked_text(is_name, "a name of letters, digits and underscores")
a_text = checked_text(lambda text: True, "a text (in quotes, if YAML could read it as a number or as true or false)")
a_topic = checked_text(is_topic, "a relative topic such as object/pose (no leading slash, so that namespaces work)")


def expect[T](read: Callable[[Any], T], value: Any) -> T:
    """What a reader makes of a value.

    Parameters
    ----------
    read
        makes something of a value, or raises ValueError with what was expected
    value
        of a file

    Returns
    -------
    T
        what `read` made

    Raises
    ------
    ValueError
        where `read` does, with what was expected and what was given
    """
    try:
        return read(value)
    except ValueError as error:
        raise ValueError(f"expected {error}, got {shown(value)}") from None


def some_names(value: Any) -> tuple[str, ...]:
    """A value that must be a list of names, at least one.

    Parameters
    ----------
    value
        as YAML holds it

    Returns
    -------
    tuple[str, ...]
        the names

    Raises
    ------
    ValueError
        with what was expected
    """
    if not isinstance(value, list) or not value or not all(isinstance(name, str) for name in value):
        raise ValueError("a list of names (in quotes, if YAML could read them as something else: '1', 'on')")
    if len(set(value)) != len(value):
        raise ValueError("a list of names, none of them twice")
    return tuple(value)


def a_truth(value: Any) -> bool:
    """A value that must be true or false.

    Parameters
    ----------
    value
        as YAML holds it

    Returns
    -------
    bool
        the value

    Raises
    ------
    ValueError
        with what was expected
    """
    if not isinstance(value, bool):
        raise ValueError("true or false")
    return value


def a_number(least: float = -math.inf) -> Callable[[Any], float]:
    """A reader of finite numbers of at least `least`."""

    def read(value: Any) -> float:
        what = "a finite number" + (f" of at least {least:g}" if math.isfinite(least) else "")
        if isinstance(value, bool) or not isinstance(value, int | float):
            raise ValueError(what)
        try:
            number = float(value)
        except OverflowError:
            raise ValueError(what) from None
        if not math.isfinite(number) or number < least:
            raise ValueError(what)
        return number

    return read


def numbers(count: int) -> Callable[[Any], tuple[float, ...]]:
    """A reader of lists of so many finite numbers."""

    def read(value: Any) -> tuple[float, ...]:
        if not isinstance(value, list) or len(value) != count:
            raise ValueError(f"{count} finite numbers")
        try:
            return tuple(a_number()(number) for number in value)
        except ValueError:
            raise ValueError(f"{count} finite numbers") from None

    return read


def a_quaternion(value: Any) -> tuple[float, ...]:
    """A value that must be four numbers of unit length.

    Parameters
    ----------
    value
        as YAML holds it

    Returns
    -------
    tuple[float, ...]
        qx, qy, qz, qw, normalised

    Raises
    ------
    ValueError
        with what was expected
    """
    try:
        quaternion = numbers(4)(value)
    except ValueError:
        quaternion = (0.0,)
    norm = math.hypot(*quaternion)
    if abs(norm - 1.0) > _QUATERNION_TOLERANCE:
        raise ValueError("four finite numbers qx qy qz qw of norm 1")
    return tuple(number / norm for number in quaternion)


def an_integer(least: int) -> Callable[[Any], int]:
    """A reader of whole numbers of at least `least`."""

    def read(value: Any) -> int:
        if isinstance(value, bool) or not isinstance(value, int) or not least <= value < 2**32:
            raise ValueError(f"a whole number of at least {least}")
        return value

    return read


def a_choice(*choices: str) -> Callable[[Any], str]:
    """A reader of texts that are one of these."""
    return checked_text(lambda text: text in choices, "one of " + ", ".join(choices))
