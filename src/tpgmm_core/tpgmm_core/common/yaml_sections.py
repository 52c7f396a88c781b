# SPDX-License-Identifier: Apache-2.0
"""YAML that people write: read key by key, with errors that say where and what was expected.

Unknown keys are refused.
"""

from __future__ import annotations

import difflib
import math
import re
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Any, Self

from tpgmm_core.common.safe_yaml import YamlError, load_yaml, parse_yaml
from tpgmm_core.common.text import one_line, shown

_NAME = re.compile(r"[A-Za-z_][A-Za-z0-9_]*")
_TOPIC = re.compile(r"[A-Za-z_][A-Za-z0-9_]*(/[A-Za-z_][A-Za-z0-9_]*)*")
_QUATERNION_TOLERANCE = 1e-3
"""How far from 1 the norm of a written quaternion may be: three or four digits are what people type."""


class Section:
    """One mapping of the file, and where it stands there, so that errors can say so."""

    def __init__(self, source: str, where: str, values: Any) -> None:
        self.source, self.where = source, where
        if not isinstance(values, Mapping):
            raise self.error(f"is {shown(values)}, expected a mapping of keys to values")
        for key in values:
            if not isinstance(key, str):
                raise self.error(
                    f"has the key {shown(key)}, expected a word "
                    "(YAML reads bare on, off, yes, no and numbers as other things: quote them)"
                )
        self.values: Mapping[str, Any] = values

    @classmethod
    def load(cls, path: Path, what: str) -> Self:
        """The whole of a file; `what` is what errors say was expected, such as "a task file". Raises YamlError."""
        return cls(one_line(path), "", load_yaml(path, what))

    @classmethod
    def from_text(cls, text: str, source: str) -> Self:
        """The whole of YAML text; `source` is what errors call it. Raises YamlError."""
        return cls(source, "", parse_yaml(text, source))

    def error(self, text: str) -> YamlError:
        """An error that names the file and the place in it."""
        return YamlError(f"{self.source}: {f"'{one_line(self.where)}'" if self.where else 'the file'} {text}")

    def path(self, key: str) -> str:
        """Where a key of this section is, from the top of the file."""
        return f"{self.where}.{key}" if self.where else key

    def refuse_others(self, *known: str) -> None:
        """Refuse keys that are not known.

        Parameters
        ----------
        *known
            the keys that there may be

        Raises
        ------
        YamlError
            for another key, with the known one that is most like it
        """
        for key in self.values:
            if key not in known:
                close = difflib.get_close_matches(key, known, n=1)
                hint = f"; did you mean {close[0]!r}?" if close else ""
                raise self.error(f"has the unknown key {shown(key)}, expected {', '.join(known)}{hint}")

    def required(self, key: str, read: Callable[[Any], Any]) -> Any:
        """The value of a key.

        Parameters
        ----------
        key
            its name
        read
            makes the value of what YAML holds; raises ValueError with what was expected

        Returns
        -------
        Any
            what `read` made

        Raises
        ------
        YamlError
            where the key is missing or `read` refuses its value
        """
        if key not in self.values:
            raise self.error(f"lacks the key '{key}'")
        try:
            return read(self.values[key])
        except ValueError as error:
            found = shown(self.values[key])
            raise YamlError(f"{self.source}: '{one_line(self.path(key))}' is {found}, expected {error}") from None

    def section(self, key: str, optional: bool = False) -> Section:
        """What is below a key, as a section.

        Parameters
        ----------
        key
            its name
        optional
            whether the key may be missing; the section is then empty

        Returns
        -------
        Section
            the section

        Raises
        ------
        YamlError
            where the key is missing and not optional
        """
        if key not in self.values and not optional:
            raise self.error(f"lacks the key '{key}'")
        return Section(self.source, self.path(key), self.values.get(key, {}))

    def sections(self, key: str, optional: bool = False) -> Iterator[tuple[str, Section]]:
        """The mappings in the mapping of a key, by name."""
        outer = self.section(key, optional)
        return ((name, outer.section(name)) for name in outer.values)

    def mapping(self, key: str, read: Callable[[Any], Any], optional: bool = False) -> dict[str, Any]:
        """The values in the mapping of a key, all read alike.

        Parameters
        ----------
        key
            its name
        read
            makes a value of what YAML holds
        optional
            whether the key may be missing

        Returns
        -------
        dict[str, Any]
            by name; empty where the key is missing and may be
        """
        outer = self.section(key, optional)
        return {name: outer.required(name, read) for name in outer.values}


# Readers turn one YAML value into what a program needs, or raise ValueError(what was expected).


def is_name(text: str) -> bool:
    """Letters, digits and underscores, no digit first."""
    return _NAME.fullmatch(text) is not None


def a_name(value: Any) -> str:
    """A value that must be a name.

    Parameters
    ----------
    value
        as YAML holds it

    Returns
    -------
    str
        the value

    Raises
    ------
    ValueError
        with what was expected
    """
    if not isinstance(value, str) or not is_name(value):
        raise ValueError("a name of letters, digits and underscores")
    return value


def a_text(value: Any) -> str:
    """A value that must be a text.

    Parameters
    ----------
    value
        as YAML holds it

    Returns
    -------
    str
        the value

    Raises
    ------
    ValueError
        with what was expected
    """
    if not isinstance(value, str):
        raise ValueError("a text; quote it if it looks like something else")
    return value


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
        raise ValueError("a list of names; quote names that look like something else, such as '1' or 'on'")
    if len(set(value)) != len(value):
        raise ValueError("a list of names, none of them twice")
    return tuple(value)


def a_topic(value: Any) -> str:
    """A value that must be a relative topic.

    Parameters
    ----------
    value
        as YAML holds it

    Returns
    -------
    str
        the value

    Raises
    ------
    ValueError
        with what was expected
    """
    if not isinstance(value, str) or not _TOPIC.fullmatch(value):
        raise ValueError("a relative topic such as object/pose (no leading slash, so that namespaces work)")
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

    def read(value: Any) -> str:
        if not isinstance(value, str) or value not in choices:
            raise ValueError("one of " + ", ".join(choices))
        return value

    return read
