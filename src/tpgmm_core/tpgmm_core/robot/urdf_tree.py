# SPDX-License-Identifier: Apache-2.0
"""`UrdfTree`: a URDF's XML, read and checked for what its parser would answer with a crash, a guess, or other words.

Editors and exporters add much before the XML and to its encoding that changes nothing: a byte order mark, blank
lines, a default namespace. What cannot be right (a joint of a link that does not exist, a number that is none, a
negative mass) is refused by its name.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from xml.etree import ElementTree
from xml.etree.ElementTree import Element

from tpgmm_core.common.text import listed, one_line, shown
from tpgmm_core.robot.description import RobotFileError, read_xml

MAX_NAME = 200  # characters
#: Joints of one degree of freedom.
SINGLE = ("revolute", "prismatic", "continuous")
#: Numbers of a URDF by element and attribute, and how many there are; all may be left out but those of `<inertial>`.
_NUMBERS = {
    "origin": {"xyz": 3, "rpy": 3},
    "axis": {"xyz": 3},
    "limit": {"lower": 1, "upper": 1, "effort": 1, "velocity": 1},
    "dynamics": {"damping": 1, "friction": 1},
    "mimic": {"multiplier": 1, "offset": 1},
    "mass": {"value": 1},
    "inertia": {"ixx": 1, "ixy": 1, "ixz": 1, "iyy": 1, "iyz": 1, "izz": 1},
}


@dataclass(frozen=True, slots=True)
class Mimic:
    """A joint without a motor: a mechanism puts it at `multiplier` times the position of another, plus `offset`."""

    leader: str
    multiplier: float
    offset: float


@dataclass(frozen=True, slots=True)
class UrdfTree:
    """A URDF as XML, without namespaces.

    Parameters
    ----------
    root
        the element `<robot>`
    joints
        name -> `<joint>`
    parents
        link -> the joint that moves it, and the link that this one stands on; not of the root
    mimics
        joint -> what it mimics
    """

    root: Element
    joints: Mapping[str, Element]
    parents: Mapping[str, tuple[str, str]]
    mimics: Mapping[str, Mimic]

    def joints_above(self, frame: str) -> Iterator[str]:
        """The joints that move a link, or a joint, from there to the root."""
        if frame not in self.parents and frame in self.joints:
            frame = _link_of(self.joints[frame], "child")
        while frame in self.parents:
            joint, frame = self.parents[frame]
            yield joint


def read_tree(path: Path) -> UrdfTree:
    """Read a URDF.

    Parameters
    ----------
    path
        the file

    Returns
    -------
    UrdfTree
        links and joints

    Raises
    ------
    RobotFileError
        for a file that cannot be read or should not be (`read_xml`), another kind of XML, numbers that are none,
        negative masses, joints and links that are no tree, and mimic joints of joints that do not exist
    """
    try:
        root = ElementTree.fromstring(read_xml(path))
    except OSError as error:
        raise RobotFileError(f"cannot load the URDF {path}: {error.strerror or error}") from None
    except (ElementTree.ParseError, LookupError, ValueError) as error:  # LookupError: an unknown encoding
        if isinstance(error, RobotFileError):
            raise
        raise RobotFileError(f"cannot load the URDF {path}: {one_line(error, 200)}") from None
    for element in root.iter():
        if isinstance(element.tag, str):
            element.tag = element.tag.rpartition("}")[2]
    try:
        return _checked(root)
    except RobotFileError as error:
        raise RobotFileError(f"cannot load the URDF {path}: {error}") from None


def _checked(root: Element) -> UrdfTree:
    if root.tag != "robot":
        raise RobotFileError(f"it is another kind of XML, whose root is <{one_line(root.tag, 60)}>; expected <robot>")
    links, joints = _named(root, "link"), _named(root, "joint")
    if not links:
        raise RobotFileError("it has no links")
    for kind, elements in (("link", links), ("joint", joints)):
        for name, element in elements.items():
            _check_numbers(element, f"{kind} {shown(name)}")
    for name, joint in joints.items():
        _check_limit(joint, f"joint {shown(name)}")
    for name, link in links.items():
        _check_inertial(link, f"link {shown(name)}")
    parents = _parents(links, joints)
    return UrdfTree(root, joints, parents, _mimics(joints))


def _named(root: Element, kind: str) -> dict[str, Element]:
    elements = root.findall(kind)
    names = [element.get("name") or "" for element in elements]
    if "" in names:
        raise RobotFileError(f"a {kind} has no name")
    if any(len(name) > MAX_NAME for name in names):
        raise RobotFileError(f"a {kind} has a name of more than {MAX_NAME} characters")
    if twice := [name for name, count in Counter(names).items() if count > 1]:
        raise RobotFileError(f"several {kind}s have the name {listed(twice)}")
    return dict(zip(names, elements, strict=True))


def _check_numbers(element: Element, where: str) -> None:
    for child in element.iter():
        for attribute, count in _NUMBERS.get(str(child.tag), {}).items():
            text = child.get(attribute)
            if text is None or not text.strip():
                continue
            try:
                values = [float(word) for word in text.split()]
            except ValueError:
                values = []
            if len(values) != count or not all(map(math.isfinite, values)):
                expected = "a finite number" if count == 1 else f"{count} finite numbers"
                raise RobotFileError(f"{where}: {attribute} of <{child.tag}> is {shown(text)}, expected {expected}")


def _check_limit(joint: Element, where: str) -> None:
    for limit in joint.findall("limit"):
        for attribute in ("effort", "velocity"):
            if float((limit.get(attribute) or "").strip() or 0.0) < 0.0:
                raise RobotFileError(
                    f"{where}: {attribute} of <limit> is {shown(limit.get(attribute))}, which cannot be negative"
                )


def _check_inertial(link: Element, where: str) -> None:
    inertial = link.find("inertial")
    if inertial is None:
        return
    for tag, attributes in (("mass", ("value",)), ("inertia", ("ixx", "iyy", "izz"))):
        element = inertial.find(tag)
        missing = [word for word in attributes if element is None or not (element.get(word) or "").strip()]
        if missing:
            raise RobotFileError(f"{where}: its <inertial> lacks {listed(missing)} of <{tag}>")
    mass = float(inertial.find("mass").get("value"))  # type: ignore[union-attr, arg-type]
    if mass < 0.0:
        raise RobotFileError(f"{where} has the mass {mass:g} kg, which cannot be negative")


def _link_of(joint: Element, role: str) -> str:
    element = joint.find(role)
    return "" if element is None else element.get("link") or ""


def _parents(links: Mapping[str, Element], joints: Mapping[str, Element]) -> dict[str, tuple[str, str]]:
    parents: dict[str, tuple[str, str]] = {}
    for name, joint in joints.items():
        parent, child = _link_of(joint, "parent"), _link_of(joint, "child")
        for role, link in (("parent", parent), ("child", child)):
            if link not in links:
                raise RobotFileError(
                    f"joint {shown(name)} has the {role} link {shown(link)}, which does not exist; there are "
                    f"{listed(links)}"
                )
        if child in parents:
            raise RobotFileError(
                f"link {shown(child)} is moved by two joints, {shown(parents[child][0])} and {shown(name)}; closed "
                "loops are not supported"
            )
        parents[child] = name, parent
    roots = [link for link in links if link not in parents]
    if len(roots) != 1:
        what = (
            f"{len(roots)} parts that no joint connects: {listed(roots)}"
            if roots
            else "no root: its joints form a loop"
        )
        raise RobotFileError(f"it has {what}; expected one tree")
    for link in links:
        above = link
        seen: set[str] = set()
        while above in parents:
            if above in seen:
                raise RobotFileError(f"its joints form a loop: {listed(sorted(seen))}; expected one tree")
            seen.add(above)
            above = parents[above][1]
    return parents


def _mimics(joints: Mapping[str, Element]) -> dict[str, Mimic]:
    mimics = {}
    for name, joint in joints.items():
        element = joint.find("mimic")
        if element is None or joint.get("type") not in SINGLE:
            continue
        leader = element.get("joint") or ""
        if leader not in joints:
            raise RobotFileError(f"joint {shown(name)} mimics {shown(leader)}, which does not exist")
        multiplier, offset = ((element.get(word) or "").strip() for word in ("multiplier", "offset"))
        mimics[name] = Mimic(leader, float(multiplier or 1.0), float(offset or 0.0))
    for name in mimics:
        chain = [name]
        while chain[-1] in mimics:
            leader = mimics[chain[-1]].leader
            if leader in chain:
                raise RobotFileError(f"joint {shown(name)} mimics itself, through {listed(chain)}")
            chain.append(leader)
    return mimics
