# SPDX-License-Identifier: Apache-2.0
"""`read_urdf`: a Pinocchio model of a URDF in which every joint has one position and one velocity.

Pinocchio keeps cosine and sine of a joint of type `continuous`; here it is a revolute joint without limits, as its
`JointState` is one angle. What a joint's `<limit>` leaves out is taken as zero, so that the robot file can give it.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from xml.etree import ElementTree

import pinocchio as pin

from tpgmm_core.robot.description import RobotFileError, check_urdf

#: Joints of one degree of freedom, whose `<limit>` Pinocchio wants complete.
SINGLE = ("revolute", "prismatic", "continuous")


@dataclass(frozen=True, slots=True)
class Urdf:
    """What a URDF says.

    model : of nq = nv
    endless : joints of type `continuous`; they may turn for ever
    mimics : joint -> the one that it follows by a mechanism; to the model it is a joint as any other
    """

    model: pin.Model
    endless: frozenset[str]
    mimics: Mapping[str, str]


def read_urdf(path: Path, locked: Mapping[str, float]) -> Urdf:
    """Read a URDF with a fixed base, and lock joints at positions (rad, m): they become part of their links.

    Raises RobotFileError: a file that cannot be read or is no URDF (see `check_urdf`), an unknown joint to be locked,
    joints of more degrees of freedom.
    """
    try:
        check_urdf(path)
        root = ElementTree.fromstring(path.read_bytes())
    except (OSError, ElementTree.ParseError) as error:
        raise RobotFileError(f"cannot load the URDF {path}: {error}") from error
    if any("xacro" in element.tag for element in root.iter() if isinstance(element.tag, str)):
        raise RobotFileError(f"{path} is a xacro, not a URDF; expand it first: xacro {path.name} > robot.urdf")
    endless, mimics = set(), {}
    for joint in root.findall("joint"):
        name = joint.get("name", "")
        if joint.get("type") not in SINGLE:
            continue
        if joint.get("type") == "continuous":
            endless.add(name)
            joint.set("type", "revolute")
        _complete_limit(joint)
        leader = joint.find("mimic")
        if leader is not None:
            mimics[name] = leader.get("joint", "")
    try:
        model = pin.buildModelFromXML(ElementTree.tostring(root, encoding="unicode"))
    except (ValueError, RuntimeError) as error:  # RuntimeError: what C++ throws
        raise RobotFileError(f"cannot load the URDF {path}: {error}") from error
    model = _locked(model, locked, path)
    for i in range(1, model.njoints):
        if (model.joints[i].nq, model.joints[i].nv) != (1, 1):
            raise RobotFileError(
                f"joint {model.names[i]!r} of {path.name} is {model.joints[i].shortname()}; only joints of one degree "
                "of freedom are supported (revolute, continuous, prismatic), on a base that is fixed to the world"
            )
    return Urdf(
        model,
        frozenset(endless - set(locked)),
        {name: leader for name, leader in mimics.items() if name not in locked},
    )


def _complete_limit(joint: ElementTree.Element) -> None:
    limit = joint.find("limit")
    if limit is None:
        limit = ElementTree.SubElement(joint, "limit")
    for word in ("lower", "upper", "effort", "velocity"):
        if not (limit.get(word) or "").strip():
            limit.set(word, "0")


def _locked(model: pin.Model, locked: Mapping[str, float], path: Path) -> pin.Model:
    unknown = [name for name in locked if not model.existJointName(name)]
    if unknown:
        raise RobotFileError(
            f"locked names the unknown joints {unknown}; the URDF {path.name} has {list(model.names[1:])}"
        )
    if not locked:
        return model
    q, ids = pin.neutral(model), [model.getJointId(name) for name in locked]
    for joint, position in zip(ids, locked.values(), strict=True):
        if model.joints[joint].nq != 1:
            raise RobotFileError(f"joint {model.names[joint]!r} of {path.name} cannot be locked by one number")
        q[model.joints[joint].idx_q] = position
    return pin.buildReducedModel(model, ids, q)
