# SPDX-License-Identifier: Apache-2.0
"""Untrusted YAML files: read without executing anything, within limits of size and depth.

Aliases are refused, since a page of them unfolds to gigabytes, and so are doubled keys, with which a file means other
things than it seems to.
"""

from __future__ import annotations

import errno
import re
from pathlib import Path
from typing import Any

import yaml

from tpgmm_core.common.text import one_line, shown

MAX_BYTES = 64 * 1024
MAX_DEPTH = 20
"""Deepest nesting of mappings and lists. The files of this project have 3."""


class YamlError(ValueError):
    """A YAML file that cannot be used; the text names the file, the key, and what was expected."""


def load_yaml(path: Path, what: str) -> Any:
    """Read a YAML file.

    Parameters
    ----------
    path
        the file
    what
        what errors say was expected, such as "a task file"

    Returns
    -------
    Any
        mappings, lists, texts, numbers and dates, as the file holds them

    Raises
    ------
    YamlError
        for a file that cannot be read, is no regular file, is too large, or is no YAML
    """
    try:
        if path.exists() and not path.is_file():  # to open a pipe would wait for its other end
            raise OSError(errno.EINVAL, "not a regular file")
        with path.open("rb") as file:
            content = file.read(MAX_BYTES + 1)
    except (OSError, ValueError) as error:  # ValueError: a path with a null character
        reason = getattr(error, "strerror", None) or error
        raise YamlError(f"{one_line(path)}: cannot be read ({one_line(reason)}); expected {what} in YAML") from None
    if len(content) > MAX_BYTES:
        raise YamlError(f"{one_line(path)}: is larger than {MAX_BYTES} bytes; expected {what} in YAML")
    try:
        return parse_yaml(content.decode("utf-8"), one_line(path))
    except UnicodeDecodeError:
        raise YamlError(f"{one_line(path)}: is not UTF-8 text; expected {what} in YAML") from None


def parse_yaml(text: str, source: str) -> Any:
    """Read YAML text: mappings, lists, texts, numbers, dates.

    Parameters
    ----------
    text
        the YAML
    source
        what errors call it

    Returns
    -------
    Any
        mappings, lists, texts, numbers and dates, as the text holds them

    Raises
    ------
    YamlError
        where it is no YAML, is nested too deeply, or holds aliases or doubled keys
    """
    try:
        return yaml.load(text, Loader=_Loader)
    # PyYAML lets more than YAMLError out of malformed scalars: KeyError, IndexError, AttributeError, ...
    except Exception as error:
        hint = "; indent with spaces, not with tabs" if "\\t" in str(error) else ""
        why = one_line(error, 400).replace('in "<unicode string>", line', "in line")
        raise YamlError(f"{source}: is not a YAML file that can be read: {why}{hint}") from None


class _Loader(yaml.SafeLoader):
    """Safe YAML without aliases, without doubled keys, and of limited depth."""

    def __init__(self, text: str) -> None:
        super().__init__(text)
        self._depth = 0

    def compose_node(self, parent: Any, index: Any) -> Any:
        mark = self.peek_event().start_mark
        if self.check_event(yaml.AliasEvent):
            raise yaml.MarkedYAMLError(problem="aliases (*name) are not allowed here", problem_mark=mark)
        self._depth += 1
        if self._depth > MAX_DEPTH:
            raise yaml.MarkedYAMLError(problem=f"nested more than {MAX_DEPTH} deep", problem_mark=mark)
        node = super().compose_node(parent, index)
        self._depth -= 1
        return node

    def construct_mapping(self, node: Any, deep: bool = False) -> dict[Any, Any]:
        seen: set[str] = set()
        for key_node, _ in node.value:
            key = key_node.value
            if isinstance(key, str) and key in seen:
                raise yaml.MarkedYAMLError(
                    problem=f"the key {shown(key)} is given twice", problem_mark=key_node.start_mark
                )
            if isinstance(key, str):
                seen.add(key)
        return super().construct_mapping(node, deep)


def _integer(loader: _Loader, node: yaml.ScalarNode) -> int:
    """A whole number; YAML 1.1 reads 010 as 8, and people as 10."""
    text = str(node.value)
    if re.fullmatch(r"[-+]?0[0-9_]+", text):
        problem = f"{shown(text)} begins with 0, so that YAML reads it as octal: write it without the 0"
        raise yaml.MarkedYAMLError(problem=problem, problem_mark=node.start_mark)
    return int(loader.construct_yaml_int(node))


_Loader.add_constructor("tag:yaml.org,2002:int", _integer)


# YAML 1.1 reads 1e-6 as text, since it has no point; YAML 1.2 and people read a number.
_Loader.add_implicit_resolver(
    "tag:yaml.org,2002:float", re.compile(r"^[-+]?[0-9]+[eE][-+]?[0-9]+$"), list("-+0123456789")
)
