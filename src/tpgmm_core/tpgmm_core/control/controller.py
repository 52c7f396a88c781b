# SPDX-License-Identifier: Apache-2.0
"""`Controller`: a law of control, and the pipeline that its torques pass before they are sent."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from tpgmm_core.common.types import Array
from tpgmm_core.control.control_law import AT_ONCE, ControlLaw, DynamicState, LawTorques, Loop
from tpgmm_core.control.torque_limits import finite
from tpgmm_core.control.torque_pipeline import TorqueLimits, TorquePipeline, actions
from tpgmm_core.robot.model import RobotModel

#: Time constant with which a robot under gravity compensation with damping loses its speed, s.
REST_TIME = 0.05


@dataclass(frozen=True, slots=True)
class TorqueCommand:
    """Torques that may be sent.

    Parameters
    ----------
    tau
        (nv,), N m (N), in model order
    q, v
        (nv,), the state that they answer
    law
        what the law asked for; None for the safe torque, gravity compensation with damping
    actions
        what the pipeline did beside passing a torque on, of `torque_pipeline.ACTIONS`
    reason
        why the state, or the law, could not be used; empty when all is well
    """

    tau: Array
    q: Array
    v: Array
    law: LawTorques | None
    actions: tuple[str, ...]
    reason: str

    @property
    def limited(self) -> bool:
        """Whether the pipeline, or the law itself, reduced what the error asked for."""
        return bool(self.actions) or (self.law is not None and self.law.saturated)

    @property
    def terms(self) -> dict[str, Array]:
        """Name -> (nv,), whose sum is tau: the law's terms and "pipeline", its changes; or "safe" alone."""
        if self.law is None:
            return {"safe": self.tau}
        return {**self.law.terms, "pipeline": self.tau - self.law.tau}

    def acting(self, q: Array, v: Array) -> Array:
        """Torques that act at a later state, where the robot itself applies the law's gains.

        Parameters
        ----------
        q, v
            (nv,), the later state

        Returns
        -------
        Array
            shape (nv,), N m
        """
        if self.law is None:
            return self.tau
        stiffness, damping = self.law.joint_gains()
        return self.tau + stiffness @ (self.q - q) + damping @ (self.v - v)


class Controller[TargetT]:
    """States and targets in, torques that may be sent out, one for each step; time is only given as dt.

    Parameters
    ----------
    robot
        to be controlled
    law
        that computes the torques
    limits
        of the pipeline
    period
        see `TorquePipeline`
    closed_elsewhere
        whether the robot itself applies the gains that it gets. Its torques then change all the time, and the rate
        limit refers to those that act when the next ones come
    """

    def __init__(
        self,
        robot: RobotModel,
        law: ControlLaw[TargetT],
        limits: TorqueLimits | None = None,
        period: float = math.inf,
        *,
        closed_elsewhere: bool = False,
    ) -> None:
        self.robot, self.law, self._closed_elsewhere = robot, law, closed_elsewhere
        self.pipeline = TorquePipeline(robot, limits, period)
        self._data = robot.create_data()
        self.reset()

    def reset(self) -> None:
        """Forget everything, also the last torques; only while none act on the robot."""
        self.law.reset()
        self.pipeline.reset()
        self._q: Array | None = None
        self._v: Array | None = None
        self._sent: TorqueCommand | None = None

    def restart(self) -> None:
        """Blend in law and torques anew after an interruption, from the state of the next step."""
        self.law.reset()
        self.pipeline.restart()

    def step(
        self,
        q: Array,
        v: Array,
        target: TargetT | None,
        dt: float,
        loop: Loop = AT_ONCE,
        *,
        brakes: bool = False,
        now_ns: int | None = None,
    ) -> TorqueCommand | None:
        """Torques for a state of the robot.

        For a state that is not finite, or that the law cannot compute with, the result is that of `rest`, with the
        reason.

        Parameters
        ----------
        q, v
            (nv,), positions and velocities
        target
            prepared by the law; None: no reference
        dt
            since the last torques, s
        loop
            how late the torques are
        brakes
            without the law: gravity compensation with damping at this state. The law starts anew afterwards
        now_ns
            see `TorquePipeline.step`

        Returns
        -------
        TorqueCommand | None
            None while there was no good state yet

        Raises
        ------
        ValueError
            for arrays of the wrong shape
        """
        q, v = np.ascontiguousarray(q, dtype=np.float64), np.ascontiguousarray(v, dtype=np.float64)
        if q.shape != (self.robot.nv,) or v.shape != (self.robot.nv,):
            raise ValueError(f"q and v have shapes {q.shape} and {v.shape}, expected ({self.robot.nv},)")
        if not (finite(q) and finite(v)):
            return self.rest(0.0, dt, "the joint state is not finite", loop, now_ns)
        q = self.robot.unwound(q, self.robot.home if self._q is None else self._q)
        moment = DynamicState.at(self._data, q, v, loop)
        if brakes:
            self.law.reset()
        asked = None if brakes else self.law.step(moment, target, self.pipeline.time_step(dt))
        if asked is not None and asked.reason:
            return self.rest(0.0, dt, asked.reason, loop, now_ns)
        if self._closed_elsewhere and self._sent is not None:
            self.pipeline.acts(self._sent.acting(q, v))
        tau, done = self.pipeline.step(None if asked is None else asked.tau, moment, dt, now_ns)
        self._q, self._v = q.copy(), v.copy()
        self._sent = TorqueCommand(tau, self._q, self._v, asked, actions(done), "")
        return self._sent

    def rest(
        self, age: float, dt: float, reason: str = "", loop: Loop = AT_ONCE, now_ns: int | None = None
    ) -> TorqueCommand | None:
        """Gravity compensation with damping, at the last good state; None if there was none.

        The damping answers the last speed, which is assumed to fade: otherwise it would push a robot backwards that
        stood still long ago. The law starts anew afterwards.

        Parameters
        ----------
        age
            of the last good state, s
        dt
            since the last torques, s
        reason
            for the command
        loop
            how late the torques are
        now_ns
            see `TorquePipeline.step`

        Returns
        -------
        TorqueCommand | None
            None while there was no good state yet
        """
        self.law.reset()
        if self._q is None or self._v is None:
            return None
        v = self._v * math.exp(-max(0.0, age) / REST_TIME)
        moment = DynamicState.at(self._data, self._q, v, replace(loop, age=0.0))
        tau, done = self.pipeline.step(None, moment, dt, now_ns)
        self._sent = TorqueCommand(tau, moment.q, moment.v, None, actions(done), reason)
        return self._sent

    def at_rest(self, command: TorqueCommand) -> bool:
        """Whether a command of `rest` is the safe torque itself, which the rate limit no longer changes."""
        return "effort or rate" not in command.actions
