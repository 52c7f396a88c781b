# SPDX-License-Identifier: Apache-2.0
"""`read_urdf`: a Pinocchio model of a URDF in which every joint has one position and one velocity.

Pinocchio keeps cosine and sine of a joint of type `continuous`; here it is a revolute joint without limits, as its
`JointState` is one angle. What a joint's `<limit>` leaves out is read as zero, so that the robot file can give it.
Joints that mimic others have no motor, and many drivers do not publish them: where `home` does not name them, they are
part of their links, at the position that the mechanism gives them. Named there, they are joints of their own.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from xml.etree import ElementTree

import pinocchio as pin

from tpgmm_core.common.text import listed, one_line, shown
from tpgmm_core.robot.description import RobotFileError
from tpgmm_core.robot.urdf_tree import SINGLE, UrdfTree, read_tree


@dataclass(frozen=True, slots=True)
class Urdf:
    """What a URDF says.

    Parameters
    ----------
    model
        of nq = nv
    endless
        joints of type `continuous`; they may turn for ever
    tree
        its links and joints, those that are not in the model too
    """

    model: pin.Model
    endless: frozenset[str]
    tree: UrdfTree


def read_urdf(path: Path, locked: Mapping[str, float], home: Mapping[str, float]) -> Urdf:
    """Read a URDF, and lock joints at positions: they become part of their links.

    Joints that mimic others, and are not in `home`, are locked too, where their leader puts them.

    Parameters
    ----------
    path
        the file
    locked
        joint -> position, rad or m
    home
        joint -> position, rad or m, of all joints that are not locked

    Returns
    -------
    Urdf
        the model of the joints that are not locked

    Raises
    ------
    RobotFileError
        for a file that cannot be read or is no URDF (see `read_tree`), an unknown joint to be locked, and joints of
        more degrees of freedom
    """
    tree = read_tree(path)
    if unknown := [name for name in locked if tree.joints.get(name) is None or _type(tree, name) == "fixed"]:
        moving = [name for name in tree.joints if _type(tree, name) != "fixed"]
        raise RobotFileError(
            f"locked names the unknown joints {listed(unknown)}; the URDF {path.name} has {listed(moving, 40)}"
        )
    endless = set()
    for name, joint in tree.joints.items():
        kind = joint.get("type") or ""
        if kind == "fixed":
            continue
        if kind not in SINGLE:
            _refuse(name, kind, path, name in locked)
        axis = joint.find("axis")
        if axis is not None and not any(map(float, (axis.get("xyz") or "1 0 0").split())):
            raise RobotFileError(f"joint {shown(name)} of {path.name} has an axis of length 0")
        if kind == "continuous":
            endless.add(name)
            joint.set("type", "revolute")
        _complete_limit(joint)
    try:
        model = pin.buildModelFromXML(ElementTree.tostring(tree.root, encoding="unicode"))
    except (ValueError, RuntimeError) as error:  # RuntimeError: what C++ throws
        raise RobotFileError(f"cannot load the URDF {path}: {one_line(error, 300)}") from error
    known = {**home, **locked}
    places = {**{name: _place(name, tree, known) for name in tree.mimics if name not in known}, **locked}
    return Urdf(_locked(model, places), frozenset(endless - set(places)), tree)


def _type(tree: UrdfTree, joint: str) -> str:
    return tree.joints[joint].get("type") or ""


def _refuse(name: str, kind: str, path: Path, is_locked: bool) -> None:
    if kind not in ("floating", "planar", "spherical"):
        what = f"is of type {shown(kind)}, which is not a type of URDF joints" if kind else "has no type"
        raise RobotFileError(f"joint {shown(name)} of {path.name} {what}; expected {listed(SINGLE)} or fixed")
    if is_locked:
        raise RobotFileError(
            f"joint {shown(name)} of {path.name} is {kind} and has more than one degree of freedom, so that it "
            "cannot be locked; make it fixed "
            "in the URDF"
        )
    raise RobotFileError(
        f"joint {shown(name)} of {path.name} is {kind}; only joints of one degree of freedom are supported "
        f"({listed(SINGLE)}), on a base that is fixed to the world: where it does not move, make it fixed in the URDF"
    )


def _place(name: str, tree: UrdfTree, places: Mapping[str, float]) -> float:
    """Position of a joint, rad or m; 0 where none is given (fixed joints; one that home lacks is refused elsewhere)."""
    if name in places or name not in tree.mimics:
        return places.get(name, 0.0)
    mimic = tree.mimics[name]
    return mimic.multiplier * _place(mimic.leader, tree, places) + mimic.offset


def _complete_limit(joint: ElementTree.Element) -> None:
    limit = joint.find("limit")
    if limit is None:
        limit = ElementTree.SubElement(joint, "limit")
    for word in ("lower", "upper", "effort", "velocity"):
        if not (limit.get(word) or "").strip():
            limit.set(word, "0")


def _locked(model: pin.Model, places: Mapping[str, float]) -> pin.Model:
    if not places:
        return model
    q, ids = pin.neutral(model), [model.getJointId(name) for name in places]
    for joint, position in zip(ids, places.values(), strict=True):
        q[model.joints[joint].idx_q] = position
    return pin.buildReducedModel(model, ids, q)
