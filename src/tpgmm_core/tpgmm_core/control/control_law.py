# SPDX-License-Identifier: Apache-2.0
"""`ControlLaw`: reference and state to named torque terms; the interface that the controller has for every law.

A law computes what the movement needs. It does not keep the torques within what robot and people can bear:
`torque_pipeline` does that, whatever the law.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Protocol

import numpy as np

from tpgmm_core.common.settings import Settings, setting
from tpgmm_core.common.types import Array
from tpgmm_core.control.operational_space import invert_inertia
from tpgmm_core.model.reference import Reference

if TYPE_CHECKING:
    from tpgmm_core.robot.data import RobotData


@dataclass(frozen=True, slots=True)
class Loop:
    """What is known of the loop from a state to the torques that answer it.

    Parameters
    ----------
    age
        of the state, s, during which the robot has moved on
    delay
        from what the joints do to the torques that answer it, s; the feedback must be stable with it
    hindered
        whether the robot does not get to its reference: it is then pulled only a little
    softness
        largest share of the rates of the gains that is wanted, 0 to 1, also where the delay permits more
    """

    age: float = 0.0
    delay: float = 0.0
    hindered: bool = False
    softness: float = 1.0


AT_ONCE = Loop()


@dataclass(frozen=True, slots=True)
class DynamicState:
    """A state of the robot with its dynamics; the arrays are overwritten when the next one is made.

    Parameters
    ----------
    q, v
        (nv,), rad and rad/s (m and m/s for prismatic joints), finite
    inertia
        (nv, nv), joint-space inertia M(q), symmetric, C-contiguous
    inverse
        (nv, nv), M^-1; NaN where M cannot be inverted
    nonlinear
        (nv,), gravity, Coriolis and centrifugal torques, N m (N), where the robot is by now
    data
        kinematics at q and v
    loop
        how late the state is
    """

    q: Array
    v: Array
    inertia: Array
    inverse: Array
    nonlinear: Array
    data: RobotData
    loop: Loop = AT_ONCE

    @classmethod
    def at(cls, data: RobotData, q: Array, v: Array, loop: Loop = AT_ONCE) -> DynamicState:
        """Kinematics and dynamics of a robot.

        Parameters
        ----------
        data
            scratch memory of the robot, which is overwritten
        q, v
            (nv,), positions and velocities
        loop
            how late the state is

        Returns
        -------
        DynamicState
            with mass matrix, its inverse, and gravity and Coriolis torques at q and v
        """
        data.update(q, v)
        # Pinocchio's matrices are column-major; of a symmetric one the transpose is the same, row-major
        inertia = data.mass_matrix(q).T
        inverse = np.empty_like(inertia)
        if not invert_inertia(inertia, inverse):
            inverse[:] = np.nan
        # torques that carry an upright arm would push it over if they were those of where the arm was
        there = q + loop.age * v if loop.age > 0.0 else q
        return cls(q, v, inertia, inverse, data.nonlinear_effects(there, v), data, loop)


@dataclass(frozen=True, slots=True)
class Lag:
    """How far the robot is from its reference.

    Parameters
    ----------
    distance
        of a hand, m; 0 for references of joints
    angle
        of a hand, rad; for references of joints, the largest one, rad (m)
    joint
        the joint with the largest one; empty for a hand
    """

    distance: float
    angle: float
    joint: str = ""

    @classmethod
    def of_pose(cls, difference: Array) -> Lag:
        """Lag of a hand, from a tangent vector (6,): position, then turn."""
        x, y, z, a, b, c = difference.tolist()
        return cls(math.hypot(x, y, z), math.hypot(a, b, c))

    @classmethod
    def of_joints(cls, difference: Array, names: Sequence[str]) -> Lag:
        """Lag of joints, from their differences (n,)."""
        worst = int(np.argmax(np.abs(difference)))
        return cls(0.0, float(abs(difference[worst])), names[worst])

    def __str__(self) -> str:
        if self.joint:
            return f"{self.joint} is {self.angle:.2f} (rad, m) from the reference"
        return f"{1e3 * self.distance:.0f} mm and {math.degrees(self.angle):.0f} deg from the reference"


@dataclass(frozen=True, slots=True)
class LawTorques:
    """What a law asks for.

    Parameters
    ----------
    tau
        (nv,), the sum of the terms, N m (N), in model order
    terms
        name -> (nv,); "feedforward" is what a law adds whatever the error is, each law names its others
    error
        from the robot to the reference, in the tangent space of the reference; zero without reference
    stiffness, damping
        (n, n), of the robot as the environment feels it, N/m and N m/rad, N s/m and N m s/rad; zero without reference
    jacobian
        (n, nv), the velocity of what has this stiffness, by the joints' velocities
    blend
        0 (gravity compensation) to 1 (the reference acts fully)
    saturated
        whether the law reduced its torques, since the motors are too weak for its error
    reason
        why no torques could be computed; tau then has no meaning. Empty when all is well
    lag
        how far the robot is from its reference, also while the law still approaches it; None without reference
    delay_margin
        delay of the loop, s, at which the gains for this reference become unstable
    share
        of the rates of the gains, 0 to 1, that the delay of the loop permits: K_P is scaled by its square, K_V by
        itself
    moves, asked
        speed of what is controlled, and of the reference, 1/s; metres are divided by the characteristic length
    """

    tau: Array
    terms: Mapping[str, Array]
    error: Array
    stiffness: Array
    damping: Array
    jacobian: Array
    blend: float
    saturated: bool
    reason: str
    lag: Lag | None = None
    delay_margin: float = math.inf
    share: float = 1.0
    moves: float = 0.0
    asked: float = 0.0

    def joint_gains(self) -> tuple[Array, Array]:
        """Stiffness and damping in joint space, J^T K J and J^T D J, both (nv, nv)."""
        J = self.jacobian
        return J.T @ self.stiffness @ J, J.T @ self.damping @ J


@dataclass(frozen=True, slots=True, kw_only=True)
class LawConfig(Settings):
    """Parameters that all laws have."""

    gain_time: float = setting(0.05, 1e-3, 5.0, "Time constant with which stiffness and damping change, s")
    hold_frequency: float = setting(
        20.0, 0.1, 100.0, "Bandwidth with which joints without a reference are held still, rad/s"
    )
    hand_guiding_damping: float = setting(
        0.3, 1e-3, 50.0, "Damping of an arm without a reference, while a person may guide it by hand, N m s/rad"
    )
    blend_time: float = setting(
        0.5, 1e-3, 60.0, "Time over which the control fades in when a reference comes, and out when it ends, s"
    )


class ControlLaw[TargetT](Protocol):
    """Torques of a whole robot that follow references; time is only given as dt."""

    def reset(self) -> None:
        """Forget target and posture; the next step starts from the state that it is given."""

    def target(self, reference: Reference, moving: bool) -> TargetT:
        """Prepare a reference, once for all steps that follow it.

        Parameters
        ----------
        reference
            of a pose or of joints
        moving
            False for a reference that is held: it then comes to rest

        Returns
        -------
        TargetT
            what `step` takes

        Raises
        ------
        ValueError
            for a reference that this law cannot follow; the text says why
        """

    def step(self, moment: DynamicState, target: TargetT | None, dt: float) -> LawTorques:
        """Torques dt seconds (>= 0) after the last step.

        It does not raise: the `reason` of the result says what went wrong.

        Parameters
        ----------
        moment
            the state of the robot
        target
            what is to be followed; None: the last target is released without a jump
        dt
            since the last step, s

        Returns
        -------
        LawTorques
            the torques and what they are made of
        """
