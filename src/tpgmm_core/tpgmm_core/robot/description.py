# SPDX-License-Identifier: Apache-2.0
"""The robot file: a YAML that says what a URDF does not, with every joint called by its name.

    urdf: package://example-robot-data/robots/baxter_description/urdf/baxter.urdf   # or a file in this one's folder
    base_frame: base                      # poses, Jacobians and wrenches are expressed in its axes
    joint_groups: {left_arm: [left_s0, ...], ...}
    endpoints: {left: {frame: left_gripper, joints: left_arm}, ...}
    limits: {head_pan: {effort: 5.0, velocity: 1.5}}       # optional; these replace the URDF's; also torque_rate, N m/s
    friction: {left_arm: {coulomb: 0.2}, ...}              # optional; replaces the URDF's damping and friction
    armature: {left_arm: {inertia: 0.1}, ...}              # optional, kg m^2: of the motors, as the joint feels it
    locked: {finger: 0.02, ...}                            # optional; joints that nobody here commands or measures
    gravity: [0, 0, -9.81]                                 # optional, m/s^2, in the axes of the base frame
    home: {left_s0: 0.0, ...}                              # every joint that is not locked

Keys of `limits`, `friction` and `armature` are joints or groups; where both are given, the joint's own entry counts.

A robot file may be untrusted: it reads no files but those of installed packages and of its own folder.
"""

from __future__ import annotations

import codecs
import os
import sys
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any
from xml.parsers import expat

from tpgmm_core.common.safe_yaml import YamlError, load_yaml
from tpgmm_core.common.text import listed, one_line, shown

PACKAGE_SCHEME = "package://"
REQUIRED_KEYS = ("urdf", "base_frame", "joint_groups", "endpoints", "home")
OPTIONAL_KEYS = ("limits", "friction", "armature", "locked", "gravity")
LIMIT_KEYS = ("effort", "velocity", "lower", "upper", "torque_rate")
FRICTION_KEYS = ("viscous", "coulomb")
ARMATURE_KEYS = ("inertia",)
MAX_URDF_BYTES = 4_000_000
MAX_URDF_DEPTH, MAX_URDF_JOINTS = 50, 500
"""Limit of the depth of a URDF's XML, and of its joints: its parser is recursive in both."""


_GEOMETRY = ("robot", "link", "joint", "origin", "mass", "inertia", "axis", "limit", "parent", "child", "mimic")


class RobotFileError(ValueError):
    """A robot file that cannot be used; the message says which, why, and what was expected."""


@dataclass(frozen=True, slots=True)
class Endpoint:
    """A frame of the URDF that is controlled, and the group of joints that moves it."""

    frame: str
    joints: str


@dataclass(frozen=True, slots=True)
class RobotDescription:
    """What a robot file says, checked for its form; whether the joints exist is checked against the URDF."""

    path: Path
    urdf: Path
    base_frame: str
    joint_groups: Mapping[str, tuple[str, ...]]
    endpoints: Mapping[str, Endpoint]
    limits: Mapping[str, Mapping[str, float]]
    friction: Mapping[str, Mapping[str, float]]
    home: Mapping[str, float]
    armature: Mapping[str, Mapping[str, float]] = field(default_factory=dict)
    locked: Mapping[str, float] = field(default_factory=dict)
    gravity: tuple[float, float, float] | None = None

    @classmethod
    def from_file(cls, path: str | os.PathLike[str]) -> RobotDescription:
        """Read a robot file.

        Parameters
        ----------
        path
            the file

        Raises
        ------
        RobotFileError
            with the file, the key and what was expected
        """
        path = Path(path)
        try:
            content = load_yaml(path, "a robot file")
        except YamlError as error:
            raise RobotFileError(str(error)) from None
        try:
            return cls._from_mapping(path, _mapping(content, "the robot file"))
        except RobotFileError as error:
            raise RobotFileError(f"{one_line(path)}: {error}") from error

    @classmethod
    def _from_mapping(cls, path: Path, content: Mapping[str, Any]) -> RobotDescription:
        missing = [key for key in REQUIRED_KEYS if key not in content]
        unknown = [key for key in content if key not in REQUIRED_KEYS + OPTIONAL_KEYS]
        if missing or unknown:
            raise RobotFileError(
                f"missing keys {listed(missing)}; unknown keys {listed(unknown)}; required are {listed(REQUIRED_KEYS)}"
            )
        groups = {name: _names(joints, name) for name, joints in _items(content, "joint_groups")}
        endpoints = {name: _endpoint(value, name, groups) for name, value in _items(content, "endpoints")}
        return cls(
            path=path,
            urdf=resolve_urdf(_text(content["urdf"], "urdf"), path.parent),
            base_frame=_text(content["base_frame"], "base_frame"),
            joint_groups=groups,
            endpoints=endpoints,
            limits=_per_joint(content, "limits", groups, LIMIT_KEYS),
            friction=_per_joint(content, "friction", groups, FRICTION_KEYS),
            armature=_per_joint(content, "armature", groups, ARMATURE_KEYS),
            home=_positions(content, "home"),
            locked=_positions({"locked": {}, **content}, "locked"),
            gravity=_gravity(content.get("gravity")),
        )


