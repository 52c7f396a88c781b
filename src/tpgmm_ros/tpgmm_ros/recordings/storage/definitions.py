# SPDX-License-Identifier: Apache-2.0
"""Definitions of message types for what is written: as they are installed, else as ROS 2 Jazzy has them."""

from __future__ import annotations

from functools import cache
from pathlib import Path
from typing import Any

from rosbags.typesys import Stores, get_types_from_idl, get_types_from_msg, get_typestore
from rosbags.typesys.store import Typestore


@cache
def types_for(name: str) -> Typestore:
    """What knows a type of messages, and all types that it is made of.

    What is installed is what publishers of this machine send; a type that is not installed is looked up among those
    of ROS 2 Jazzy.

    Parameters
    ----------
    name
        full name, such as geometry_msgs/msg/PoseStamped

    Returns
    -------
    Typestore
        serialises the type, and writes its definition

    Raises
    ------
    ValueError
        the type, or one that it is made of, is known nowhere.
    """
    found: dict[str, Any] = {}
    wanted = [name]
    while wanted:
        kind = wanted.pop()
        if kind not in found:
            found[kind] = _definition(kind)
            wanted += [part for _, field in found[kind][1] for part in _names_in(field)]
    store = get_typestore(Stores.EMPTY)
    store.register(found)
    return store


def _definition(name: str) -> Any:
    """Constants and fields of a type."""
    package, _, short = name.partition("/msg/")
    path = _installed(package)
    for suffix, parse in ((".msg", _of_msg), (".idl", _of_idl)):
        file = None if path is None else path / "msg" / f"{short}{suffix}"
        if file is not None and file.is_file():
            return parse(file.read_text(), name)
    known = get_typestore(Stores.ROS2_JAZZY).fielddefs
    if name not in known:
        raise ValueError(
            f"the message type {name} is not known: install its package, as 'apt install "
            f"ros-jazzy-{package.replace('_', '-')}' does on a full installation"
        )
    return known[name]


def _of_msg(text: str, name: str) -> Any:
    return get_types_from_msg(text, name)[name]


def _of_idl(text: str, name: str) -> Any:
    return get_types_from_idl(text)[name]


def _installed(package: str) -> Path | None:
    """Where a package's definitions are; None where it, or all of ROS, is not installed."""
    try:
        from ament_index_python.packages import PackageNotFoundError, get_package_share_directory
    except ModuleNotFoundError:
        return None
    try:
        return Path(get_package_share_directory(package))
    except (PackageNotFoundError, ValueError):
        return None


def _names_in(field: Any) -> list[str]:
    """Types that a field is made of: a name, or an array or a sequence of one."""
    kind, content = field
    if kind.name == "NAME":
        return [content]
    return _names_in(content[0]) if kind.name in ("ARRAY", "SEQUENCE") else []
