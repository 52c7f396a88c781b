# SPDX-License-Identifier: Apache-2.0
"""Interfaces that are built from lists of fields are those of a full installation."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
import yaml
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from tpgmm_ros.messages.sources import SOURCES, TF_MESSAGE

ROOT = Path(__file__).resolve().parents[1]
PACKAGES: dict[str, Any] = yaml.safe_load((ROOT / "tools" / "standard_interfaces.yaml").read_text())
HASHES = [
    (name, interface, value)
    for name, item in PACKAGES.items()
    for interface, value in item["hashes"].items()
    if f"{interface}.action" not in item["files"]  # of an action its parts, which are messages
]


@pytest.mark.parametrize(("package", "interface", "expected"), HASHES)
def test_the_fields_give_the_hash_that_is_published(package: str, interface: str, expected: str) -> None:
    """Computed by rosbags, which shares no code with what builds them."""
    store = get_typestore(Stores.ROS2_JAZZY)
    types: dict[str, Any] = {}
    for file, text in PACKAGES[package]["files"].items():
        name, _, kind = file.partition(".")
        if kind == "msg":
            types |= get_types_from_msg(text, f"{package}/{name}")
        elif kind == "action":
            for part, fields in zip(("Goal", "Result", "Feedback"), text.split("---\n"), strict=True):
                types |= get_types_from_msg(fields, f"{package}/{name}_{part}")
    store.register(types)  # refuses other fields for a type that it knows itself
    assert store.hash_rihs01(f"{package}/{interface}") == expected


def test_every_source_has_an_interface_that_is_installed_or_built() -> None:
    installed = {path.parent.name for path in (ROOT / ".venv" / "share").glob("*/package.xml")}
    for package in {name.split("/")[0] for name in (*SOURCES, TF_MESSAGE)}:
        assert package in installed | PACKAGES.keys()
