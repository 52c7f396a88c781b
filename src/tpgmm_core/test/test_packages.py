# SPDX-License-Identifier: Apache-2.0
"""The packages of the core import one way: each only from those before it, wherever in a module the import is."""

from __future__ import annotations

import ast
import re
import sys
from graphlib import TopologicalSorter
from pathlib import Path

import pytest

import tpgmm_core

ROOT = Path(tpgmm_core.__file__).parent
PAGE = Path(__file__).resolve().parents[3] / "docs" / "architecture.md"
TOP = {"__init__", "warm_up"}
"""The public interface, and the program that compiles everything."""
PACKAGES = (
    "common",
    "geometry",
    "lqr",
    "model",
    "learning.covariance",
    "learning.estimation",
    "learning",
    "learning.hidden_markov",
    "learning.incremental",
    "retrieval",
    "choice",
    "doubt",
    "recognition",
    "robot",
    "observation",
    "kinematics",
    "control",
)
"""From what knows nothing of the others to what may know them all."""


def imports_of(source: str) -> set[str]:
    """Dotted names that a module imports, within functions and for the type checker too."""
    found = set()
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.Import):
            found |= {item.name for item in node.names}
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, "imports are absolute, so that each says where it goes"
            found |= {f"{node.module}.{item.name}" for item in node.names}
    return found


def sources() -> dict[str, str]:
    """Each module of the core below its top, "package.module", with its text."""
    paths = [path for path in ROOT.rglob("*.py") if path.parent != ROOT]
    return {".".join(path.relative_to(ROOT).with_suffix("").parts): path.read_text() for path in paths}


def uses(modules: dict[str, str]) -> dict[str, set[str]]:
    """Module → those that it imports, or imports something of; a name of the public interface counts as "__init__"."""
    found: dict[str, set[str]] = {}
    for module, source in modules.items():
        found[module] = set()
        for name in imports_of(source):
            first, _, rest = name.partition(".")
            if first == "tpgmm_core":
                ways = [rest, rest.rpartition(".")[0], f"{rest}.__init__", f"{rest.rpartition('.')[0]}.__init__"]
                found[module].add(next((way for way in ways if way in modules), "__init__"))
    return found


def backwards(modules: dict[str, str]) -> list[str]:
    """Imports that go to a package that stands behind, or to the public interface, in words."""
    place = {package: number for number, package in enumerate(PACKAGES)}
    wrong = []
    for module, others in uses(modules).items():
        for other in others:
            package = other.rpartition(".")[0]
            if package not in place or place[package] > place[module.rpartition(".")[0]]:
                wrong.append(f"{module} imports {other}")
    return wrong


def test_nothing_lies_at_the_top_but_the_public_interface_and_the_warm_up() -> None:
    assert {path.stem for path in ROOT.glob("*.py")} == TOP


def test_every_package_has_its_place_in_the_order() -> None:
    assert {module.rpartition(".")[0] for module in sources()} == set(PACKAGES)


def test_packages_import_only_from_those_before_them() -> None:
    assert not backwards(sources())


@pytest.mark.parametrize(
    "line",
    [
        "from tpgmm_core.control.laws import LAWS",
        "import tpgmm_core.control.laws",
        "def late():\n    from tpgmm_core.control import laws",
        "if TYPE_CHECKING:\n    from tpgmm_core.learning.tpgmm import TPGMM",
        "from tpgmm_core import TPGMM",
    ],
)
def test_an_import_of_what_stands_behind_is_found_wherever_it_is(line: str) -> None:
    modules = sources()
    modules["geometry.frame"] += f"\n\n{line}\n"
    assert len(backwards(modules)) == 1


def test_imports_of_modules_go_in_no_circle() -> None:
    """Within a package neither, and those for the type checker count."""
    assert list(TopologicalSorter(uses(sources())).static_order())


def test_the_tests_of_the_core_import_the_core_alone() -> None:
    """Beside it what lies beside them, and what `setup.py` and `package.xml` ask for: no other part of the project."""
    here = Path(__file__).parent
    beside = {path.stem for path in here.glob("*.py")}
    installed = {"daqp", "hypothesis", "joblib", "numba", "numpy", "pinocchio", "pytest", "scipy", "sklearn", "yaml"}
    known = beside | installed | set(sys.stdlib_module_names) | {"tpgmm_core"}
    for path in here.glob("*.py"):
        unknown = {name.partition(".")[0] for name in imports_of(path.read_text())} - known
        assert not unknown, f"{path.name} imports {unknown}"


def test_the_page_of_the_architecture_has_the_packages_in_this_order() -> None:
    if not PAGE.exists():
        pytest.skip(f"{PAGE} is not part of an installed package")
    section = PAGE.read_text().split("## tpgmm_core", 1)[1].split("\n## ", 1)[0]
    headings = re.findall(r"^### ([\w/]+):", section, re.MULTILINE)
    assert [heading.replace("/", ".") for heading in headings] == list(PACKAGES)
