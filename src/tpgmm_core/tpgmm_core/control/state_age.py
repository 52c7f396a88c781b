# SPDX-License-Identifier: Apache-2.0
"""`StateAge`: how late torques answer what the joints do, from the stamps of joint states; time is an argument.

The delay of the loop is the age of a state when it is answered, the time until the next answer, and what lies between
a torque's message and the motor. It grows at once and is forgotten slowly: jitter counts with its late part, one late
message hardly.
"""

from __future__ import annotations

import math

from tpgmm_core.observation.streams import SECOND

#: Time constants, s, with which the age grows and is forgotten; a pause counts as no more than `LONGEST_STEP`.
GROWS, FORGOTTEN, LONGEST_STEP = 0.02, 1.0, 0.005
#: Share of a single time between two states in what is taken for the usual one.
OF_ONE_PERIOD = 0.05
#: What is longer than so many usual ones is a pause.
PAUSE = 3.0
#: What swings alone gave away is forgotten with this time constant, s.
SUSPICION_TIME = 30.0
#: No delay is suspected beyond this, s.
MOST_SUSPECTED = 0.1


class StateAge:
    """See the module.

    age : s, of the newest state by its stamp; None where the clock of the stamps is not known
    usual : s, of the states of late, rather the oldest ones
    period : s, from one state to the next
    suspected : s, a delay that no stamp tells of, but swings did
    """

    def __init__(self) -> None:
        self.forget()

    def forget(self) -> None:
        """No state yet."""
        self.age: float | None = None
        self.usual = self.period = self.suspected = 0.0
        self._stamp_ns: int | None = None

    def take(self, stamp_ns: int, clock_ns: int, of_another_clock: bool = False) -> None:
        """A new state. clock_ns : of the clock of the stamps, 0 while it is not known; of_another_clock : nor ever."""
        step = 0.0 if self._stamp_ns is None else max(0.0, (stamp_ns - self._stamp_ns) / SECOND)
        self._stamp_ns = stamp_ns
        self.age = None if of_another_clock or clock_ns <= 0 else max(0.0, (clock_ns - stamp_ns) / SECOND)
        if step > 0.0:
            # a pause is no period: it counts as a few of them, so that a slower rate is still found within some states
            usual = min(step, PAUSE * self.period) if self.period > 0.0 else min(step, LONGEST_STEP)
            self.period += (usual - self.period) * (OF_ONE_PERIOD if self.period > 0.0 else 1.0)
            self.suspected *= math.exp(-step / SUSPICION_TIME)
        if self.age is not None:
            time = GROWS if self.age > self.usual else FORGOTTEN
            self.usual += (self.age - self.usual) * (1.0 - math.exp(-min(step, LONGEST_STEP) / time))

    def suspect(self, delay: float) -> None:
        """Swings tell of a delay (s) that may be in no stamp; twice in a row, of more."""
        self.suspected = min(MOST_SUSPECTED, max(delay, 2.0 * self.suspected))

    def delay(self, actuation_delay: float) -> float:
        """How late the loop is, s, with what lies between a torque's message and the motor (s)."""
        return max(self.usual, self.suspected) + self.period + actuation_delay
