# SPDX-License-Identifier: Apache-2.0
"""`LoopGuard`: whether a valid reference can be followed: in time, without oscillation, and at all.

It knows how late the loop is (`state_age`), notices oscillation (`oscillation`) and whether the robot gets to its
reference (`following`), and changes a decision to follow where one of them forbids it: with the reason, and the
condition for following again.

- **Late states.** Laws lower their gains to what the delay permits (`delay_margin`). Below `LEAST_SHARE` of their rates
  nothing useful is left: DAMPING, until the delay has been well below that for a second, or references have stopped.
- **Swings.** DAMPING until all joints have been calm for a second; then it follows with gains that are stable with a
  delay of a quarter of the swing's period, which is the delay that makes damping swing like this. After half a minute
  the gains are the usual ones again. After the third swing it does not try again before the next activation. Where a
  joint can hardly hold the robot's weight, that is given as the cause.
- **Held.** HOLD: a robot that feels that somebody holds its hand is soft until it is let go of (`yielding`), and then
  comes back as a hindered one does.
- **Hindered.** HOLD: pulled by no more than a few centimetres, so that nothing jumps when the obstacle goes; ACTIVE
  again once the robot is near its reference.
"""

from __future__ import annotations

import math

import numpy as np

from tpgmm_core.common.types import Array
from tpgmm_core.control.control_law import LawTorques, Loop
from tpgmm_core.control.controller import TorqueCommand
from tpgmm_core.control.delay_margin import DELAY_SAFETY
from tpgmm_core.control.following import ProgressWatch
from tpgmm_core.control.oscillation import SwingWatch
from tpgmm_core.control.state_age import StateAge
from tpgmm_core.control.supervision import ControllerMode, Decision, Timeouts
from tpgmm_core.control.yielding import YieldConfig, Yielding
from tpgmm_core.robot.model import RobotModel

#: Gains slower than this share of those for the reference cannot follow it: K_P is 1/25 of theirs.
LEAST_SHARE = 0.2
#: It tries again when the delay has been below this share of the longest stable one for this long, s.
RETRY, RETRY_TIME = 0.75, 1.0
#: After this many alarms it does not try again.
MOST_ALARMS = 3
#: The sentence about the share of the gains is renewed when it has changed by this factor.
TOLD_FACTOR = 1.1
#: A share above this is not worth a sentence.
NEARLY_ALL = 0.95
#: A joint that needs more than this share of its effort to hold the robot's weight has too little left for control.
OVERBURDENED = 0.8


