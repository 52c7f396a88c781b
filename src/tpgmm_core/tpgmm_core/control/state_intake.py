# SPDX-License-Identifier: Apache-2.0
"""`StateIntake`: which joint states a controller answers, and in words why it does not answer the others.

A state counts by its stamp (`streams`), by its age, and by its values (`plausible_states`). Times are those of
`supervised_controller`.
"""

from __future__ import annotations

import enum
from collections.abc import Callable

from tpgmm_core.common.types import Array
from tpgmm_core.control.supervision import Timeouts, slow_states
from tpgmm_core.observation.plausible_states import PlausibleStates
from tpgmm_core.observation.streams import (
    SECOND,
    RateMeter,
    Stamp,
    StreamWatch,
    stamps_ahead,
    stamps_behind,
    standing_still,
)
from tpgmm_core.robot.model import RobotModel


class Intake(enum.Enum):
    """What a joint state is for a controller."""

    NEW = enum.auto()
    RESTARTED = enum.auto()  # the first one after time has jumped backwards
    REPEATED = enum.auto()  # its answer may have been lost
    IGNORED = enum.auto()  # overtaken, or of another robot
    REFUSED = enum.auto()  # a fault, and its stamp may be one too
    WRONG = enum.auto()  # a fault of its values alone: its stamp is good


class StateIntake:
    """See the module.

    Parameters
    ----------
    robot
        whose states they are

    Attributes
    ----------
    fault
        why the newest state was refused; empty when it was good
    """

    def __init__(self, robot: RobotModel) -> None:
        self._plausible = PlausibleStates(robot)
        self.start()

    def start(self) -> None:
        """Forget everything."""
        self._stream, self._rate = StreamWatch(), RateMeter()
        self._plausible.start()
        self._trouble: Callable[[], str] = str
        self.fault = ""

    @property
    def stamp_ns(self) -> int | None:
        """Stamp of the last good state, ns; None before the first."""
        return self._stream.stamp_ns

    def age(self, now_ns: int) -> float | None:
        """Time since the last good state came, s; None before the first."""
        return self._stream.age(now_ns)

    def is_stale(self, now_ns: int, timeouts: Timeouts) -> bool:
        """Whether the last good state is older than it may be."""
        age = self.age(now_ns)
        return age is not None and age > timeouts.joint_state_timeout

    def judge(
        self, q: Array, v: Array, stamp_ns: int, now_ns: int, clock_ns: int, timeouts: Timeouts, period: float
    ) -> Intake:
        """Judge a state; one that is new, or restarted, is the last good one from now on.

        Parameters
        ----------
        q, v
            (nv,), positions and velocities
        stamp_ns
            of the state
        now_ns, clock_ns
            when it came, see the module
        timeouts
            what is too old
        period
            from one state to the next as a rule, s

        Returns
        -------
        Intake
            what is to be done with it; `fault` says why it is refused
        """
        kind = self._stream.judge(stamp_ns, now_ns, clock_ns, timeouts.joint_state_timeout, timeouts.max_future)
        if kind is Stamp.FUTURE:
            return self.refuse(stamps_ahead(timeouts.max_future))
        if kind is Stamp.OLD:
            return Intake.IGNORED
        if kind is Stamp.REPEATED:
            self._trouble = lambda: standing_still(stamp_ns)
            return Intake.REPEATED
        if timeouts.max_age > 0.0 and clock_ns > 0 and clock_ns - stamp_ns > timeouts.max_age * SECOND:
            return self.refuse(stamps_behind(stamp_ns, clock_ns, timeouts.max_age))
        if kind is Stamp.RESTARTED:
            self._plausible.forget()
        if leap := self._plausible.leap(q, stamp_ns, period, timeouts.joint_state_timeout):
            self._trouble = lambda: leap
            if not self.is_stale(now_ns, timeouts):
                return Intake.IGNORED
            self.fault = leap
            return Intake.WRONG
        if fault := self._plausible.accept(q, stamp_ns, v):
            self.fault = fault
            return Intake.WRONG
        self._stream.accept(stamp_ns, now_ns)
        self._rate.add(stamp_ns)
        self.fault, self._trouble = "", str
        return Intake.RESTARTED if kind is Stamp.RESTARTED else Intake.NEW

    def refuse(self, reason: str) -> Intake:
        """Note that a state came that cannot be used."""
        self.fault = reason
        return Intake.REFUSED

    def miss(self, trouble: Callable[[], str]) -> None:
        """Note that a message came that is no whole state; `trouble` says what is missing, should none come."""
        self._trouble = trouble

    def why_none(self, timeouts: Timeouts, max_time_step: float) -> str:
        """Why no new state comes, in words; empty where nothing is known."""
        return self._trouble() or "; ".join(self._slow(timeouts, max_time_step))

    def doubts(self, timeouts: Timeouts, max_time_step: float) -> list[str]:
        """What is wrong with states that are answered nevertheless, in words."""
        return self._slow(timeouts, max_time_step) + self._plausible.told(self.stamp_ns or 0)

    def _slow(self, timeouts: Timeouts, max_time_step: float) -> list[str]:
        """What has to be set for states that are as slow as measured, in words."""
        period = self._rate.period()
        return [] if period is None else slow_states(period, "measured", timeouts, max_time_step)
