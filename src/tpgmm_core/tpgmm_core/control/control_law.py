# SPDX-License-Identifier: Apache-2.0
"""`ControlLaw`: reference and state to named torque terms; what every law of control is to the controller.

A law says what the movement asks for. That the torques stay within what robot and people bear is not its
business: `torque_pipeline` sees to it, whatever the law.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Protocol

import numpy as np
from numpy.typing import NDArray

from tpgmm_core.reference import Reference
from tpgmm_core.settings import check_settings, setting

if TYPE_CHECKING:
    from tpgmm_core.robot.model import RobotData

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class RobotMoment:
    """A state of the robot with its dynamics; the arrays are overwritten when the next moment is made.

    q, v : (nv,), rad and rad/s (m and m/s for prismatic joints), finite
    inertia : (nv, nv), joint-space inertia M(q), symmetric, C-contiguous
    nonlinear : (nv,), gravity, Coriolis and centrifugal torques, N m (N)
    data : kinematics at q and v
    """

    q: Array
    v: Array
    inertia: Array
    nonlinear: Array
    data: RobotData

    @classmethod
    def at(cls, data: RobotData, q: Array, v: Array) -> RobotMoment:
        """Kinematics and dynamics at q and v (nv,), in the scratch memory `data`."""
        data.update(q, v)
        # Pinocchio's matrices are column-major; of a symmetric one the transpose is the same, row-major
        return cls(q, v, data.mass_matrix(q).T, data.nonlinear_effects(q, v), data)


@dataclass(frozen=True, slots=True)
class LawTorques:
    """What a law asks for.

    tau : (nv,), the sum of the terms, N m (N), in model order
    terms : name -> (nv,); "feedforward" is what a law adds whatever the error is, each law names its others
    error : from the robot to the reference, in the tangent space of the reference; zero without reference
    stiffness, damping : (n, n), what the robot shows to the outside, N/m and N m/rad, N s/m and N m s/rad;
        zero without reference
    jacobian : (n, nv), the velocity of what has this stiffness, by the joints' velocities
    blend : 0 (gravity compensation) to 1 (the reference has full hold)
    shortened : whether the law itself asked for less than its error did, since the motors are too weak
    reason : why no torques could be computed, tau then means nothing; empty when all is well
    """

    tau: Array
    terms: Mapping[str, Array]
    error: Array
    stiffness: Array
    damping: Array
    jacobian: Array
    blend: float
    shortened: bool
    reason: str

    def joint_gains(self) -> tuple[Array, Array]:
        """Stiffness and damping as joints feel them, J^T K J and J^T D J, both (nv, nv)."""
        J = self.jacobian
        return J.T @ self.stiffness @ J, J.T @ self.damping @ J


@dataclass(frozen=True, slots=True, kw_only=True)
class LawConfig:
    """Parameters that all laws have."""

    gain_time: float = setting(0.05, 1e-3, 5.0, "Time constant with which the gains follow the precision, s")
    hold_frequency: float = setting(20.0, 0.1, 100.0, "Bandwidth with which the other joints hold still, rad/s")
    leading_damping: float = setting(0.3, 1e-3, 50.0, "Damping of an arm without reference, N m s/rad")
    blend_time: float = setting(0.5, 1e-3, 60.0, "A reference takes hold, and lets go, over this time, s")

    def __post_init__(self) -> None:
        """Raises ValueError for values out of their range."""
        check_settings(self)


class ControlLaw[TargetT](Protocol):
    """Torques of a whole robot that follow references; time enters as dt alone."""

    def reset(self) -> None:
        """Forget target and posture; the next step starts from the state that it is given."""

    def target(self, reference: Reference, moving: bool) -> TargetT:
        """What the law makes of a reference, once for all steps that follow it.

        moving : False for a reference that is held: what moves comes to rest.

        Raises ValueError for a reference that this law cannot follow; the text says why.
        """

    def step(self, moment: RobotMoment, target: TargetT | None, dt: float) -> LawTorques:
        """Torques dt seconds (>= 0) after the last step. None: let go of the last target without a jump.

        Does not raise: what goes wrong is the `reason` of the answer.
        """
