# SPDX-License-Identifier: Apache-2.0
"""`PlausibleStates`: joint states of which each number is possible, and which still cannot be right.

- **Positions that leap.** No joint gets further than `REACH` times its speed limit allows. An encoder that loses its
  count does, a bit that tips over, a second robot on the same topic. A state that leaps is left out; those that go on
  where the last good one was are used, and at the beginning those of which more come. If only states of another place
  come, that place may be the right one or not, and nobody here can know: they are refused until joint states have
  paused, as they do where a driver is started again, or the controller is activated again.
- **Velocities that are not the change of the positions**: in degrees, of the other sign, always zero, of an encoder
  that hangs. Damping would push instead of brake, or be absent. Both changes are compared over the last second.
  Such states are refused, also at rest, where nothing shows the fault, until a motion has shown that velocities fit.
"""

from __future__ import annotations

import math

import numpy as np

from tpgmm_core.common.types import Array
from tpgmm_core.geometry.kernels import compiled, is_finite
from tpgmm_core.observation.streams import SECOND
from tpgmm_core.robot.model import RobotModel

#: Joints get no further than this many times their speed limit allows, and a margin, rad (m). Limits that were lowered
#: bind the controller only: a person may lead a joint faster than this, rad/s (m/s).
REACH, REACH_MARGIN, LED = 3.0, 0.02, 1.0
#: After so many states of one place another one does not take over, however many follow.
ESTABLISHED = 10
#: Stamps of a driver jitter by less than this many periods.
JITTER = 2.0
#: Changes of positions are compared with velocities over this time, s, ...
COMPARED = 1.0
#: ... differ by at most so much, rad (m), this share of the larger one, and what a filter adds that is so late, s; ...
DIFFERENCE, SHARE, FILTER = 0.07, 0.3, 0.05
#: ... and after a motion of this length, rad (m), velocities are known to fit.
SHOWN = 0.2
#: Leaps are told for this long, s.
TOLD = 1.0


@compiled
def farthest(q: Array, known: Array, time: float, speed_limits: Array) -> tuple[int, float]:
    """The joint that has gone farthest, in shares of what it can.

    Parameters
    ----------
    q, known
        (n,), positions, and those before
    time
        for which joints can have moved, s
    speed_limits
        (n,), of the joints

    Returns
    -------
    tuple[int, float]
        the joint, and the share; above 1 it cannot have got there
    """
    worst, share = 0, 0.0
    for i in range(len(q)):
        of_joint = abs(q[i] - known[i]) / (REACH * max(speed_limits[i], LED) * time + REACH_MARGIN)
        if of_joint > share:
            worst, share = i, of_joint
    return worst, share


@compiled
def compare(
    change: Array, v: Array, before: Array, dt: float, speed_limits: Array, changes: Array, believed: Array
) -> int:
    """Update what positions and velocities say of the last second, and which joints' velocities are believed.

    Parameters
    ----------
    change
        (n,), of the positions
    v, before
        (n,), velocities now and at the last state
    dt
        since the last state, s
    speed_limits
        (n,), of the joints
    changes
        (3, n), by the positions and by the velocities, and the largest velocity, updated in place
    believed
        (n,), 1 or 0, updated in place

    Returns
    -------
    int
        the joint where they differ most, or -1 where all fit
    """
    kept = math.exp(-dt / COMPARED)
    worst, largest_excess = -1, 0.0
    for i in range(len(change)):
        if not is_finite(change[i] + v[i] + before[i]):
            continue
        most = REACH * max(speed_limits[i], LED)
        mean = 0.5 * (v[i] + before[i])
        if max(abs(v[i]), abs(before[i])) > most:  # beyond reach the smaller one counts: a single absurd one is nothing
            mean = math.copysign(min(abs(v[i]), abs(before[i]), most), v[i]) if v[i] * before[i] > 0.0 else 0.0
        by_velocity = dt * mean
        changes[0, i] = kept * (changes[0, i] + change[i])
        changes[1, i] = kept * (changes[1, i] + by_velocity)
        changes[2, i] = max(kept * changes[2, i], min(abs(mean), speed_limits[i]))
        of_positions, of_velocities = abs(changes[0, i]), abs(changes[1, i])
        difference = abs(changes[0, i] - changes[1, i]) - SHARE * max(of_positions, of_velocities)
        excess = difference - DIFFERENCE - FILTER * changes[2, i]
        if excess > 0.0:
            believed[i] = 0.0
        elif difference < 0.0 and min(of_positions, of_velocities) > SHOWN:
            believed[i] = 1.0
        if excess > largest_excess:
            worst, largest_excess = i, excess
    return worst


