# SPDX-License-Identifier: Apache-2.0
"""`JointValues`: limits, friction and home of a robot's joints, from its URDF and its robot file, checked."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike

from tpgmm_core.common.text import listed
from tpgmm_core.common.types import Array
from tpgmm_core.robot.description import RobotDescription, RobotFileError
from tpgmm_core.robot.urdf_tree import Mimic

# No joint of an arm has more (N m or N; rad/s or m/s): URDFs hold larger numbers where the limit was not known.
CREDIBLE_EFFORT = 1000.0
CREDIBLE_VELOCITY = 100.0
#: Units of joints that turn, and of those that slide.
UNITS = {
    "position": ("rad", "m"),
    "velocity": ("rad/s", "m/s"),
    "effort": ("N m", "N"),
    "inertia": ("kg m^2", "kg"),
}


def unit_of(model: pin.Model, joint: int, quantity: str) -> str:
    """Unit of a quantity of a joint; it depends on whether the joint turns or slides.

    Parameters
    ----------
    model
        of Pinocchio
    joint
        index in joint vectors
    quantity
        "position", "velocity", "effort" or "inertia"

    Returns
    -------
    str
        such as "rad" or "m"
    """
    return UNITS[quantity][model.joints[joint + 1].shortname().startswith("JointModelP")]


class JointValues:
    """Values of all joints in model order.

    Parameters
    ----------
    description
        the robot file
    model
        of Pinocchio, without locked joints
    mimics
        joint -> what it mimics
    """

    def __init__(self, description: RobotDescription, model: pin.Model, mimics: Mapping[str, Mimic]) -> None:
        self.description, self._model, self.mimics = description, model, mimics
        self.joint_names: tuple[str, ...] = tuple(model.names[1:])
        self._index = {name: i for i, name in enumerate(self.joint_names)}

    def check_names(self) -> None:
        """Check that the robot file names joints and frames that the URDF has, and every joint that needs a name.

        Raises
        ------
        RobotFileError
            with the key and the names
        """
        description = self.description
        groups = [joint for joints in description.joint_groups.values() for joint in joints]
        for key, names in (
            ("joint_groups", groups),
            ("limits", list(description.limits)),
            ("friction", list(description.friction)),
            ("armature", list(description.armature)),
            ("home", list(description.home)),
        ):
            unknown = sorted({name for name in names if name not in self._index})
            if unknown:
                raise RobotFileError(
                    f"{description.path}: {key} names the unknown joints {listed(unknown)}; "
                    f"the URDF has {listed(self.joint_names, 40)}"
                )
        missing = [name for name in self.joint_names if name not in description.home]
        if missing:
            raise RobotFileError(
                f"{description.path}: home lacks the joints {listed(missing, 40)}; give their positions, or lock "
                f"those that are not commanded here: locked: {{{missing[0]}: POSITION}}"
            )
        frames = [description.base_frame, *(end.frame for end in description.endpoints.values())]
        absent = [frame for frame in frames if not self._model.existFrame(frame)]
        if absent:
            raise RobotFileError(f"{description.path}: the URDF {description.urdf.name} has no frames {listed(absent)}")

    def spread(self, default: ArrayLike, entries: Mapping[str, Mapping[str, float]], word: str) -> Array:
        """Values of all joints: those of the URDF, replaced where the robot file has others.

        Parameters
        ----------
        default
            of the URDF, (nv,)
        entries
            joint -> word -> value
        word
            which of the values

        Returns
        -------
        Array
            shape (nv,)
        """
        values = np.array(default, dtype=np.float64)
        for joint, entry in entries.items():
            values[self._index[joint]] = entry.get(word, values[self._index[joint]])
        return values

    def limits(self, word: str, urdf: ArrayLike) -> Array:
        """Limits of all joints.

        Parameters
        ----------
        word
            "effort", "velocity", "lower", "upper" or "torque_rate"
        urdf
            of the URDF, (nv,)

        Returns
        -------
        Array
            shape (nv,)

        Raises
        ------
        RobotFileError
            for an effort or a velocity that no motor has
        """
        description = self.description
        values = self.spread(urdf, description.limits, word)
        if word in ("effort", "velocity"):
            bound = CREDIBLE_EFFORT if word == "effort" else CREDIBLE_VELOCITY
            for joint, value in zip(self.joint_names, values, strict=True):
                if not 0.0 < value <= bound:
                    unit = unit_of(self._model, self._index[joint], word)
                    raise RobotFileError(
                        f"{description.path}: {word} limit {value:g} of {joint!r} is not credible (expected "
                        f"above 0, up to {bound:g} {unit}); give the true one: limits: {{{joint}: "
                        f"{{{word}: ...}}}}, or lock the joint, if it has no motor: locked: {{{joint}: "
                        f"POSITION}}{self._more_to_say(joint, word, values, bound)}"
                    )
        return values

    def _more_to_say(self, first: str, word: str, values: Array, bound: float) -> str:
        """Words about whether a joint mimics another, and about other joints with the same problem."""
        leader = ""
        if first in self.mimics:
            leader = f". It mimics {self.mimics[first].leader}: leave it out of home, and it follows that joint"
        wrong = ~((values > 0.0) & (values <= bound))
        others = [joint for joint, bad in zip(self.joint_names, wrong, strict=True) if bad and joint != first]
        return leader + (f". The same is true for the {word} limits of {listed(others, 40)}" if others else "")

    def check_ranges(self, lower_limits: Array, upper_limits: Array, home: Array, torque_rates: Array) -> None:
        """Check that joints can move, home included, and that torques can change.

        Parameters
        ----------
        lower_limits, upper_limits, home
            shape (nv,), rad or m
        torque_rates
            shape (nv,), N m/s or N/s

        Raises
        ------
        RobotFileError
            with the joint and what the robot file needs
        """
        description = self.description
        for i, joint in enumerate(self.joint_names):
            lower, upper, at_home = lower_limits[i], upper_limits[i], home[i]
            if not lower < upper:
                raise RobotFileError(
                    f"{description.path}: {joint!r} may move from {lower:g} to {upper:g} "
                    f"{unit_of(self._model, i, 'position')}, an empty range; give the "
                    f"real limits: limits: {{{joint}: {{lower: ..., upper: ...}}}}"
                )
            if not lower <= at_home <= upper:
                raise RobotFileError(
                    f"{description.path}: home of {joint!r} is {at_home:g}, outside {lower:g} to {upper:g} "
                    f"{unit_of(self._model, i, 'position')}"
                )
            if not torque_rates[i] > 0.0:
                raise RobotFileError(
                    f"{description.path}: torque_rate of {joint!r} is {torque_rates[i]:g} N m/s; expected one "
                    "above 0, or none where the maker gives none"
                )

    def check_not_negative(self, what: str, *values: Array) -> None:
        """Check friction or inertia.

        Parameters
        ----------
        what
            its name in the robot file
        *values
            shape (nv,) each

        Raises
        ------
        RobotFileError
            with the joint
        """
        for i, joint in enumerate(self.joint_names):
            if any(value[i] < 0.0 for value in values):
                raise RobotFileError(f"{self.description.path}: {what} of {joint!r} must not be negative")
