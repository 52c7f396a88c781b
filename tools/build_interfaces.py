# SPDX-License-Identifier: Apache-2.0
"""Build interface packages of ROS 2 that its wheels lack into a prefix, from lists of their fields.

    .venv/bin/python tools/build_interfaces.py tools/standard_interfaces.yaml .venv

A package that the prefix or a sourced installation has already is not built. Each hash that the list names is
compared with that of the type that was built: it tells whether nodes here and elsewhere mean the same type.
"""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
from pathlib import Path
from typing import Any

import yaml

MARK = "built_from_fields"
"""Empty file beside the interfaces of a package that was built here, and may be built again."""

CMAKE = """\
cmake_minimum_required(VERSION 3.8)
project({name})
find_package(ament_cmake REQUIRED)
find_package(rosidl_default_generators REQUIRED)
{find}
rosidl_generate_interfaces(${{PROJECT_NAME}}
  {files}
  DEPENDENCIES {depends}
)
ament_export_dependencies(rosidl_default_runtime)
ament_package()
"""
PACKAGE = """\
<?xml version="1.0"?>
<package format="3">
  <name>{name}</name>
  <version>{version}</version>
  <description>Interfaces of ROS 2, from lists of their fields.</description>
  <maintainer email="maintainers@users.noreply.h-seed-91c8a9ef.example">tpgmm maintainers</maintainer>
  <license>Apache-2.0</license>
  <buildtool_depend>ament_cmake</buildtool_depend>
  <buildtool_depend>rosidl_default_generators</buildtool_depend>
  {depends}
  <exec_depend>rosidl_default_runtime</exec_depend>
  <member_of_group>rosidl_interface_packages</member_of_group>
  <export><build_type>ament_cmake</build_type></export>
</package>
"""


def is_installed(name: str, prefix: Path) -> bool:
    """Whether the package is there already, and not from here."""
    prefixes = [prefix, *(Path(other) for other in os.environ.get("AMENT_PREFIX_PATH", "").split(":") if other)]
    return any(
        (other / "share" / name / "package.xml").exists() and not (other / "share" / name / MARK).exists()
        for other in prefixes
    )


def write_sources(name: str, package: dict[str, Any], source: Path) -> None:
    """The package as ROS packages are: CMakeLists.txt, package.xml, interfaces; what it has already is left alone."""
    depends = package["depends"]
    tags = "\n  ".join(f"<depend>{other}</depend>" for other in depends)
    files = {
        **package["files"],
        "CMakeLists.txt": CMAKE.format(
            name=name,
            find="\n".join(f"find_package({other} REQUIRED)" for other in depends),
            files="\n  ".join(f'"{file}"' for file in package["files"]),
            depends=" ".join(depends),
        ),
        "package.xml": PACKAGE.format(name=name, version=package["version"], depends=tags),
    }
    present = {str(path.relative_to(source)): path.read_text() for path in source.rglob("*") if path.is_file()}
    if present == files:  # nothing is newer then, and nothing is compiled again
        return
    shutil.rmtree(source, ignore_errors=True)
    for file, text in files.items():
        path = source / file
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text)


def build(source: Path, directory: Path, prefix: Path) -> None:
    """Configure, build and install."""
    for command in (
        ["cmake", "-S", source, "-B", directory, f"-DCMAKE_INSTALL_PREFIX={prefix}", "-DCMAKE_BUILD_TYPE=Release"],
        ["cmake", "--build", directory, "--parallel", str(os.cpu_count() or 1)],
        ["cmake", "--install", directory],
    ):
        if subprocess.run(list(map(str, command)), check=False).returncode:
            sys.exit(f"error: {source.name} could not be built: {' '.join(map(str, command))}")


def check_hashes(name: str, hashes: dict[str, str], prefix: Path) -> None:
    """Compare the hashes of types that were built with those that are published."""
    for interface, expected in hashes.items():
        file = interface.partition("_")[0]  # the parts of an action are in its file
        description = json.loads((prefix / "share" / name / f"{file}.json").read_text())
        full_name = f"{name}/{interface}"
        found = next(item["hash_string"] for item in description["type_hashes"] if item["type_name"] == full_name)
        if found != expected:
            sys.exit(f"error: {full_name} has the hash {found}, expected {expected}: its fields are others")
        print(f"{full_name}: {found}, as on a full installation")


def main() -> None:
    """Build what is missing."""
    if len(sys.argv) != 3:
        sys.exit("usage: build_interfaces.py LIST.yaml PREFIX")
    prefix = Path(sys.argv[2]).resolve()
    for name, package in yaml.safe_load(Path(sys.argv[1]).read_text()).items():
        if is_installed(name, prefix):
            print(f"{name} is installed already")
            continue
        source, directory = prefix / "build" / "sources" / name, prefix / "build" / name
        write_sources(name, package, source)
        build(source, directory, prefix)
        (prefix / "share" / name / MARK).touch()
        check_hashes(name, package["hashes"], prefix)


if __name__ == "__main__":
    main()
