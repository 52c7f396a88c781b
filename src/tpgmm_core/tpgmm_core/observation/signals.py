# SPDX-License-Identifier: Apache-2.0
"""`SignalWatch`: whether what a signal has said last still holds; time is an argument.

Some drivers publish a signal only when it changes: the last message holds, however old it is. Others repeat it all the
time: where such a one is silent, it has stopped, and what it said last says nothing of the present.
"""

from __future__ import annotations

import math

from tpgmm_core.observation.streams import SECOND

#: A signal that comes all the time makes no longer pauses, s.
PAUSE = 1.0
#: It comes all the time if it has said the same for so long without such a pause, s. What is published only on change
#: says something else each time, or comes for as long as a gripper moves.
STEADY = 5.0


class SignalWatch:
    """Hears one signal, and learns whether it comes all the time."""

    def __init__(self) -> None:
        self._value: bool | None = None
        self._since_ns = self._heard_ns = 0
        self._is_steady = False

    def hear(self, value: bool, now_ns: int) -> None:
        """Take what it says, at a time of a clock that does not jump, ns."""
        if value != self._value or self.age(now_ns) > PAUSE:
            self._value, self._since_ns = value, now_ns
        self._heard_ns = now_ns
        self._is_steady |= now_ns - self._since_ns >= STEADY * SECOND

    def age(self, now_ns: int) -> float:
        """Time since it has said something, s."""
        return math.inf if self._value is None else (now_ns - self._heard_ns) / SECOND

    def has_ceased(self, now_ns: int) -> bool:
        """Whether it has come all the time before, and does no more."""
        return self._is_steady and self.age(now_ns) > PAUSE
