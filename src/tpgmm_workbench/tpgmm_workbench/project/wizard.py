# SPDX-License-Identifier: Apache-2.0
"""Proposes a robot file for a URDF that has none: groups, end points, limits, home, and what is suspicious."""

from __future__ import annotations

import sys
import tempfile
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from tpgmm_core.common.text import listed, one_line
from tpgmm_core.common.types import Array
from tpgmm_core.control.robot_check import suspicions
from tpgmm_core.geometry import quaternion
from tpgmm_core.robot.description import PACKAGE_SCHEME, RobotFileError, resolve_urdf
from tpgmm_core.robot.joint_values import CREDIBLE_EFFORT, CREDIBLE_VELOCITY
from tpgmm_core.robot.model import RobotModel
from tpgmm_core.robot.urdf_tree import UrdfTree, read_tree
from tpgmm_workbench.project.arms import Arm, arms_of, base_of, is_moving

POSTURES = 300
VELOCITY, EFFORT, RANGE = 1.5, 10.0, 3.1
"""Guesses where a URDF does not say: rad/s, N m, rad."""
MIDDLE = 0.8
"""Home is looked for in this share of the middle of each joint's range."""
WIDEST = 2.5
"""And not beyond this, rad: joints that turn further come back to the same place."""
HEADER = "# Proposed from the URDF alone: look at each line, above all at those that say 'guessed'."


@dataclass(frozen=True, slots=True)
class Proposal:
    """A robot file.

    Parameters
    ----------
    text
        of the YAML; each line that was guessed says so
    endpoints
        names of the end points
    words
        what was chosen and why
    suspicions
        what is to be checked, as `check_robot` says it
    problem
        why the file cannot be used yet; else empty
    """

    text: str
    endpoints: tuple[str, ...]
    words: tuple[str, ...]
    suspicions: tuple[str, ...] = ()
    problem: str = ""


def known_urdfs() -> tuple[str, ...]:
    """References (package://...) of the URDFs of example-robot-data that are installed, in order of name."""
    found = set()
    for entry in sys.path:
        share = Path(entry) / "cmeel.prefix" / "share"
        for path in (share / "example-robot-data").rglob("*.urdf"):
            found.add(PACKAGE_SCHEME + path.relative_to(share).as_posix())
    return tuple(sorted(found))


def propose_robot_file(urdf: str, folder: str | Path = ".") -> Proposal:
    """Propose a robot file.

    Parameters
    ----------
    urdf
        reference, package://NAME/path, or a path in the folder of the robot file, as that has it
    folder
        where the robot file will be

    Returns
    -------
    Proposal
        to be looked at, and written into a file

    Raises
    ------
    RobotFileError
        for a URDF that cannot be read, and a robot without arms (nothing that a chain of joints moves)
    """
    path = resolve_urdf(urdf, Path(folder))
    tree = read_tree(path)
    arms = arms_of(tree)
    if not arms:
        raise RobotFileError(f"{one_line(urdf)} has no arm: three joints in a chain at least are expected")
    taken = {joint for arm in arms for joint in arm.joints}
    locked = [name for name, joint in tree.joints.items() if is_moving(joint) and name not in taken | set(tree.mimics)]
    limits = _guessed_limits(tree, sorted(taken))
    words = [f"arm {arm.name}: {len(arm.joints)} joints, and its hand is {arm.frame}" for arm in arms]
    if locked:
        words.append(f"{listed(locked, 20)}: no part of an arm, so they are locked where they are")
    if limits:
        words.append(f"limits of {listed(limits, 20)} are guessed, since the URDF gives no plausible ones")
    home = {joint: _within(tree, joint, 0.0) for arm in arms for joint in arm.joints}
    places = {joint: _within(tree, joint, 0.0) for joint in locked}
    text = _text(urdf, tree, arms, limits, places, home)
    with tempfile.TemporaryDirectory() as made:
        try:
            robot = _read(text, path, urdf, Path(made))
            home = _home(robot, arms)
            text = _text(urdf, tree, arms, limits, places, home)
            robot = _read(text, path, urdf, Path(made))
        except ValueError as error:  # RobotFileError, and what Pinocchio says of doubled names
            reason = one_line(error).replace(f"{made}/", "")
            return Proposal(text, tuple(arm.name for arm in arms), tuple(words), problem=reason)
    words.append(
        f"home is the best of {POSTURES} postures: bent, away from limits, the hand down and in front: guessed"
    )
    return Proposal(text, tuple(arm.name for arm in arms), tuple(words), tuple(suspicions(robot)))


def _read(text: str, urdf: Path, reference: str, folder: Path) -> RobotModel:
    """The robot of a text, whose URDF may lie beside it."""
    if not reference.startswith(PACKAGE_SCHEME):
        (folder / reference).parent.mkdir(parents=True, exist_ok=True)
        (folder / reference).write_bytes(urdf.read_bytes())
    (folder / "robot.yaml").write_text(text)
    return RobotModel.from_file(folder / "robot.yaml")


def _limit(tree: UrdfTree, joint: str, word: str) -> float:
    element = tree.joints[joint].find("limit")
    text = "" if element is None else (element.get(word) or "").strip()
    return float(text) if text else 0.0


def _within(tree: UrdfTree, joint: str, position: float) -> float:
    """A position within the limits of the URDF; their middle where it is outside."""
    lower, upper = _limit(tree, joint, "lower"), _limit(tree, joint, "upper")
    if tree.joints[joint].get("type") == "continuous" or lower >= upper or lower < position < upper:
        return position
    return 0.5 * (lower + upper)


