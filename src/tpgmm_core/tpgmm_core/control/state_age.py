# SPDX-License-Identifier: Apache-2.0
"""`StateAge`: how late torques answer what the joints do, from the stamps of joint states; time is an argument.

The delay of the loop is the age of a state when it is answered, the time until the next answer, and the time from
a torque's message to the motor. The estimate grows at once and falls slowly: jitter counts with its late part, one late
message hardly.
"""

from __future__ import annotations

import math

from tpgmm_core.observation.streams import SECOND

#: Time constants, s, with which the age grows and is forgotten; a pause counts as no more than `LONGEST_STEP`.
GROWS, FORGOTTEN, LONGEST_STEP = 0.02, 1.0, 0.005
#: Weight of a single interval between two states in the usual one.
OF_ONE_PERIOD = 0.05
#: An interval longer than this many usual ones is a pause.
PAUSE = 3.0
#: A delay that only swings have shown is forgotten with this time constant, s.
SUSPICION_TIME = 30.0
#: No delay is suspected beyond this, s.
MOST_SUSPECTED = 0.1


class StateAge:
    """See the module.

    Attributes
    ----------
    age
        of the newest state by its stamp, s; None where the clock of the stamps is not known
    usual
        age of recent states, weighed towards the oldest ones, s
    period
        from one state to the next, s
    suspected
        a delay that no stamp shows but swings did, s
    """

    def __init__(self) -> None:
        self.forget()

    def forget(self) -> None:
        """Start without any state."""
        self.age: float | None = None
        self.usual = self.period = self.suspected = 0.0
        self._stamp_ns: int | None = None

    def take(self, stamp_ns: int, clock_ns: int, of_another_clock: bool = False) -> None:
        """Observe a new state.

        Parameters
        ----------
        stamp_ns
            of the state
        clock_ns
            now, on the clock of the stamps; 0 while it is not known
        of_another_clock
            whether that clock is never known
        """
        step = 0.0 if self._stamp_ns is None else max(0.0, (stamp_ns - self._stamp_ns) / SECOND)
        self._stamp_ns = stamp_ns
        self.age = None if of_another_clock or clock_ns <= 0 else max(0.0, (clock_ns - stamp_ns) / SECOND)
        if step > 0.0:
            # a pause is no period: it counts as a few of them, so that a slower rate is found after some states
            usual = min(step, PAUSE * self.period) if self.period > 0.0 else min(step, LONGEST_STEP)
            self.period += (usual - self.period) * (OF_ONE_PERIOD if self.period > 0.0 else 1.0)
            self.suspected *= math.exp(-step / SUSPICION_TIME)
        if self.age is not None:
            time = GROWS if self.age > self.usual else FORGOTTEN
            self.usual += (self.age - self.usual) * (1.0 - math.exp(-min(step, LONGEST_STEP) / time))

    def suspect(self, delay: float) -> None:
        """Note that swings show a delay (s) that may be in no stamp; the second time in a row, a longer one."""
        self.suspected = min(MOST_SUSPECTED, max(delay, 2.0 * self.suspected))

    def delay(self, actuation_delay: float) -> float:
        """Delay of the loop, s; actuation_delay is the time from a torque's message to the motor, s."""
        return max(self.usual, self.suspected) + self.period + actuation_delay