class PlausibleStates:
    """See the module.

    Parameters
    ----------
    robot
        whose states they are
    """

    def __init__(self, robot: RobotModel) -> None:
        self._robot, self._names, self._units = robot, robot.joint_names, robot.joint_units
        self._limits = robot.velocity_limits
        self._changes, self._believed = np.zeros((3, robot.nv)), np.ones(robot.nv)
        self.start()
        zeros = np.zeros(robot.nv)  # compiles
        farthest(zeros, zeros, 0.0, self._limits)
        compare(zeros, zeros, zeros, 0.0, self._limits, self._changes, self._believed)

    def start(self) -> None:
        """Begin anew: the next state is believed, and its velocities are."""
        self._leaps, self._leapt = 0, ""
        self._fault = ""
        self._believed[:] = 1.0
        self.forget()

    def forget(self) -> None:
        """Believe the next state, wherever it is: states have paused. Velocities that did not fit stay unbelieved."""
        self._known: Array | None = None
        self._other: Array | None = None
        self._speeds: Array | None = None
        self._known_ns = self._other_ns = 0
        self._known_count = self._other_count = 0
        self._changes[:] = 0.0

    def leap(self, q: Array, stamp_ns: int, period: float, pause: float) -> str:
        """Why a state cannot be one of this robot, by its positions.

        Parameters
        ----------
        q
            (nv,), positions
        stamp_ns
            of the state
        period
            from one state to the next as a rule, s
        pause
            after this time without any state, whatever it was, the next one is believed, s

        Returns
        -------
        str
            in words; empty where it can be
        """
        if self._known is None or stamp_ns - max(self._known_ns, self._other_ns) > pause * SECOND:
            self.forget()
            return ""
        if q.shape != self._known.shape:
            return ""
        q = self._robot.unwound(q, self._known)
        time = max((stamp_ns - self._known_ns) / SECOND, JITTER * period)
        joint, share = farthest(q, self._known, time, self._limits)
        of_other = math.inf
        if self._other is not None and stamp_ns - self._other_ns <= pause * SECOND:
            _, of_other = farthest(q, self._other, time, self._limits)
        if share <= min(1.0, of_other):  # of two places that it may belong to, the nearer one
            return ""
        is_another = of_other > 1.0  # a leap of its own, not one of those that go on where another one led
        self._other_count = 1 if is_another else self._other_count + 1
        if self._known_count < min(ESTABLISHED, self._other_count):  # the first one was none of this robot
            self.forget()
            return ""
        self._other, self._other_ns = q.copy(), stamp_ns
        self._leaps += 1
        if is_another:
            unit = self._units[joint]
            self._leapt = (
                f"{self._names[joint]} leapt by {abs(float(q[joint] - self._known[joint])):.2g} {unit} within "
                f"{(stamp_ns - self._known_ns) / SECOND:.2g} s, and moves at {self._limits[joint]:.2g} {unit}/s "
                "at most: check its encoder, and whether another robot publishes on this topic; if the robot is where "
                "it says, deactivate and activate this node"
            )
        return self._leapt

    def accept(self, q: Array, stamp_ns: int, v: Array | None = None) -> str:
        """Take a state that has not leapt.

        Parameters
        ----------
        q
            as for `leap`
        stamp_ns
            of the state
        v
            (nv,), velocities; None: not used

        Returns
        -------
        str
            why the velocities cannot be right, in words; empty where they can
        """
        if q.shape != self._robot.home.shape or v is not None and v.shape != q.shape:
            return self._fault
        if self._known is not None:
            q = self._robot.unwound(q, self._known)
        if self._known is not None and self._speeds is not None and v is not None:
            dt = (stamp_ns - self._known_ns) / SECOND
            joint = compare(q - self._known, v, self._speeds, dt, self._limits, self._changes, self._believed)
            if joint >= 0:
                by_positions, by_velocities, _ = self._changes[:, joint]
                unit = self._units[joint]
                self._fault = (
                    f"velocities contradict positions: within {COMPARED:g} s {self._names[joint]} has moved by "
                    f"{by_positions:.2g} {unit}, by its velocities by {by_velocities:.2g} {unit}: let the driver "
                    f"publish velocities in {unit}/s. They are used again when they fit during a motion, or after the "
                    "next activation"
                )
            elif self._believed.all():
                self._fault = ""
        self._known, self._known_ns = q.copy(), stamp_ns
        self._known_count += 1
        self._speeds = None if v is None else v.copy()
        return self._fault

    def told(self, stamp_ns: int) -> list[str]:
        """What was left out within the last second before a stamp, ns, in words; nothing where nothing was."""
        if not self._leaps or stamp_ns - self._other_ns > TOLD * SECOND:
            return []
        return [f"{self._leaps} joint states were left out: {self._leapt}"]