def resolve_urdf(reference: str, folder: Path) -> Path:
    """Find the file of `package://NAME/path` (in wheels and ROS workspaces), or of a path in `folder`.

    Links in installed packages are followed, since workspaces consist of them; links in `folder` only within it.

    Parameters
    ----------
    reference
        as the robot file names it
    folder
        of the robot file

    Raises
    ------
    RobotFileError
        where there is none, and for a path that leads out of the package or the folder
    """
    is_package = reference.startswith(PACKAGE_SCHEME)
    relative = Path(reference.removeprefix(PACKAGE_SCHEME))
    if relative.is_absolute() or ".." in relative.parts or "\0" in reference:
        raise RobotFileError(
            f"urdf {shown(reference)} leads out of its folder; expected a file beside the robot file or below, "
            f"or {PACKAGE_SCHEME}NAME/path"
        )
    candidates = [share / relative for share in _share_folders()] if is_package else [folder / relative]
    for candidate in candidates:
        if os.path.isfile(candidate):  # unlike Path.is_file, also says no to names that no file can have
            found = candidate.resolve()
            if not is_package and not found.is_relative_to(folder.resolve()):
                raise RobotFileError(f"urdf {shown(reference)} is a link to {found}, out of the robot file's folder")
            return found
    if is_package:
        places = listed(map(str, candidates), 6)
        raise RobotFileError(
            f"no URDF {shown(reference)} in {places}. Is its package installed (pip install example-robot-data)?"
        )
    hint = "; a xacro is expanded first: xacro FILE.xacro > robot.urdf" if "xacro" in reference else ""
    raise RobotFileError(
        f"no URDF {shown(reference)} in {folder.resolve()}; expected a file beside the robot file or below{hint}"
    )


def read_xml(path: Path) -> bytes:
    """Read the XML of a URDF, without a byte order mark and blank lines before it.

    Meshes are never opened.

    Parameters
    ----------
    path
        the file

    Raises
    ------
    OSError
        where the file cannot be read
    RobotFileError
        for what its parsers should not be given: no XML, a xacro, too large or too deep, or with a document type, since
        XML entities may refer to files or expand to gigabytes
    """
    with path.open("rb") as file:
        content = file.read(MAX_URDF_BYTES + 1)
    if len(content) > MAX_URDF_BYTES:
        raise RobotFileError(f"the URDF {path} has more than {MAX_URDF_BYTES} bytes")
    if not content.startswith((codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)):
        content = content.lstrip().removeprefix(codecs.BOM_UTF8).lstrip()
    if not content:
        raise RobotFileError(f"the URDF {path} is no XML: it is empty")
    depth = joints = 0
    is_xacro = False

    def start(tag: str, attributes: dict[str, str]) -> None:
        nonlocal depth, joints, is_xacro
        depth, joints = depth + 1, joints + (tag == "joint")
        if depth > MAX_URDF_DEPTH or joints > MAX_URDF_JOINTS:
            raise RobotFileError(
                f"the URDF {path} has more than {MAX_URDF_JOINTS} joints or levels within {MAX_URDF_DEPTH} others"
            )
        # an expanded xacro has no such elements and formulas
        is_formula = tag in _GEOMETRY and any("${" in text for text in attributes.values())
        is_xacro = is_xacro or is_formula or tag.startswith("xacro:")

    def end(_: str) -> None:
        nonlocal depth
        depth -= 1

    def refuse(*_: object) -> None:
        raise RobotFileError(f"the URDF {path} has a document type (<!DOCTYPE>); expected plain XML")

    parser = expat.ParserCreate()
    parser.StartElementHandler, parser.EndElementHandler = start, end
    parser.StartDoctypeDeclHandler = refuse
    try:
        parser.Parse(content, True)
    except (expat.ExpatError, LookupError) as error:  # LookupError: an unknown encoding
        raise RobotFileError(f"the URDF {path} is no XML: {error}") from None
    if is_xacro:
        raise RobotFileError(f"{path} is a xacro, not a URDF; expand it first: xacro {path.name} > robot.urdf")
    return content


