# SPDX-License-Identifier: Apache-2.0
"""What a docstring says of parameters is true: it names those that there are, in their order."""

from __future__ import annotations

import ast
import re
from pathlib import Path

import pytest

from ros_graph import ROOT

SOURCES = sorted(
    path
    for package in ("tpgmm_core", "tpgmm_ros", "tpgmm_demos")
    for path in (ROOT / "src" / package / package).rglob("*.py")
)
type Documented = ast.FunctionDef | ast.AsyncFunctionDef | ast.ClassDef


def names_of_section(docstring: str, section: str) -> list[str]:
    """Names in a section of a numpydoc docstring."""
    found = re.search(rf"^{section}\n-+\n(.*?)(?=\n\S[^\n]*\n-+\n|\Z)", docstring, re.DOTALL | re.MULTILINE)
    if found is None:
        return []
    heads = [line.partition(" : ")[0] for line in found[1].splitlines() if line and not line.startswith(" ")]
    return [name.strip().lstrip("*") for head in heads for name in head.split(",")]


def arguments_of(function: ast.FunctionDef | ast.AsyncFunctionDef) -> list[str]:
    given = function.args
    positional = [*given.posonlyargs, *given.args]
    names = [item.arg for item in (*positional, given.vararg, *given.kwonlyargs, given.kwarg) if item is not None]
    return [name for name in names if name not in ("self", "cls")]


def parameters_of(item: Documented) -> list[str]:
    """What a function takes; what makes an object of a class: its constructor's, or its fields."""
    if not isinstance(item, ast.ClassDef):
        return arguments_of(item)
    for member in item.body:
        if isinstance(member, ast.FunctionDef) and member.name == "__init__":
            return arguments_of(member)
    return [m.target.id for m in item.body if isinstance(m, ast.AnnAssign) and isinstance(m.target, ast.Name)]


def inherits(item: Documented) -> bool:
    """Whether parameters may come from another class."""
    return isinstance(item, ast.ClassDef) and bool(item.bases)


@pytest.mark.parametrize("path", SOURCES, ids=lambda path: path.relative_to(ROOT / "src").as_posix())
def test_parameters_in_docstrings_are_those_of_the_signature(path: Path) -> None:
    wrong = []
    for item in ast.walk(ast.parse(path.read_text())):
        if not isinstance(item, ast.FunctionDef | ast.AsyncFunctionDef | ast.ClassDef):
            continue
        documented = names_of_section(ast.get_docstring(item) or "", "Parameters")
        actual = parameters_of(item)
        unknown = [name for name in documented if name not in actual]
        if (unknown and not inherits(item)) or [n for n in documented if n in actual] != [
            n for n in actual if n in documented
        ]:
            wrong.append(f"{item.name} (line {item.lineno}): says {documented}, takes {actual}")
    assert not wrong, "\n".join(wrong)


def test_the_names_of_a_section_are_found() -> None:
    parameters = "Parameters\n----------\na, b : int\n    Of it.\n*rest\n    More."
    text = f"Do.\n\n{parameters}\n\nRaises\n------\nValueError\n    Never."
    assert names_of_section(text, "Parameters") == ["a", "b", "rest"]
    assert names_of_section(text, "Raises") == ["ValueError"]
