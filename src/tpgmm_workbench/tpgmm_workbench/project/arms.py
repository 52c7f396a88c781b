# SPDX-License-Identifier: Apache-2.0
"""The arms of a URDF: chains of joints that end in a hand, by the tree and by the names that people give."""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass
from xml.etree.ElementTree import Element

from tpgmm_core.robot.urdf_tree import SINGLE, UrdfTree

FEWEST = 3
"""Joints that an arm has at least: fewer are fingers, or a head."""
_GRIPPER = re.compile(r"grip|finger|jaw|claw|knuckle|thumb|pad|index|little|pinky|_flex|_abd", re.IGNORECASE)
_HANDS = ("tcp", "tool0", "grasp", "gripper", "tool", "ee", "end_effector", "flange", "hand")
"""What frames of hands are called, the most exact first."""
_BASE = re.compile(r"base|link_?0$", re.IGNORECASE)


@dataclass(frozen=True, slots=True)
class Arm:
    """A chain of joints that moves a frame; the name is for a robot file."""

    name: str
    joints: tuple[str, ...]
    frame: str


def is_moving(joint: Element) -> bool:
    """Whether a joint of a URDF has one degree of freedom."""
    return (joint.get("type") or "") in SINGLE


def arms_of(tree: UrdfTree) -> tuple[Arm, ...]:
    """Arms, in the order of the URDF: none for a robot without chains of FEWEST joints."""
    root = next(link.get("name") or "" for link in tree.root.findall("link") if link.get("name") not in tree.parents)
    chains = [chain for chain in _chains(tree, root, ()) if len(chain[0]) >= FEWEST]
    names: list[str] = []
    for joints, _ in chains:
        names.append(_name(joints, names, len(chains)))
    return tuple(Arm(name, joints, _hand(tree, link)) for name, (joints, link) in zip(names, chains, strict=True))


def base_of(tree: UrdfTree) -> str:
    """The link in whose axes poses are expressed: what does not move, and is called a base; else the root."""
    root = next(link.get("name") or "" for link in tree.root.findall("link") if link.get("name") not in tree.parents)
    still = list(_fixed_to(tree, root))
    return next((link for link in still if _BASE.search(link)), root)


def _children(tree: UrdfTree, link: str) -> Iterator[tuple[str, str]]:
    """Joints that stand on a link, and what they carry, in the order of the URDF."""
    return ((joint, child) for child, (joint, parent) in tree.parents.items() if parent == link)


def _fixed_to(tree: UrdfTree, link: str) -> Iterator[str]:
    """A link and all that is fixed to it, from there outwards."""
    yield link
    for joint, child in _children(tree, link):
        if not is_moving(tree.joints[joint]):
            yield from _fixed_to(tree, child)


def _longest(tree: UrdfTree, link: str) -> int:
    """Joints in the longest chain behind a link; those that mimic others, or are of grippers, do not count."""
    return max(
        (_counts(tree, joint) + _longest(tree, child) for joint, child in _children(tree, link)),
        default=0,
    )


def _counts(tree: UrdfTree, joint: str) -> bool:
    return is_moving(tree.joints[joint]) and joint not in tree.mimics and not _GRIPPER.search(joint)


def _chains(tree: UrdfTree, link: str, joints: tuple[str, ...]) -> Iterator[tuple[tuple[str, ...], str]]:
    """Chains from a link on: their joints, and the link that the last one moves; where arms part, they begin anew."""
    end, here = link, joints
    while True:
        ahead = [(joint, child) for joint, child in _reachable(tree, end)]
        long = [(joint, child) for joint, child in ahead if 1 + _longest(tree, child) >= FEWEST]
        if len(long) > 1:
            for joint, child in long:
                yield from _chains(tree, child, (joint,))
            return
        if len(ahead) > 1 and not long:
            yield here, end  # fingers
            return
        if not ahead:
            yield here, end
            return
        joint, end = (long or ahead)[0]
        here = (*here, joint)


def _reachable(tree: UrdfTree, link: str) -> Iterator[tuple[str, str]]:
    """The next joints of arms behind a link and what is fixed to it, and what they move."""
    for joint, child in _children(tree, link):
        if _counts(tree, joint):
            yield joint, child
        elif not is_moving(tree.joints[joint]):
            yield from _reachable(tree, child)


def _hand(tree: UrdfTree, link: str) -> str:
    """The frame of a hand among what is fixed to the last link: by its name, else the farthest out."""
    fixed = list(_fixed_to(tree, link))
    for word in _HANDS:
        named = [n for n in fixed if word in re.split(r"[_\W]+", n.lower()) or (len(word) > 3 and word in n.lower())]
        if named:  # gripper rather than gripper_base_link
            return min(named, key=lambda n: ("base" in n.lower(), len(n)))
    return link


def _name(joints: tuple[str, ...], taken: list[str], count: int) -> str:
    """left, right, or arm; numbered where that is taken."""
    sides = [side for side in ("left", "right") if all(side in joint.lower() for joint in joints)]
    name = sides[0] if sides else "arm"
    if name in taken or (not sides and count > 1):
        name = f"{name}_{sum(other.startswith(name) for other in taken) + 1}"
    return name