def _share_folders() -> Iterator[Path]:
    """Folders that hold packages' data: of the Python wheels, and of a sourced ROS installation."""
    for entry in sys.path:
        yield Path(entry) / "cmeel.prefix" / "share"
    for prefix in os.environ.get("AMENT_PREFIX_PATH", "").split(os.pathsep):
        if prefix:
            yield Path(prefix) / "share"


def _mapping(value: Any, what: str) -> Mapping[str, Any]:
    if not isinstance(value, Mapping):
        raise RobotFileError(f"{what} must be a mapping, got {type(value).__name__}")
    return value


def _items(content: Mapping[str, Any], key: str) -> Iterator[tuple[str, Any]]:
    return ((_text(name, f"a name in {key}"), value) for name, value in _mapping(content[key], key).items())


def _text(value: Any, what: str) -> str:
    if not isinstance(value, str):
        raise RobotFileError(f"{what} must be a text, got {shown(value)}; quote it if it looks like something else")
    return value


def _number(value: Any, what: str) -> float:
    # bool is an int to Python, but `yes` is no number to the author of a file
    if isinstance(value, bool) or not isinstance(value, int | float) or not abs(value) <= sys.float_info.max:
        raise RobotFileError(f"{what} must be a finite number, got {shown(value)}")
    return float(value)


def _positions(content: Mapping[str, Any], key: str) -> dict[str, float]:
    return {name: _number(value, f"{key} of {one_line(name, 60)}") for name, value in _items(content, key)}


def _gravity(value: Any) -> tuple[float, float, float] | None:
    if value is None:
        return None
    if not isinstance(value, list) or len(value) != 3:
        raise RobotFileError(f"gravity must be three numbers, m/s^2 in the axes of the base frame, got {shown(value)}")
    x, y, z = (_number(number, "gravity") for number in value)
    return x, y, z


def _names(value: Any, group: str) -> tuple[str, ...]:
    if not isinstance(value, list) or not all(isinstance(name, str) for name in value) or not value:
        raise RobotFileError(
            f"joint group {shown(group)} must be a list of joint names, got {shown(value)}; quote names that "
            "look like something else, such as '1' or 'on'"
        )
    if len(set(value)) != len(value):
        raise RobotFileError(f"joint group {shown(group)} names a joint twice: {shown(value)}")
    return tuple(value)


def _endpoint(value: Any, name: str, groups: Mapping[str, tuple[str, ...]]) -> Endpoint:
    entry = _mapping(value, f"end point {shown(name)}")
    if set(entry) != {"frame", "joints"}:
        raise RobotFileError(f"end point {shown(name)} needs the keys 'frame' and 'joints', got {shown(list(entry))}")
    frame, joints = (_text(entry[key], f"{key} of end point {shown(name)}") for key in ("frame", "joints"))
    if joints not in groups:
        raise RobotFileError(
            f"end point {shown(name)} names the unknown joint group {shown(joints)}; there are {listed(groups)}"
        )
    return Endpoint(frame, joints)


def _per_joint(
    content: Mapping[str, Any], key: str, groups: Mapping[str, tuple[str, ...]], allowed: tuple[str, ...]
) -> dict[str, dict[str, float]]:
    """Entries by joint or by group, copied to each joint."""
    spread: dict[str, dict[str, float]] = {}
    entries = [
        (name, _mapping(value, f"{key} of {one_line(name, 60)}")) for name, value in _items({key: {}, **content}, key)
    ]
    # groups first, so that a joint's own entry replaces what its group says
    for name, entry in sorted(entries, key=lambda item: item[0] not in groups):
        unknown = [word for word in entry if word not in allowed]
        if unknown:
            raise RobotFileError(
                f"{key} of {one_line(name, 60)} has the unknown keys {listed(unknown)}; allowed are {listed(allowed)}"
            )
        values = {word: _number(value, f"{key} of {one_line(name, 60)}, {word},") for word, value in entry.items()}
        for joint in groups.get(name, (name,)):
            spread.setdefault(joint, {}).update(values)
    return spread
