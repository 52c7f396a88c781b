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

from tpgmm_core.common.safe_yaml import YamlError
from tpgmm_core.common.text import listed, one_line, shown
from tpgmm_core.common.yaml_sections import Section
from tpgmm_core.common.yaml_values import a_number, a_text, numbers, some_names

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
    gravity: tuple[float, ...] | None = None

    @classmethod
    def from_file(cls, path: str | os.PathLike[str]) -> RobotDescription:
        """Read a robot file.

        Parameters
        ----------
        path
            the file

        Returns
        -------
        RobotDescription
            what the file says, checked

        Raises
        ------
        RobotFileError
            with the file, the key and what was expected
        """
        path = Path(path)
        try:
            return cls._of(path, Section.load(path, "a robot file"))
        except YamlError as error:
            raise RobotFileError(str(error)) from None

    @classmethod
    def _of(cls, path: Path, top: Section) -> RobotDescription:
        if task := {"movement", "movements"} & top.values.keys():
            raise top.error(f"is a task file, as it has {task.pop()!r}; expected a robot file: a URDF, end points")
        top.refuse_others(*REQUIRED_KEYS, *OPTIONAL_KEYS)
        groups = top.mapping("joint_groups", some_names)
        try:
            urdf = resolve_urdf(top.required("urdf", a_text), path.parent)
        except RobotFileError as error:
            raise RobotFileError(f"{one_line(path)}: {error}") from error
        return cls(
            path=path,
            urdf=urdf,
            base_frame=top.required("base_frame", a_text),
            joint_groups=groups,
            endpoints={name: _endpoint(section, groups) for name, section in top.sections("endpoints")},
            limits=_per_joint(top, "limits", groups, LIMIT_KEYS),
            friction=_per_joint(top, "friction", groups, FRICTION_KEYS),
            armature=_per_joint(top, "armature", groups, ARMATURE_KEYS),
            home=top.mapping("home", a_number()),
            locked=top.mapping("locked", a_number(), optional=True),
            gravity=top.required("gravity", _gravity) if "gravity" in top.values else None,
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

    Returns
    -------
    Path
        the file, which exists

    Raises
    ------
    RobotFileError
        where there is none, and for a path that leads out of the package or the folder
    """
    is_package = reference.startswith(PACKAGE_SCHEME)
    relative = Path(os.path.expanduser(reference.removeprefix(PACKAGE_SCHEME)))
    if relative.is_absolute() or ".." in relative.parts or "\0" in reference:
        raise RobotFileError(
            f"urdf {shown(reference)} is outside the robot file's folder; expected a file in this folder or below it, "
            f"or {PACKAGE_SCHEME}NAME/path"
        )
    candidates = [share / relative for share in _share_folders()] if is_package else [folder / relative]
    for candidate in candidates:
        if os.path.isfile(candidate):  # unlike Path.is_file, also says no to names that no file can have
            found = candidate.resolve()
            if not is_package and not found.is_relative_to(folder.resolve()):
                raise RobotFileError(f"urdf {shown(reference)} is a link to {found}, outside the robot file's folder")
            return found
    if is_package:
        package, _, file = str(relative).partition("/")
        found_packages = [str(share / package) for share in _share_folders() if os.path.isdir(share / package)]
        if found_packages:
            raise RobotFileError(f"there is no URDF {shown(file)} in the package {listed(found_packages, 3)}")
        raise RobotFileError(
            f"the package {shown(package)} of the URDF {shown(reference)} is not installed; source its ROS workspace, "
            "install it (pip install example-robot-data), or copy the URDF next to the robot file and name it there"
        )
    hint = "; expand a xacro first: xacro FILE.xacro > robot.urdf" if "xacro" in reference else ""
    raise RobotFileError(
        f"there is no URDF {shown(reference)} in {folder.resolve()}; expected a file in this folder or below it{hint}"
    )


def read_xml(path: Path) -> bytes:
    """Read the XML of a URDF, without a byte order mark and blank lines before it.

    Meshes are never opened.

    Parameters
    ----------
    path
        the file

    Returns
    -------
    bytes
        the document

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


def _gravity(value: Any) -> tuple[float, ...]:
    try:
        return numbers(3)(value)
    except ValueError:
        raise ValueError("three numbers, m/s^2 in the axes of the base frame") from None


def _endpoint(section: Section, groups: Mapping[str, tuple[str, ...]]) -> Endpoint:
    section.refuse_others("frame", "joints")
    joints = section.required("joints", a_text)
    if joints not in groups:
        raise section.error(f"names the unknown joint group {shown(joints)}; there are {listed(groups)}")
    return Endpoint(section.required("frame", a_text), joints)


def _per_joint(
    top: Section, key: str, groups: Mapping[str, tuple[str, ...]], allowed: tuple[str, ...]
) -> dict[str, dict[str, float]]:
    """Entries by joint or by group, copied to each joint."""
    spread: dict[str, dict[str, float]] = {}
    # groups first, so that a joint's own entry replaces what its group says
    for name, entry in sorted(top.sections(key, optional=True), key=lambda item: item[0] not in groups):
        entry.refuse_others(*allowed)
        for joint in groups.get(name, (name,)):
            spread.setdefault(joint, {}).update({word: entry.required(word, a_number()) for word in entry.values})
    return spread
