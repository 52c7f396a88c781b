# SPDX-License-Identifier: Apache-2.0
"""What a docstring says is true and complete: of parameters, of what is returned, of errors."""

from __future__ import annotations

import ast
import re
from pathlib import Path

import pytest

from ros_graph import ROOT

SOURCES = sorted(
    path
    for package in ("tpgmm_core", "tpgmm_ros", "tpgmm_demos", "tpgmm_workbench")
    for path in (ROOT / "src" / package / package).rglob("*.py")
)
type Function = ast.FunctionDef | ast.AsyncFunctionDef
type Documented = ast.FunctionDef | ast.AsyncFunctionDef | ast.ClassDef


each_source = pytest.mark.parametrize("path", SOURCES, ids=lambda path: path.relative_to(ROOT / "src").as_posix())


def names_of_section(docstring: str, section: str) -> list[str]:
    """Names in a section of a numpydoc docstring."""
    found = re.search(rf"^{section}\n-+\n(.*?)(?=\n\S[^\n]*\n-+\n|\Z)", docstring, re.DOTALL | re.MULTILINE)
    if found is None:
        return []
    heads = [line.partition(" : ")[0] for line in found[1].splitlines() if line and not line.startswith(" ")]
    return [name.strip().lstrip("*") for head in heads for name in head.split(",")]


def arguments_of(function: Function) -> list[str]:
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


@each_source
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


def functions_of(tree: ast.Module) -> list[tuple[str, Function, ast.ClassDef | None]]:
    """Public functions, and public methods of public classes, with their names and classes."""
    found: list[tuple[str, Function, ast.ClassDef | None]] = []
    for item in tree.body:
        members = item.body if isinstance(item, ast.ClassDef) else [item]
        owner = item if isinstance(item, ast.ClassDef) else None
        prefix = f"{owner.name}." if owner is not None else ""
        for member in members:
            if isinstance(member, ast.FunctionDef | ast.AsyncFunctionDef):
                name = prefix + member.name
                if not any(part.startswith("_") for part in name.split(".")):
                    found.append((name, member, owner))
    return found


def has_section(function: Function, *sections: str) -> bool:
    docstring = ast.get_docstring(function) or ""
    return any(re.search(rf"^{section}\n-+$", docstring, re.MULTILINE) for section in sections)


def is_attribute(function: Function) -> bool:
    """Whether it is read like an attribute, which numpydoc gives no sections."""
    decorators = [ast.unparse(decorator) for decorator in function.decorator_list]
    return any("property" in decorator or decorator.endswith(".setter") for decorator in decorators)


def is_short(function: Function) -> bool:
    """Whether one line says all: what is returned, for one or two arguments that it names."""
    return "\n" not in (ast.get_docstring(function) or "") and len(arguments_of(function)) <= 2


def returns_something(function: Function) -> bool:
    return function.returns is not None and ast.unparse(function.returns) not in ("None", "NoReturn", "Never")


def raises(function: Function) -> bool:
    """Whether a statement of its own raises an error, other than to pass one on."""
    waiting: list[ast.AST] = list(function.body)
    while waiting:
        node = waiting.pop()
        if isinstance(node, ast.Raise) and node.exc is not None:
            return True
        if not isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef | ast.ClassDef | ast.Lambda):
            waiting.extend(ast.iter_child_nodes(node))
    return False


def described_in_bases() -> set[str]:
    """Methods of the project's classes that say what they return: overriding ones need not say it again."""
    return {
        name for path in SOURCES for name, function, _ in functions_of(ast.parse(path.read_text()))
        if has_section(function, "Returns")
    }  # fmt: skip


BASES = described_in_bases()


def is_described_in_base(name: str, owner: ast.ClassDef | None) -> bool:
    bases = [ast.unparse(base).partition("[")[0].rpartition(".")[2] for base in owner.bases] if owner else []
    method = name.rpartition(".")[2]
    return any(f"{base}.{method}" in BASES or is_described_in_base(name, CLASSES.get(base)) for base in bases)


CLASSES = {
    item.name: item for path in SOURCES for item in ast.parse(path.read_text()).body if isinstance(item, ast.ClassDef)
}


@each_source
def test_what_is_returned_has_a_section(path: Path) -> None:
    wrong = [
        f"{name} (line {function.lineno}) -> {ast.unparse(function.returns)}"
        for name, function, owner in functions_of(ast.parse(path.read_text()))
        if function.returns is not None
        and returns_something(function)
        and not (is_attribute(function) or is_short(function) or is_described_in_base(name, owner))
        and not has_section(function, "Returns", "Yields")
    ]
    assert not wrong, "\n".join(wrong)


@each_source
def test_errors_that_are_raised_have_a_section(path: Path) -> None:
    wrong = [
        f"{name} (line {function.lineno})"
        for name, function, _ in functions_of(ast.parse(path.read_text()))
        if raises(function) and not is_attribute(function) and not has_section(function, "Raises")
    ]
    assert not wrong, "\n".join(wrong)


def test_returned_values_and_errors_are_found() -> None:
    (function,) = ast.parse(
        "def f(a: int, b: int, c: int) -> int:\n    'Sum.'\n    if a:\n        raise ValueError"
    ).body
    assert isinstance(function, ast.FunctionDef)
    assert returns_something(function) and raises(function) and not is_short(function)
    assert not has_section(function, "Returns") and not has_section(function, "Raises")


def test_the_names_of_a_section_are_found() -> None:
    parameters = "Parameters\n----------\na, b : int\n    Of it.\n*rest\n    More."
    text = f"Do.\n\n{parameters}\n\nRaises\n------\nValueError\n    Never."
    assert names_of_section(text, "Parameters") == ["a", "b", "rest"]
    assert names_of_section(text, "Raises") == ["ValueError"]
