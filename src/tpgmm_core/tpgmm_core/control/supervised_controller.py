# SPDX-License-Identifier: Apache-2.0
"""`SupervisedController`: a controller that answers joint states, and knows what to do when they or references stop.

Joint states and references come by `take_state` and `take_reference`, each with its stamp. `watch` has to be
called regularly, several times within `joint_state_timeout`, since silence triggers no callback. Each returns what
has to be sent. Times are ns: `now_ns` of a clock that does not jump (steady, or the simulation's), `clock_ns` of
the clock of the stamps.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from tpgmm_core.common.types import Array
from tpgmm_core.control.control_law import ControlLaw
from tpgmm_core.control.controller import Controller, TorqueCommand
from tpgmm_core.control.loop_guard import LoopGuard
from tpgmm_core.control.state_intake import Intake, StateIntake
from tpgmm_core.control.supervision import ControllerMode, Inputs, Timeouts, decide
from tpgmm_core.control.torque_pipeline import TorqueLimits
from tpgmm_core.control.yielding import YieldConfig
from tpgmm_core.model.reference import Reference
from tpgmm_core.observation.streams import BETWEEN, SECOND, Stamp, StreamWatch, stamps_ahead
from tpgmm_core.robot.model import RobotModel


@dataclass(frozen=True, slots=True)
class Answer:
    """Torques to be sent, with the stamp of the joint state that they answer."""

    stamp_ns: int
    command: TorqueCommand


class SupervisedController[TargetT]:
    """See the module. `decision` is what it does at present, and why.

    Parameters
    ----------
    robot
        to be controlled
    law
        that computes the torques
    limits
        of the torques
    timeouts
        of the inputs
    yields
        when it yields to somebody who holds the hand
    period
        of the robot's cycle, s
    closed_elsewhere
        see `Controller`
    """

    def __init__(
        self,
        robot: RobotModel,
        law: ControlLaw[TargetT],
        limits: TorqueLimits | None = None,
        timeouts: Timeouts | None = None,
        yields: YieldConfig | None = None,
        *,
        period: float = 0.001,
        closed_elsewhere: bool = False,
    ) -> None:
        self.law, self.timeouts = law, timeouts or Timeouts()
        self._max_time_step = (limits or TorqueLimits()).max_time_step
        self.controller = Controller(robot, law, limits, period, closed_elsewhere=closed_elsewhere)
        self.guard = LoopGuard(robot, self.timeouts, yields, closed_elsewhere)
        self._states = StateIntake(robot)
        self.start()

    def start(self) -> None:
        """Forget everything: torques begin with the first joint state, as gravity compensation with damping."""
        self.controller.reset()
        self.guard.forget()
        self._states.start()
        self._references = StreamWatch()
        self._reference: Reference | None = None
        self._moving: TargetT | None = None
        self._held: TargetT | None = None
        self._reference_fault = ""
        self._answer: Answer | None = None
        self._answered_state = False
        self._used: float | None = None
        self._q = self._v = np.zeros(0)
        self._interval_ns = self._period_ns = 0
        self._sent_ns = self._watched_ns = 0
        self._paused = False
        self.decision = decide(Inputs(None, "", None, ""), self.timeouts)

    def configure(self, limits: TorqueLimits, timeouts: Timeouts, yields: YieldConfig | None = None) -> None:
        """Use other limits and time-outs, and let the law prepare the reference again with its new parameters.

        Parameters
        ----------
        limits, timeouts
            of the torques, and of the inputs
        yields
            when it yields to somebody who holds the hand; None: as before
        """
        self.controller.pipeline.configure(limits)
        self.timeouts = self.guard.timeouts = timeouts
        if yields is not None:
            self.guard.yielding.configure(yields)
        self._max_time_step = limits.max_time_step
        if self._reference is not None:
            self._moving, self._held = self.law.target(self._reference, True), None

    @property
    def stamp_ns(self) -> int:
        """Stamp of the last good joint state; 0 before the first."""
        return self._states.stamp_ns or 0

    @property
    def doubts(self) -> list[str]:
        """What is wrong with joint states that are answered nevertheless, in words."""
        return self._states.doubts(self.timeouts, self._max_time_step)

    # -- inputs --------------------------------------------------------------------------------------------------

    def take_reference(self, reference: Reference, stamp_ns: int, now_ns: int, clock_ns: int) -> None:
        """Follow a reference from now on. One that is not newer than the last is ignored, and so ages.

        Parameters
        ----------
        reference
            of a pose or of joints
        stamp_ns
            of the reference
        now_ns, clock_ns
            see the module

        Raises
        ------
        ValueError
            for a reference that is refused; the last good one ages
        """
        timeouts = self.timeouts
        kind = self._references.judge(stamp_ns, now_ns, clock_ns, timeouts.reference_timeout, timeouts.max_future)
        if kind in (Stamp.REPEATED, Stamp.OLD):
            return
        try:
            if kind is Stamp.FUTURE:
                raise ValueError(stamps_ahead(timeouts.max_future))
            self._moving = self.law.target(reference, True)
        except ValueError as error:
            self.refuse_reference(str(error))
            raise
        self._references.accept(stamp_ns, now_ns)
        self._reference, self._held, self._reference_fault = reference, None, ""

    def refuse_reference(self, reason: str) -> None:
        """Note that a reference came that cannot be used; the last good one ages."""
        self._reference_fault = reason

    def take_state(self, q: Array, v: Array, stamp_ns: int, now_ns: int, clock_ns: int) -> Answer | None:
        """Answer a joint state.

        A state that is not newer than the last one is not used. A repeated one is answered as before (the answer may
        have been lost) until the last new one is stale; one that was overtaken is not answered.

        Parameters
        ----------
        q, v
            (nv,), positions and velocities
        stamp_ns
            of the state
        now_ns, clock_ns
            see the module

        Returns
        -------
        Answer | None
            None where the state is not answered
        """
        timeouts, guard, before_ns = self.timeouts, self.guard, self._states.stamp_ns
        begins = self._states.is_stale(now_ns, timeouts) or bool(self._states.fault)
        kind = self._states.judge(q, v, stamp_ns, now_ns, clock_ns, timeouts, guard.age.period)
        if kind is Intake.IGNORED:
            return None
        if kind is Intake.REPEATED:  # once it is stale, `watch` answers
            return None if self._states.is_stale(now_ns, timeouts) else self._answer
        if kind in (Intake.REFUSED, Intake.WRONG):
            return self._rest(stamp_ns, now_ns, is_timed=kind is Intake.WRONG)
        if kind is Intake.RESTARTED:
            guard.forget()
            self._references.forget()
            self._reference = self._moving = self._held = None
        if begins:
            self.controller.restart()
        if self._used is not None and self._answer is not None:  # what was answered again counts to the same interval
            dt = max(0.0, (stamp_ns - self._answer.stamp_ns) / SECOND - self._used)
        else:
            dt = self._since_last(stamp_ns if self._answered_state else None, now_ns)
        former, self._interval_ns = self._interval_ns, stamp_ns - (before_ns or stamp_ns)
        self._period_ns = min(former, self._interval_ns)  # a pause is no period
        self._q, self._v = q, v
        guard.age.take(stamp_ns, clock_ns, of_another_clock=timeouts.max_age == 0.0)
        self.decision = guard.judge(decide(self._inputs(now_ns), timeouts))
        command = self.controller.step(q, v, self._target(), dt, guard.loop(), brakes=guard.swings, now_ns=now_ns)
        if command is None or command.reason:
            # a state that is well-formed and still cannot be right
            self._states.refuse(command.reason if command is not None else "the joint state is not finite")
            self.decision = decide(self._inputs(now_ns), timeouts)
        else:
            guard.after(command, self.decision.mode, self.controller.pipeline.time_step(dt))
        return self._send(command, stamp_ns, now_ns, to_state=not self._states.fault)

    def take_force(self, newtons: float | None, now_ns: int) -> str:
        """Yield to a force on the hand, if it is one of a person; see `Yielding.feel`.

        Parameters
        ----------
        newtons
            N; None where it is not known
        now_ns
            see the module

        Returns
        -------
        str
            why the arm cannot yield at present, in words; empty where it can
        """
        return self.guard.yielding.feel(now_ns / SECOND, newtons)

    def answer_again(self, now_ns: int) -> Answer | None:
        """Answer the last joint state again, where the last reference was made after it and before the next one.

        A reproduction makes such a reference when frames have changed: the torques that follow from it need not wait
        for the next joint state. Its stamp tells: it lies between theirs. The time since that state, in which torques
        may change, is taken off the interval to the next one: between the stamps of two states, torques change by no
        more than in one step, however late the messages come.

        Parameters
        ----------
        now_ns
            see the module

        Returns
        -------
        Answer or None
            with the stamp of that joint state, once for each at most; None where there is nothing to answer
        """
        state_ns, reference_ns = self._states.stamp_ns, self._references.stamp_ns
        if state_ns is None or reference_ns is None or not self._answered_state:
            return None
        dt = self._since_last(None, now_ns)
        longest = BETWEEN * self._period_ns  # then the next state is near, or should have been here
        if not 0 < reference_ns - state_ns < longest or not 0.0 < dt < longest / SECOND:
            return None
        if self.guard.judge(decide(self._inputs(now_ns), self.timeouts)).mode is not ControllerMode.ACTIVE:
            return None
        guard = self.guard
        loop, brakes = guard.loop(), guard.swings
        command = self.controller.step(self._q, self._v, self._moving, dt, loop, brakes=brakes, now_ns=now_ns)
        answer = self._send(command, state_ns, now_ns, to_state=False)
        self._used = self.controller.pipeline.time_step(dt)
        return answer

    def refuse_state(self, reason: str, stamp_ns: int, now_ns: int) -> Answer | None:
        """Answer a joint state that cannot be used: by the safe torque where the robot was last.

        Parameters
        ----------
        reason
            why it cannot be used
        stamp_ns
            of the state
        now_ns
            now, on the clock of the time-outs

        Returns
        -------
        Answer | None
            None while there was no good state yet
        """
        self._states.refuse(reason)
        return self._rest(stamp_ns, now_ns)

    def miss_state(self, trouble: Callable[[], str]) -> None:
        """Note that a message came that is no whole joint state; `trouble` says what is missing, should none come."""
        self._states.miss(trouble)

    def watch(self, now_ns: int) -> Answer | None:
        """What has to be sent when no joint state came: the safe torque for some time, then nothing."""
        timeout = self.timeouts.joint_state_timeout
        # after a pause of this process others are not silent: their messages are still to be read
        self._paused = not self._paused and now_ns - self._watched_ns > timeout * SECOND
        self._watched_ns = now_ns
        age = self._states.age(now_ns)
        if age is None:
            self.decision = decide(self._inputs(now_ns), self.timeouts)  # by now another joint may be missing
        if self._paused or age is None or age <= timeout:
            return None
        return self._rest(self.stamp_ns, now_ns)

    def release(self, dt: float) -> tuple[TorqueCommand | None, bool]:
        """The next of the last torques before the end.

        They approach the safe torque as fast as the rate limit permits. The robot should be left with that torque: it
        balances gravity where the robot is, so that a robot which keeps the last command for a while
        neither falls nor moves on, and a robot's own watchdog applies the same next.

        Parameters
        ----------
        dt
            since the one before, s

        Returns
        -------
        tuple[TorqueCommand | None, bool]
            the torques, None while there was no good state yet; and whether they are the last ones
        """
        if not self.decision.sends:
            return None, True
        command = self.controller.rest(0.0, dt, loop=self.guard.loop())
        return command, command is None or self.controller.at_rest(command)

    # -- how they work -------------------------------------------------------------------------------------------

    def _rest(self, stamp_ns: int, now_ns: int, is_timed: bool = False) -> Answer | None:
        """The safe torque; time is that of the stamps, as between good states, where this one's is good."""
        inputs = self._inputs(now_ns)
        self.decision = decide(inputs, self.timeouts)
        if not self.decision.sends:
            return None
        dt = self._since_last(stamp_ns if is_timed and self._answered_state else None, now_ns)
        command = self.controller.rest(inputs.state_age or 0.0, dt, loop=self.guard.loop(), now_ns=now_ns)
        return self._send(command, stamp_ns, now_ns, to_state=is_timed)

    def _inputs(self, now_ns: int) -> Inputs:
        reference_age = self._references.age(now_ns)
        stamp, state_stamp = self._references.stamp_ns, self._states.stamp_ns
        if reference_age is not None and stamp is not None and state_stamp is not None:
            # a message that was long on its way is as old as one that came long ago
            reference_age = max(reference_age, 1e-9 * (state_stamp - stamp))
        state_age, trouble = self._states.age(now_ns), ""
        if state_age is None or state_age > self.timeouts.joint_state_timeout:
            trouble = self._states.why_none(self.timeouts, self._max_time_step)
        return Inputs(state_age, self._states.fault, reference_age, self._reference_fault, trouble)

    def _target(self) -> TargetT | None:
        if self.decision.mode is ControllerMode.ACTIVE:
            return self._moving
        if self.decision.mode is not ControllerMode.HOLD or self._reference is None:
            return None
        if self._held is None:
            self._held = self.law.target(self._reference, False)
        return self._held

    def _since_last(self, stamp_ns: int | None, now_ns: int) -> float:
        """Seconds since the last torques: by the stamps where both answer joint states, else by the watching clock."""
        if self._answer is None:
            return 0.0
        if stamp_ns is not None:
            return (stamp_ns - self._answer.stamp_ns) / SECOND
        return (now_ns - self._sent_ns) / SECOND

    def _send(self, command: TorqueCommand | None, stamp_ns: int, now_ns: int, to_state: bool) -> Answer | None:
        if command is None:
            return None
        self._answer, self._answered_state, self._sent_ns = Answer(stamp_ns, command), to_state, now_ns
        self._used = None
        return self._answer
