# SPDX-License-Identifier: Apache-2.0
"""YAML that people write: read key by key, with errors that say where and what was expected.

Unknown keys are refused.
"""

from __future__ import annotations

import difflib
import os
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Any, Self

from tpgmm_core.common.safe_yaml import YamlError, load_yaml, parse_yaml
from tpgmm_core.common.text import one_line, shown
from tpgmm_core.common.yaml_values import checked_text


class Section:
    """One mapping of the file, and where it stands there, so that errors can say so."""

    def __init__(self, file: str | Path, where: str, values: Any) -> None:
        self.file, self.source, self.where = file, one_line(file), where
        if not isinstance(values, Mapping):
            found = "empty" if values is None else shown(values)
            raise self.error(f"is {found}, expected a mapping of keys to values")
        for key in values:
            if not isinstance(key, str):
                raise self.error(
                    f"has the key {shown(key)}, expected a word "
                    "(put on, off, yes, no and numbers in quotes: without them, YAML does not read a word)"
                )
        self.values: Mapping[str, Any] = values

    @classmethod
    def load(cls, path: Path, what: str) -> Self:
        """The whole of a file; `what` is what errors say was expected, such as "a task file". Raises YamlError."""
        return cls(path, "", load_yaml(path, what))

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

    def path_in(self, key: str, what: str) -> Path:
        """The path that a key names, from the folder of this file; ~ is the home folder.

        Parameters
        ----------
        key
            its name
        what
            the path is of, in words

        Returns
        -------
        Path
            of something that may not exist

        Raises
        ------
        YamlError
            where the key is missing or has another value than a text
        """
        read = checked_text(bool, f"the path of {what}, from this file")
        return Path(self.file).parent / os.path.expanduser(self.required(key, read))

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
        return Section(self.file, self.path(key), self.values.get(key, {}))

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
