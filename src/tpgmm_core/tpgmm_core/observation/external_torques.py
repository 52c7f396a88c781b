# SPDX-License-Identifier: Apache-2.0
"""`ExternalTorques`: what pushes a robot from outside, out of its positions, velocities and measured torques.

`tau_ext = M(q) a + nle(q, v) - tau`, where the acceleration is a difference of velocities and all else is a mean over
the same time, through a low-pass. That is what an observer of the generalised momentum finds (De Luca and Mattone 2005;
Haddadin, De Luca and Albu-Schaeffer 2017, "Robot Collisions: A Survey", Section IV), for states that come in batches.

A torque that was commanded tells nothing of a push: a joint whose torque is controlled has that torque whether somebody
pushes or not. So the robot's dynamics are what the measured torques are held against.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from tpgmm_core.common.types import Array
from tpgmm_core.observation.streams import SECOND
from tpgmm_core.robot.model import RobotModel

#: Time constant of the low-pass, s.
TIME_CONSTANT = 0.1
#: States farther apart than this say nothing of the time between them; acceleration needs this time at least, s.
MAX_GAP, LEAST_TIME = 0.1, 0.008
#: A torque at the hand counts as the force that has it at this lever, m. Singular values below `DAMPING` (m) are
#: damped: what the arm hardly feels is underestimated rather than made up.
LEVER, DAMPING = 0.3, 0.05


@dataclass(frozen=True, slots=True)
class MeasuredForce:
    """How hard somebody pushes a hand.

    Parameters
    ----------
    newtons
        N, as in `size_of`; None where that cannot be known
    source
        what measures it, in words
    why
        it cannot be known, in words
    """

    newtons: float | None = None
    source: str = ""
    why: str = ""


class ExternalTorques:
    """See the module.

    Parameters
    ----------
    robot
        with masses and friction as in its file
    endpoint
        the hand that forces are told at

    Attributes
    ----------
    torques
        (nv,) N m (N), from outside, positive where they push a joint forward
    """

    def __init__(self, robot: RobotModel, endpoint: str) -> None:
        self._robot, self._endpoint = robot, endpoint
        self._arm = robot.indices(robot.endpoints[endpoint].joints)
        self._data = robot.create_data()
        self._first_ns, self._last_ns, self._count = -1, -1, 0
        self._sum = np.zeros(robot.nv)
        self.forget()

    def forget(self) -> None:
        """Start without any state."""
        self.torques = np.zeros(self._robot.nv)
        self._judged_ns: int | None = None
        self._begin(-1, np.zeros(self._robot.nv), np.zeros(self._robot.nv))

    @property
    def is_known(self) -> bool:
        """Whether there were states enough."""
        return self._judged_ns is not None

    def take(self, stamp_ns: int, q: Array, v: Array, tau: Array) -> None:
        """Take in a state.

        Parameters
        ----------
        stamp_ns
            ns
        q, v
            (nv,), positions and velocities
        tau
            (nv,), torques of the motors, or behind their gears, that led to this state, N m (N)
        """
        if stamp_ns == self._last_ns:
            return  # it came twice
        since = (stamp_ns - self._last_ns) / SECOND
        if self._last_ns < 0 or not 0.0 < since <= MAX_GAP:
            self._begin(stamp_ns, q, v)
            return
        self._last_ns, self._q, self._v = stamp_ns, q, v
        self._sum, self._count = self._sum + tau, self._count + 1

    def step(self) -> None:
        """Judge what came since the last time; to be called some ten times per second."""
        seconds = (self._last_ns - self._first_ns) / SECOND
        if not self._count or seconds < LEAST_TIME:
            return
        (q0, v0), q, v = self._first, self._q, self._v
        middle = 0.5 * (self._robot.unwound(q0, q) + q)
        torques = self._data.mass_matrix(middle) @ ((v - v0) / seconds)
        torques += self._data.nonlinear_effects(middle, 0.5 * (v0 + v)) - self._sum / self._count
        # after a pause the new counts for more: what was before is older by the pause
        # and after time was set back, nothing of before is left
        former = self._judged_ns
        passed = math.inf if former is None or self._last_ns < former else (self._last_ns - former) / SECOND
        self.torques = self.torques - math.expm1(-passed / TIME_CONSTANT) * (torques - self.torques)
        self._judged_ns = self._last_ns
        self._begin(self._last_ns, q, v)

    def hand_force(self) -> float:
        """How hard the hand is pushed or turned: least squares over the joints of its arm, beyond friction.

        Friction is not measured, and its sign depends on which side of the gear torques are measured: what the
        friction of the robot file could explain is not counted.

        Returns
        -------
        float
            N, as in `size_of`
        """
        robot, arm = self._robot, self._arm
        friction = robot.coulomb_friction + robot.viscous_friction * np.abs(self._v)
        felt = np.sign(self.torques) * np.maximum(np.abs(self.torques) - friction, 0.0)
        self._data.update(self._q)
        jacobian = self._data.jacobian(self._endpoint)[:, arm] * np.repeat([1.0, LEVER], 3)[:, None]
        wrench = np.linalg.solve(jacobian @ jacobian.T + DAMPING**2 * np.eye(6), jacobian @ felt[arm])
        return size_of(wrench * np.repeat([1.0, LEVER], 3))

    def _begin(self, stamp_ns: int, q: Array, v: Array) -> None:
        self._first_ns = self._last_ns = stamp_ns
        self._first, self._q, self._v = (q, v), q, v
        self._sum, self._count = np.zeros(self._robot.nv), 0


def size_of(wrench: Array) -> float:
    """How hard a wrench (6,), N and N m, pushes or turns, N: a torque counts as the force at `LEVER`."""
    return float(max(np.linalg.norm(wrench[:3]), np.linalg.norm(wrench[3:]) / LEVER))
