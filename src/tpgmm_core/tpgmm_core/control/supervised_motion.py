# SPDX-License-Identifier: Apache-2.0
"""`SupervisedMotion`: joint positions that begin where the robot is measured, and what to do when something stops.

Joint states and references come by `take_state` and `take_reference`, each with its stamp; `step` is called at the
rate of the positions and returns what has to be sent, or nothing. It begins with a reference, at the measured joints of
a robot that rests. When references or joint states stop, or the robot does not follow, the joints slow down and stay,
for a while; then nothing is sent any more, and the robot keeps what it was told last. Times are ns: `now_ns` of a clock
that does not jump (steady, or the simulation's), `clock_ns` of the clock of the stamps.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tpgmm_core.common.settings import setting
from tpgmm_core.common.types import Array
from tpgmm_core.control.aim_progress import AimProgress
from tpgmm_core.control.joint_motion import JointMotion, JointStep, MotionConfig
from tpgmm_core.control.motion_aims import Aim
from tpgmm_core.control.motion_lag import HandLag, JointLag, LagLimits, MotionLag
from tpgmm_core.control.state_age import StateAge
from tpgmm_core.control.supervision import ControllerMode
from tpgmm_core.observation.plausible_states import PlausibleStates
from tpgmm_core.observation.streams import (
    RESTARTED_AFTER,
    SECOND,
    Stamp,
    StreamWatch,
    stamps_ahead,
    stamps_behind,
    standing_still,
)
from tpgmm_core.robot.model import RobotModel

#: A robot rests whose joints stay within this much, rad (m), for this long, s.
RESTS_WITHIN, RESTS_FOR = 0.005, 0.1


@dataclass(frozen=True, slots=True, kw_only=True)
class MotionTimeouts(LagLimits):
    """When joint states and references are too old, and when a robot does not follow."""

    joint_state_timeout: float = setting(0.1, 0.002, 10.0, "Age of joint states at which the joints stop, s")
    reference_timeout: float = setting(0.2, 0.002, 10.0, "Age of a reference at which the joints stop, s")
    hold_time: float = setting(
        1.0, 0.0, 600.0, "Time for which positions are sent while the joints hold; then no more are sent, s"
    )
    max_age: float = setting(
        0.2,
        0.0,
        10.0,
        "Joint states with older stamps are refused, s; 0: never, for stamps of a clock that cannot be compared",
    )
    max_future: float = setting(0.05, 0.001, 10.0, "Messages with stamps further in the future are refused, s")


class SupervisedMotion:
    """See the module. `mode` and `reason` say what it does at present, and why.

    Parameters
    ----------
    robot
        to be moved
    endpoint
        whose pose references of poses mean
    joints
        places of the joints that move
    config, timeouts
        how they move, and when they stop
    by_pose
        only poses of the end point are sent: the robot chooses its joints, and these are followed where the pose leaves
        a choice
    """

    def __init__(
        self,
        robot: RobotModel,
        endpoint: str,
        joints: Sequence[int] | NDArray[np.intp],
        config: MotionConfig | None = None,
        timeouts: MotionTimeouts | None = None,
        by_pose: bool = False,
    ) -> None:
        self.robot, self.endpoint = robot, endpoint
        self.motion = JointMotion(robot, joints, config)
        self.lag: MotionLag = HandLag(self.motion, endpoint) if by_pose else JointLag(self.motion)
        self._by_pose = by_pose
        self.timeouts = timeouts or MotionTimeouts()
        self._plausible = PlausibleStates(robot)
        self.start()

    def start(self) -> None:
        """Forget everything: nothing is sent until a reference and the measured joints are there."""
        self._states, self._references = StreamWatch(), StreamWatch()
        self._plausible.start()
        self._state_age = StateAge()
        self._aims: tuple[Aim, ...] = ()
        self._state_fault = self._reference_fault = ""
        self._state_missing: Callable[[], str] | None = None
        self._q = self._anchor = np.zeros(0)
        self.lag.forget()
        self._anchor_ns = self._heard_ns = self._stepped_ns = self._held_ns = 0
        self._moving = False
        self._lost = ""
        self._progress = AimProgress()
        self.mode, self.reason = ControllerMode.WAITING, "no joint state yet"

    def configure(self, config: MotionConfig, timeouts: MotionTimeouts) -> None:
        """Use other parameters, also while it moves."""
        self.motion.configure(config)
        self.timeouts = timeouts

    @property
    def aims(self) -> tuple[Aim, ...]:
        """What the last good reference asks for."""
        return self._aims

    # -- inputs --------------------------------------------------------------------------------------------------------

    def take_reference(self, aims: Sequence[Aim], stamp_ns: int, now_ns: int, clock_ns: int) -> None:
        """Follow aims from now on. Those that are not newer than the last are ignored, and so age.

        Parameters
        ----------
        aims
            of one reference
        stamp_ns
            of the reference
        now_ns, clock_ns
            see the module

        Raises
        ------
        ValueError
            its stamp is in the future; the last good one ages
        """
        timeouts = self.timeouts
        after = max(RESTARTED_AFTER, timeouts.reference_timeout)
        kind = self._references.judge(stamp_ns, now_ns, clock_ns, after, timeouts.max_future)
        if kind in (Stamp.REPEATED, Stamp.OLD):
            return
        if kind is Stamp.FUTURE:
            self.refuse_reference(stamps_ahead(timeouts.max_future))
            raise ValueError(self._reference_fault)
        age = self._references.age(now_ns)
        if age is None or age > timeouts.reference_timeout:  # another movement
            self._lost = ""
            self._progress = AimProgress()
        self._references.accept(stamp_ns, now_ns)
        self._aims, self._reference_fault = tuple(aims), ""

    def refuse_reference(self, reason: str) -> None:
        """Note that a reference came that cannot be used; the last good one ages."""
        self._reference_fault = reason

    def take_state(self, q: Array, stamp_ns: int, now_ns: int, clock_ns: int) -> None:
        """Take measured positions.

        Parameters
        ----------
        q
            (nv,), rad (m)
        stamp_ns
            of the state
        now_ns, clock_ns
            see the module
        """
        timeouts = self.timeouts
        after = max(RESTARTED_AFTER, timeouts.joint_state_timeout)
        kind = self._states.judge(stamp_ns, now_ns, clock_ns, after, timeouts.max_future)
        if kind is Stamp.OLD:
            return
        self.refuse_state(self._why_refused(kind, stamp_ns, clock_ns))
        if self._state_fault:
            return
        if kind is Stamp.RESTARTED:
            self._plausible.forget()
            self._references.forget()
            self._aims = ()
        if leap := self._plausible.leap(q, stamp_ns, self._state_age.period, timeouts.joint_state_timeout):
            self.refuse_state(leap)
            return
        self._plausible.accept(q, stamp_ns)
        self._state_age.take(stamp_ns, clock_ns)
        age = self._states.age(now_ns)
        self._states.accept(stamp_ns, now_ns)
        known = self.motion.q if self._moving else self._q
        self._q = self.robot.unwound(q, known if len(known) else self.robot.home)
        joints = self.motion.joints
        # what has come to a joint meanwhile is nothing that an older measurement could show
        if self._moving:
            self.lag.take(self._q)
        is_new = age is None or age > timeouts.joint_state_timeout
        if is_new or np.abs(self._q - self._anchor)[joints].max() > RESTS_WITHIN:
            self._anchor, self._anchor_ns = self._q, now_ns
        self._heard_ns = now_ns

    def refuse_state(self, reason: str) -> None:
        """Note that a joint state came that cannot be used; the last good one ages."""
        self._state_fault, self._state_missing = reason, None

    def miss_state(self, trouble: Callable[[], str]) -> None:
        """Note that a message came that is no whole joint state; `trouble` says what is missing, should none come."""
        self._state_fault, self._state_missing = "", trouble

    def refuse_motion(self, reason: str) -> None:
        """Note that the robot takes no more of this movement and stops by itself: nothing is sent until the next."""
        self._lost, self._moving = reason, False

    # -- one step ------------------------------------------------------------------------------------------------------

    def step(self, now_ns: int, blocked: str = "") -> JointStep | None:
        """What has to be sent now; None where nothing has.

        Parameters
        ----------
        now_ns
            see the module
        blocked
            why nobody would take what is sent; empty where somebody does

        Returns
        -------
        JointStep | None
            positions and velocities of the joints that move
        """
        dt, known = (now_ns - self._stepped_ns) / SECOND, self._stepped_ns > 0
        self._stepped_ns = now_ns
        if not known or dt <= 0.0:  # the first one, or the clock was set back
            return None
        why = blocked or self._why_not(now_ns)
        if not self._moving:
            if why := why or self._why_not_begun():
                self.mode, self.reason = ControllerMode.WAITING, f"{why}: nothing is sent"
                return None
            self._moving, self._held_ns, self._progress = True, 0, AimProgress()
            self.lag.forget()
        return self._stay(why, dt, now_ns) if why else self._follow(dt)

    def release(self, now_ns: int) -> JointStep | None:
        """The next of the last positions before the end: the joints slow down; None once they rest."""
        dt, self._stepped_ns = (now_ns - self._stepped_ns) / SECOND, now_ns
        if not self._moving or dt <= 0.0:
            return None
        step = self.motion.step((), dt)
        self._moving = not step.at_rest
        self.mode, self.reason = ControllerMode.HOLD, "deactivated: the robot stops"
        return step

    def _follow(self, dt: float) -> JointStep:
        step = self.motion.step(self._aims, dt, self._q, self._by_pose)
        self._held_ns = 0
        self.mode, self.reason = ControllerMode.ACTIVE, "following the reference"
        if words := self._progress.hindered(step, dt):
            self.mode, self.reason = ControllerMode.HOLD, f"cannot follow: {words}"
        return step

    def _stay(self, why: str, dt: float, now_ns: int) -> JointStep | None:
        self._held_ns = self._held_ns or now_ns
        step = self.motion.step((), dt, self._q)
        if not step.at_rest:
            self.mode, self.reason = ControllerMode.HOLD, f"{why}: stops"
            return step
        if now_ns - self._held_ns > self.timeouts.hold_time * SECOND:
            self._moving = False
            self.mode, self.reason = ControllerMode.WAITING, f"{why}: nothing is sent"
            return None
        self.mode, self.reason = ControllerMode.HOLD, f"{why}: holds"
        age = self._states.age(now_ns)
        is_known = age is not None and age <= self.timeouts.joint_state_timeout
        if self._lost and is_known and self._rests and self.lag.largest > RESTS_WITHIN:
            # what it is told is where it is: it does not jump, whenever it is let go
            self.motion.start(self._q)
            self.lag.forget()
            return self.motion.step((), dt, self._q)
        return step

    # -- why not -------------------------------------------------------------------------------------------------------

    def _why_not(self, now_ns: int) -> str:
        """Why the reference cannot be followed at present; empty where it can."""
        timeouts = self.timeouts
        state_age, reference_age = self._states.age(now_ns), self._references.age(now_ns)
        fault = self._state_fault if self._state_missing is None else self._state_missing()
        refused = f" ({fault})" if fault else ""
        if state_age is None:
            return "no joint state yet" + refused
        if state_age > timeouts.joint_state_timeout:
            return f"no new joint state for {timeouts.joint_state_timeout:g} s{refused}"
        self._lost = self.lag.why_lost(timeouts) or self._lost
        if self._lost:
            return f"{self._lost}; it starts again with the next movement"
        refused = f" (the newest was refused: {self._reference_fault})" if self._reference_fault else ""
        if reference_age is None or not self._aims:
            return "no reference yet" + refused
        stamp, state_stamp = self._references.stamp_ns or 0, self._states.stamp_ns or 0
        # a message that was long on its way is as old as one that came long ago
        if max(reference_age, (state_stamp - stamp) / SECOND) > timeouts.reference_timeout:
            return f"no reference for {timeouts.reference_timeout:g} s{refused}"
        return ""

    def _why_not_begun(self) -> str:
        if not self._rests:
            return f"waiting until the robot has been at rest for {RESTS_FOR:g} s"
        try:
            self.motion.start(self._q)
        except ValueError as error:
            return str(error)
        return ""

    @property
    def _rests(self) -> bool:
        """Whether the robot was seen to rest."""
        return self._heard_ns - self._anchor_ns > RESTS_FOR * SECOND

    def _why_refused(self, kind: Stamp, stamp_ns: int, clock_ns: int) -> str:
        timeouts = self.timeouts
        if kind is Stamp.REPEATED:
            return standing_still(stamp_ns)
        if kind is Stamp.FUTURE:
            return stamps_ahead(timeouts.max_future)
        if timeouts.max_age > 0.0 and clock_ns > 0 and clock_ns - stamp_ns > timeouts.max_age * SECOND:
            return stamps_behind(stamp_ns, clock_ns, timeouts.max_age)
        return ""