class LoopGuard:
    """See the module.

    Parameters
    ----------
    robot
        that is controlled
    timeouts
        of its inputs
    yields
        when it yields to somebody who holds the hand
    closed_elsewhere
        see `Controller`: the delay of this loop then does not matter to the robot's own feedback

    Attributes
    ----------
    age
        how late states are
    share
        of the gains' rates that is left; 1 without reference
    tolerated
        the age of states (s) with which all gains are stable; infinite without reference
    yielding
        to somebody who holds the hand
    """

    def __init__(
        self,
        robot: RobotModel,
        timeouts: Timeouts,
        yields: YieldConfig | None = None,
        closed_elsewhere: bool = False,
    ) -> None:
        self._robot, self.timeouts, self._closed_elsewhere = robot, timeouts, closed_elsewhere
        self.age = StateAge()
        self._swings, self._progress = SwingWatch(robot.velocity_limits), ProgressWatch(robot)
        self.yielding = Yielding(yields or YieldConfig())
        self.forget()

    def forget(self) -> None:
        """Start anew."""
        self.age.forget()
        self._swings.forget()
        self._progress.forget()
        self.yielding.forget()
        self.share, self.tolerated = 1.0, math.inf
        self._swung, self._alarms, self._burden = "", 0, ""
        self._late, self._longest, self._in_time = "", math.inf, 0.0
        self._told, self._words, self._told_delay = 1.0, "", 0.0

    @property
    def delay(self) -> float:
        """Delay of the loop, s."""
        return 0.0 if self._closed_elsewhere else self.age.delay(self.timeouts.actuation_delay)

    @property
    def swings(self) -> bool:
        """Whether an oscillation has to be damped, whatever references say."""
        return bool(self._swung)

    def loop(self) -> Loop:
        """What the next torques have to take into account."""
        hindered = bool(self._progress.reason) or self.yielding.is_held
        return Loop(self.age.age or 0.0, self.delay, hindered, self.yielding.share)

    def judge(self, decision: Decision) -> Decision:
        """Change a decision that was made from the inputs alone, where the loop requires it."""
        follows = decision.mode in (ControllerMode.ACTIVE, ControllerMode.HOLD)
        if self._swung and self._alarms < MOST_ALARMS and self._swings.calm:
            self._swung = ""
        if self._swung and (follows or decision.mode is ControllerMode.DAMPING):
            return Decision(ControllerMode.DAMPING, self._swung, decision.sends)
        if not follows:
            self._late = ""
            self._progress.forget()
            return decision
        if self._late:
            return Decision(ControllerMode.DAMPING, self._late, decision.sends)
        if hindrance := self.yielding.reason or self._progress.reason:
            return Decision(ControllerMode.HOLD, hindrance, decision.sends)
        return Decision(decision.mode, decision.reason + self._words + self.yielding.words, decision.sends)

    def after(self, command: TorqueCommand, mode: ControllerMode, dt: float) -> None:
        """Observe torques that were sent.

        Parameters
        ----------
        command
            the torques
        mode
            in which they were sent
        dt
            since the last ones, s
        """
        self.yielding.step(dt)
        asked = command.law
        follows = mode in (ControllerMode.ACTIVE, ControllerMode.HOLD)
        moves, wanted = (0.0, 0.0) if asked is None else (asked.moves, asked.asked)
        if self._swings.step(command.v, moves, wanted, dt) and (follows or self._swung):
            self._alarm(follows, command)
        if asked is None:
            return
        self._judge_delay(asked, follows, dt)
        if follows:
            self._progress.step(command.q, command.tau, asked, dt, self.yielding.is_held)

    def _alarm(self, follows: bool, command: TorqueCommand) -> None:
        swings, robot = self._swings, self._robot
        self._burden = burden(robot, command.q)
        cause = self._burden or "states or torques late, or gains too high for the robot's inertia"
        self._alarms += follows
        self.age.suspect(0.5 * swings.half_period)
        unit = robot.joint_units[swings.joint]
        self._swung = (
            f"{robot.joint_names[swings.joint]} oscillates and does not settle ({swings.speed:.2g} {unit}/s, period "
            f"{2e3 * swings.half_period:.0f} ms): {cause}; "
        )
        again = (
            "for the third time: it stays off until the controller is activated again"
            if self._alarms >= MOST_ALARMS
            else "it continues with lower gains once the robot is at rest"
        )
        self._swung += again

    def _judge_delay(self, asked: LawTorques, follows: bool, dt: float) -> None:
        delay = self.delay
        if follows:
            self.share = asked.share
            self.tolerated = asked.delay_margin / DELAY_SAFETY - self.age.period - self.timeouts.actuation_delay
        elif not self._late:
            self.share, self.tolerated = 1.0, math.inf
        if self._late:
            self._in_time = self._in_time + dt if delay < RETRY * self._longest else 0.0
            if self._in_time >= RETRY_TIME:
                self._late = ""
            elif not self._told_delay / TOLD_FACTOR < delay < self._told_delay * TOLD_FACTOR:
                self._late = self._words_of_late(delay)
        elif follows and asked.share < LEAST_SHARE and asked.blend > 0.0:
            self._in_time, self._longest = 0.0, asked.delay_margin / (DELAY_SAFETY * LEAST_SHARE)
            self._late = self._words_of_late(delay)
        if asked.share > NEARLY_ALL:
            self._told, self._words = 1.0, ""
        elif not self._told / TOLD_FACTOR < asked.share < self._told * TOLD_FACTOR:
            self._told = asked.share
            self._words = (
                f", with lower gains: K_P is {asked.share**2:.2g} of its usual value, because {self._lateness()}"
            )

    def _words_of_late(self, delay: float) -> str:
        self._told_delay = delay
        if self._burden and self.age.suspected > self.age.usual:
            return f"{self._lateness()}; with gains low enough to be stable, it cannot follow the reference"
        return (
            f"{self._lateness()}, the loop is {1e3 * delay:.0f} ms late in total; the gains are stable up to "
            f"{1e3 * LEAST_SHARE * self._longest:.0f} ms, the softest usable ones up to "
            f"{1e3 * self._longest:.0f} ms"
        )

    def _lateness(self) -> str:
        if self.age.suspected > self.age.usual:
            late = f"it oscillated as if torques arrived {1e3 * self.age.suspected:.0f} ms late"
            return f"it oscillated where {self._burden}" if self._burden else late
        if self.age.age is None:
            return f"joint states come every {1e3 * self.age.period:.0f} ms"
        return (
            f"joint states are {1e3 * self.age.usual:.0f} ms old according to their stamps, and come every "
            f"{1e3 * self.age.period:.0f} ms"
        )


def burden(robot: RobotModel, q: Array) -> str:
    """The joint that has hardly any effort left beside holding the robot's weight, in words.

    Parameters
    ----------
    robot
        the robot
    q
        (nv,), positions

    Returns
    -------
    str
        empty where each has enough
    """
    gravity = np.abs(robot.create_data().gravity(q))
    i = int(np.argmax(gravity - OVERBURDENED * robot.effort_limits))
    if gravity[i] <= OVERBURDENED * robot.effort_limits[i]:
        return ""
    unit = "N" if robot.joint_units[i] == "m" else "N m"
    weight = f"{gravity[i]:.0f} of its {robot.effort_limits[i]:.0f} {unit} to hold the robot's weight"
    return f"{robot.joint_names[i]} needs {weight}, which leaves too little to control it"
