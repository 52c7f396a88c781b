# SPDX-License-Identifier: Apache-2.0
"""docs/interfaces.md says of the nodes' parameters what the nodes say of them."""

from __future__ import annotations

import importlib
import re
from pathlib import Path

import pytest

from tpgmm_ros.parameters import Declared

PAGE = Path(__file__).resolve().parents[3] / "docs" / "interfaces.md"
NODES = [
    "frame_tracker",
    "reproduction",
    "impedance_controller",
    "joint_reference",
    "baxter_simulator",
    "endpoint_poses",
]


def row_of(item: Declared) -> str:
    default = f'"{item.default}"' if isinstance(item.default, str) else str(item.default)
    bounds = "" if item.lower is None or item.upper is None else f"{item.lower:g} to {item.upper:g}"
    fixed = " (fixed)" if item.fixed else ""
    default = default.lower() if isinstance(item.default, bool) else default
    return f"| `{item.name}` | {default} | {bounds} | {item.description}{fixed} |"


@pytest.mark.parametrize("node", NODES)
def test_each_parameter_of_a_node_stands_in_its_table_as_the_node_declares_it(node: str) -> None:
    declared: list[Declared] = importlib.import_module(f"tpgmm_ros.{node}_node").PARAMETERS
    section = PAGE.read_text().split("## Parameters", 1)[-1].split(f"### {node}\n", 1)[1].split("\n##", 1)[0]
    rows = [line for line in section.splitlines() if re.match(r"\| `", line)]
    assert rows == [row_of(item) for item in declared]