def _guessed_limits(tree: UrdfTree, joints: Sequence[str]) -> dict[str, dict[str, float]]:
    """Limits that the URDF lacks, or that nobody can believe: joint -> word -> value."""
    found: dict[str, dict[str, float]] = {}
    for joint in joints:
        guesses = {}
        if not 0.0 < _limit(tree, joint, "velocity") <= CREDIBLE_VELOCITY:
            guesses["velocity"] = VELOCITY
        if not 0.0 < _limit(tree, joint, "effort") <= CREDIBLE_EFFORT:
            guesses["effort"] = EFFORT
        kind = tree.joints[joint].get("type")
        if kind != "continuous" and _limit(tree, joint, "lower") >= _limit(tree, joint, "upper"):
            reach = RANGE if kind == "revolute" else 0.1
            guesses |= {"lower": -reach, "upper": reach}
        if guesses:
            found[joint] = guesses
    return found


def _home(robot: RobotModel, arms: Sequence[Arm]) -> dict[str, float]:
    """A posture of each arm in which the hand can move in all directions, and the arm carries itself easily."""
    rng, data, q = np.random.default_rng(0), robot.create_data(), robot.home.copy()
    for arm in arms:
        joints = robot.indices(arm.joints)
        middle, half = _middle(robot.lower_limits[joints], robot.upper_limits[joints])
        best, chosen = -np.inf, q[joints].copy()
        for _ in range(POSTURES):
            q[joints] = middle + half * rng.uniform(-1.0, 1.0, len(joints))
            data.update(q)
            J = data.jacobian(arm.name)[:, joints] * np.repeat([1.0, 0.3], 3)[:, None]
            values = np.linalg.svd(J, compute_uv=False)
            pose, carried = data.pose(arm.name), np.abs(data.gravity(q) / robot.effort_limits).max()
            down = -float(quaternion.rotation_matrix(pose[3:])[2, 2])
            reach = float(np.linalg.norm(pose[:2]))
            score = 10.0 * min(values[min(5, len(joints) - 1)], 0.1) + 0.5 * down - max(carried - 0.5, 0.0)
            score += 0.5 * float(pose[0] / max(reach, 1e-6)) + (0.0 if pose[2] > 0.05 else -0.5)
            if score > best:
                best, chosen = score, np.round(q[joints], 2)
        q[joints] = chosen
    return {name: float(q[i]) + 0.0 for i, name in enumerate(robot.joint_names)}


def _middle(lower: Array, upper: Array) -> tuple[Array, Array]:
    """Middles of ranges, and how far from there home may be."""
    lower, upper = np.maximum(lower, -WIDEST), np.minimum(upper, WIDEST)
    wrong = lower >= upper  # a range that lies beyond
    lower, upper = np.where(wrong, np.minimum(lower, upper), lower), np.where(wrong, np.maximum(lower, upper), upper)
    return 0.5 * (lower + upper), 0.5 * MIDDLE * (upper - lower)


def _text(
    urdf: str,
    tree: UrdfTree,
    arms: Sequence[Arm],
    limits: Mapping[str, Mapping[str, float]],
    locked: Mapping[str, float],
    home: Mapping[str, float],
) -> str:
    lines = [HEADER, f"urdf: {_quoted(urdf)}", f"base_frame: {_quoted(base_of(tree))}", "joint_groups:"]
    lines += [f"  {arm.name}_joints: [{', '.join(map(_quoted, arm.joints))}]" for arm in arms]
    lines += ["# The frame that follows the movement: check that it is where the hand grasps", "endpoints:"]
    lines += [f"  {arm.name}: {{frame: {_quoted(arm.frame)}, joints: {arm.name}_joints}}  # guessed" for arm in arms]
    if limits:
        lines += ["# The URDF has none, or implausible numbers: use those of the data sheet", "limits:"]
        lines += [f"  {_quoted(joint)}: {_inline(values)}  # guessed" for joint, values in limits.items()]
    if not any(_has_friction(tree, joint) for arm in arms for joint in arm.joints):
        lines += ["# The URDF has no friction, and real joints with gears have: N m s/rad, N m", "friction:"]
        lines += [f"  {arm.name}_joints: {{viscous: 0.5, coulomb: 0.2}}  # guessed" for arm in arms]
    if locked:
        lines += ["# Not commanded here: they stay where they are", "locked:"]
        lines += [f"  {_quoted(joint)}: {value:g}" for joint, value in locked.items()]
    lines += ["# Bent, away from limits, the hand down and in front: guessed", "home:"]
    lines += [f"  {_quoted(joint)}: {value:g}" for joint, value in home.items()]
    return "\n".join(lines) + "\n"


def _has_friction(tree: UrdfTree, joint: str) -> bool:
    element = tree.joints[joint].find("dynamics")
    return element is not None and float((element.get("friction") or "0").strip() or 0.0) > 0.0


def _inline(values: Mapping[str, float]) -> str:
    return "{" + ", ".join(f"{word}: {value:g}" for word, value in values.items()) + "}"


def _quoted(name: str) -> str:
    """A text as YAML reads it, whatever is in it."""
    plain = name.replace("_", "").replace("/", "").replace(":", "").replace(".", "").replace("-", "")
    is_plain = plain.isalnum() and not name[0].isdigit() and ": " not in name and name.lower() not in _WORDS
    return name if is_plain else "'" + name.replace("'", "''") + "'"


_WORDS = frozenset(("y", "n", "yes", "no", "on", "off", "true", "false", "null"))
"""What YAML takes for something else than a text."""
