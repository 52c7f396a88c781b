# SPDX-License-Identifier: Apache-2.0
"""Folders of a package import one way: each only from those before it, wherever in a module the import is.

The name of a type means one thing in all packages.
"""

from __future__ import annotations

import ast
from pathlib import Path

import pytest

SOURCES = Path(__file__).resolve().parents[1] / "src"
#: Package -> its folders and top modules, from what knows nothing of the others to what may know all.
LAYERS = {
    "tpgmm_ros": ("messages", "runtime", "task", "recordings", "models", "nodes", "programs", "executables"),
    "tpgmm_demos": ("scene", "teaching", "demo", "figure5", "executables"),
    "tpgmm_workbench": (
        "project",
        "session",
        "graph",
        "desk",
        "scene",
        "page",
        "workbench",
        "simulated",
        "executables",
    ),
}
#: Package -> the packages of the workspace that it may import.
PACKAGES = {
    "tpgmm_core": set[str](),
    "tpgmm_ros": {"tpgmm_core", "tpgmm_msgs"},
    "tpgmm_demos": {"tpgmm_core", "tpgmm_msgs", "tpgmm_ros"},
    "tpgmm_workbench": {"tpgmm_core", "tpgmm_msgs", "tpgmm_ros", "tpgmm_demos"},
}


def imports_of(path: Path) -> set[str]:
    """Dotted names that a module imports, within functions and for the type checker too."""
    found = set()
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.Import):
            found |= {item.name for item in node.names}
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0 and node.module, f"{path}: imports are absolute"
            found |= {f"{node.module}.{item.name}" for item in node.names}
    return found


def modules(package: str) -> list[tuple[Path, set[str]]]:
    """Each module of a package, by its path below the package, with what it imports."""
    root = SOURCES / package / package
    return [(path.relative_to(root), imports_of(path)) for path in sorted(root.rglob("*.py"))]


def folder_of(path: Path) -> str:
    """The folder of a module; of a module at the top its own name, of the package's __init__ nothing."""
    return "" if path == Path("__init__.py") else path.parts[0].removesuffix(".py")


@pytest.mark.parametrize("package", LAYERS)
def test_every_folder_of_a_package_has_its_place(package: str) -> None:
    assert {folder_of(path) for path, _ in modules(package)} - {""} == set(LAYERS[package])


@pytest.mark.parametrize("package", LAYERS)
def test_folders_import_only_from_those_before_them(package: str) -> None:
    layers, wrong = LAYERS[package], []
    for path, imports in modules(package):
        here = folder_of(path)
        for name in imports:
            other = name.split(".")[1] if name.startswith(f"{package}.") else here
            if other in layers and (not here or layers.index(other) > layers.index(here)):
                wrong.append(f"{path} imports {name}")
    assert not wrong


@pytest.mark.parametrize("package", PACKAGES)
def test_a_package_imports_only_the_packages_that_it_may(package: str) -> None:
    known = set(PACKAGES) | {"tpgmm_msgs", "benchmarks", "examples"}
    used = {name.partition(".")[0] for _, imports in modules(package) for name in imports}
    assert used & known - {package} <= PACKAGES[package]


def types_of(path: Path) -> set[str]:
    """Names of the public classes and type aliases that a module defines."""
    found = set()
    for node in ast.parse(path.read_text()).body:
        if isinstance(node, ast.ClassDef):
            found.add(node.name)
        elif isinstance(node, ast.TypeAlias):
            found.add(node.name.id)
        elif isinstance(node, ast.Assign | ast.AnnAssign):
            names = node.targets if isinstance(node, ast.Assign) else [node.target]
            found |= {name.id for name in names if isinstance(name, ast.Name) and not name.id.isupper()}
    return {name for name in found if name[0].isupper()}


def test_the_name_of_a_type_means_one_thing() -> None:
    places: dict[str, list[str]] = {}
    for package in PACKAGES:
        for path in sorted((SOURCES / package / package).rglob("*.py")):
            for name in types_of(path):
                places.setdefault(name, []).append(f"{path.relative_to(SOURCES / package)}")
    assert {name: paths for name, paths in places.items() if len(paths) > 1} == {}
