# SPDX-License-Identifier: Apache-2.0
"""`ProgressWatch`: whether a robot gets to its reference, and if not, why; time is an argument.

A robot that is far from its reference and comes no nearer does not follow it: it is at a position limit, its motors are
too weak, it is fully stretched, or something holds it. It follows again once it is near.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from tpgmm_core.common.types import Array
from tpgmm_core.control.control_law import Lag, LawTorques
from tpgmm_core.robot.model import RobotModel

#: Far from the reference, m and rad; near again below the share of it.
FAR, FAR_ANGLE, NEAR = 0.05, 0.3, 0.7
#: A robot is stuck when it comes no nearer by this share of the distance, or of `FAR`, for this long (s).
NEARER, STEP, PATIENCE = 0.05, 0.4, 1.0
#: A reference that moves (1/s) counts as followed at this share of its speed.
MOVES, KEEPS_UP = 0.1, 0.5
#: At a position limit: nearer to it than this, rad or m. At its effort limit: above this share.
AT_STOP, AT_EFFORT = 0.06, 0.98
#: Smallest singular value (m, turns by `LENGTH`) below which a hand hardly moves in some direction.
STRETCHED, LENGTH = 0.05, 0.3
#: The reason is written anew this often, s.
NEW_WORDS = 2.0


class ProgressWatch:
    """See the module. `reason` says why the reference is not followed; empty while it is.

    Parameters
    ----------
    robot
        whose limits are compared with its state
    """

    def __init__(self, robot: RobotModel) -> None:
        self._robot = robot
        self.forget()

    def forget(self) -> None:
        """Start with a new movement: nothing is known of it."""
        self.reason = ""
        self._nearest = np.inf
        self._waited = self._told = self._told_far = 0.0

    def step(self, q: Array, tau: Array, asked: LawTorques, dt: float, is_held: bool = False) -> None:
        """Judge the progress of a step.

        Parameters
        ----------
        q
            (nv,), positions
        tau
            (nv,), torques that are sent
        asked
            what the law asked for
        dt
            since the last step, s
        is_held
            whether somebody holds the robot, so that it need not follow
        """
        if asked.lag is None:
            self.forget()
            return
        far = size(asked.lag)
        if is_held:  # what counts from when it is let go of
            self.reason, self._told, self._told_far = _comes_back(asked.lag), 0.0, far
            return
        if far < (NEAR if self.reason else 1.0):
            self.forget()
            return
        if self.reason:
            self._told += dt
            if self._told >= NEW_WORDS:
                comes = far < self._told_far - NEARER  # one that was held and let go of comes back, slowly
                self.reason = _comes_back(asked.lag) if comes else self._words(q, tau, asked)
                self._told, self._told_far = 0.0, far
            return
        keeps_up = asked.asked > MOVES and asked.moves >= KEEPS_UP * asked.asked
        if keeps_up or asked.blend < 1.0 or far < self._nearest - min(NEARER * self._nearest, STEP):
            self._nearest, self._waited = far, 0.0
            return
        self._waited += dt
        if self._waited >= PATIENCE:
            self.reason, self._told_far = self._words(q, tau, asked), far

    def _words(self, q: Array, tau: Array, asked: LawTorques) -> str:
        causes = "; ".join(hindrances(self._robot, q, tau, asked))
        return f"not following, {asked.lag}, no progress: {causes}"


def _comes_back(lag: Lag) -> str:
    return f"not following yet, {lag}: it comes nearer, slowly"


def size(lag: Lag) -> float:
    """Distance of a robot from its reference, in multiples of what counts as far."""
    return max(lag.distance / FAR, lag.angle / FAR_ANGLE)


def hindrances(robot: RobotModel, q: Array, tau: Array, asked: LawTorques) -> Iterator[str]:
    """What may keep a robot from its reference, in words: at least one.

    Parameters
    ----------
    robot, q, tau, asked
        as for `ProgressWatch`

    Yields
    ------
    str
        one sentence for each
    """
    moved = np.abs(asked.jacobian).max(axis=0, initial=0.0) > 0.0
    names, units, none = robot.joint_names, robot.joint_units, True
    room = np.minimum(q - robot.lower_limits, robot.upper_limits - q)
    for what, joints in (
        ("joint limit", [f"{names[i]}, {q[i]:.2f} {units[i]}" for i in np.flatnonzero(moved & (room < AT_STOP))]),
        (
            "effort limit",
            [
                f"{names[i]}, {tau[i]:.0f} {'N' if units[i] == 'm' else 'N m'}"
                for i in np.flatnonzero(moved & (np.abs(tau) > AT_EFFORT * robot.effort_limits))
            ],
        ),
    ):
        if joints:
            none = False
            yield f"at {what}: {', '.join(joints)}"
    J = asked.jacobian[:, moved]
    if asked.lag is not None and not asked.lag.joint and len(J) == 6 and J.shape[1] >= 6:
        least = float(np.linalg.svd(J * np.repeat([1.0, LENGTH], 3)[:, None], compute_uv=False)[-1])
        if least < STRETCHED:
            none = False
            yield f"singular: it can hardly move in some direction ({least:.2g} m per rad)"
    if asked.asked > MOVES:
        none = False
        yield "the reference moves away from it"
    elif none and asked.saturated:
        none = False
        yield "its motors are too weak"
    if none:
        yield "something holds it, or its stiffness is too low"
