# SPDX-License-Identifier: Apache-2.0
"""The pages of nodes say of parameters what the nodes say of them; docs/architecture.md knows all modules."""

from __future__ import annotations

import ast
import importlib
import re
from graphlib import TopologicalSorter
from pathlib import Path

import pytest

from tpgmm_ros.runtime.parameters import Declared

ROOT = Path(__file__).resolve().parents[3]
PAGES = ROOT / "docs" / "reference" / "nodes"
NODES = [
    "frame_tracker",
    "reproduction",
    "impedance_controller",
    "joint_motion",
    "joint_reference",
    "baxter_simulator",
    "endpoint_poses",
    "recognition",
]


def row_of(item: Declared) -> str:
    default = f'"{item.default}"' if isinstance(item.default, str) else str(item.default)
    bounds = "" if item.lower is None or item.upper is None else f"{item.lower:g} to {item.upper:g}"
    fixed = " (fixed)" if item.fixed else ""
    default = default.lower() if isinstance(item.default, bool) else default
    return f"| `{item.name}` | {default} | {bounds} | {item.description}{fixed} |"


@pytest.mark.parametrize("node", NODES)
def test_each_parameter_of_a_node_stands_on_its_page_as_the_node_declares_it(node: str) -> None:
    declared: list[Declared] = importlib.import_module(f"tpgmm_ros.nodes.{node}").PARAMETERS
    section = (PAGES / f"{node}.md").read_text().split("## Parameters\n", 1)[1].split("\n##", 1)[0]
    rows = [line for line in section.splitlines() if re.match(r"\| `", line)]
    assert rows == [row_of(item) for item in declared]


def test_there_is_a_page_for_each_node_and_no_other() -> None:
    assert {path.stem for path in PAGES.glob("*.md")} == set(NODES)


# -- the table of modules


def modules_in_table(package: str) -> list[str]:
    """The files that docs/architecture.md names of a package, one for each time.

    A row stands for the files in its first column; the second and further ones lie in the folder of the one before. A
    row of a folder names its files beside it.
    """
    text = (ROOT / "docs" / "architecture.md").read_text()
    section = text.split(f"## {package}", 1)[1].split("\n## ", 1)[0]
    found = []
    for first, second in re.findall(r"^\| (`[^|]*`) \| ([^|]*) \|", section, re.MULTILINE):
        folder = ""
        for name in re.findall(r"`([\w/.]+)`", first):
            folder = name.rpartition("/")[0] or folder
            if name.endswith("/"):
                found += [f"{folder}/{file}" for file in re.findall(r"`(\w+\.py)`", second)]
            else:
                found.append(f"{folder}/{name}".lstrip("/") if "/" not in name else name)
    return found


def modules_of(package: str) -> dict[str, Path]:
    """The files of a package; without those that only say what a folder is and how it is run."""
    root = ROOT / "src" / package / package
    return {str(path.relative_to(root)): path for path in root.rglob("*.py") if not path.stem.startswith("__")}


@pytest.mark.parametrize("package", ["tpgmm_core", "tpgmm_ros", "tpgmm_demos", "tpgmm_workbench"])
def test_the_table_of_modules_names_each_module_once_and_no_other(package: str) -> None:
    assert sorted(modules_in_table(package)) == sorted(modules_of(package))


@pytest.mark.parametrize("package", ["tpgmm_core", "tpgmm_ros", "tpgmm_demos", "tpgmm_workbench"])
def test_imports_of_modules_go_in_no_circle(package: str) -> None:
    """Those at the top of a module; an import for the type checker alone is none."""
    modules = modules_of(package)
    uses: dict[str, set[str]] = {}
    for name, path in modules.items():
        imports = [node for node in ast.parse(path.read_text()).body if isinstance(node, ast.ImportFrom)]
        dotted = {f"{node.module}{end}" for node in imports for end in ("", *(f".{item.name}" for item in node.names))}
        uses[name] = {other for other in modules if f"{package}.{other[:-3].replace('/', '.')}" in dotted}
    assert list(TopologicalSorter(uses).static_order())
