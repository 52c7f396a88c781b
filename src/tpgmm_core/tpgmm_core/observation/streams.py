# SPDX-License-Identifier: Apache-2.0
"""Streams of stamped messages: which of them are new, how often they come, and whose they are; time is an argument.

All that follow a stream use this: controllers, reproductions, whatever answers joint states. A message that was
overtaken on its way, or that comes twice, is neither new nor a fault; only time that has jumped back for good is a
restart.
"""

from __future__ import annotations

import enum
import math
from collections.abc import Sequence

import numpy as np

SECOND = 1_000_000_000
#: A clock that is behind a message by no more than this is only late; by more, it has jumped back, s.
OVERTAKEN = 0.05
#: When stamps are older for this long, time has jumped back, s. It is longer than stamps may be ahead.
RESTARTED_AFTER = 0.25
#: A period that differs by a larger share is another one.
CHANGED = 0.1
#: Up to this share of the period after a message, the next one is not near.
BETWEEN = 0.9
#: A step between two messages takes at most this share of the period: who is slower has no time for it.
AFFORDED = 0.2


class Stamp(enum.Enum):
    """The relation of a message's stamp to the last one and to the clock."""

    NEW = enum.auto()
    REPEATED = enum.auto()  # the stamp of the last message: nothing new, however often it comes
    OLD = enum.auto()  # overtaken by a newer one on its way
    FUTURE = enum.auto()
    RESTARTED = enum.auto()  # older, after all newer ones have become stale: time has jumped backwards


class StreamWatch:
    """Distinguishes new messages of one stream from all others, and knows how old the last one is.

    Times in ns: stamps, `now_ns` of the clock that watches (steady), `clock_ns` of the clock of the stamps.
    """

    def __init__(self) -> None:
        self.forget()

    def forget(self) -> None:
        """Start without any message."""
        self.stamp_ns: int | None = None
        self._received_ns = 0

    def age(self, now_ns: int) -> float | None:
        """Seconds since the last message came; None without one, infinite where the clock itself jumped backwards."""
        if self.stamp_ns is None:
            return None
        age = 1e-9 * (now_ns - self._received_ns)
        return max(0.0, age) if age >= -OVERTAKEN else math.inf

    def judge(self, stamp_ns: int, now_ns: int, clock_ns: int, timeout: float, max_future: float) -> Stamp:
        """Classify a message by its stamp; it counts as the last one only if it is then accepted.

        Parameters
        ----------
        stamp_ns
            of the message
        now_ns
            of its arrival
        clock_ns
            now, on the clock of the stamps; 0 while that clock is not known, so that no stamp is in the future
        timeout
            after which the last message is stale, s. Only then an older stamp means a clock that jumped
        max_future
            how far a stamp may be ahead of `clock_ns`, s

        Returns
        -------
        Stamp
            how its stamp relates to the last one and to the clock
        """
        if clock_ns > 0 and stamp_ns - clock_ns > max_future * SECOND:
            return Stamp.FUTURE
        age = self.age(now_ns)
        if self.stamp_ns is None or age is None or stamp_ns > self.stamp_ns:
            return Stamp.NEW
        if stamp_ns == self.stamp_ns:
            return Stamp.REPEATED
        return Stamp.RESTARTED if age > timeout else Stamp.OLD

    def accept(self, stamp_ns: int, now_ns: int) -> None:
        """Count a message as the last one."""
        self.stamp_ns, self._received_ns = stamp_ns, now_ns


class ClockWatch:
    """Notices that the clock of stamps is set back: all that was stamped before seems newer than what comes then."""

    def __init__(self) -> None:
        self._now_ns = 0

    def was_set_back(self, now_ns: int) -> bool:
        """Whether it is earlier now, ns, than it was when this was asked last; to be asked regularly."""
        former, self._now_ns = self._now_ns, now_ns
        return now_ns < former - OVERTAKEN * SECOND


def standing_still(stamp_ns: int) -> str:
    """Words for a stream that goes on while its stamps do not."""
    return f"their stamps stay at {stamp_ns / SECOND:.3f} s: the driver must stamp each message with its own time"


def stamps_ahead(max_future: float) -> str:
    """Words for a stream whose stamps are further in the future than `max_future`, s."""
    return f"its stamp is more than {max_future:g} s ahead of this machine's clock; synchronise the clocks"


def stamps_behind(stamp_ns: int, clock_ns: int, max_age: float) -> str:
    """Words for a stream whose stamps are too old.

    Parameters
    ----------
    stamp_ns
        of a message
    clock_ns
        this machine's clock
    max_age
        how far the stamp may be behind it, s

    Returns
    -------
    str
        how far it is behind, and what to do
    """
    if stamp_ns == 0:
        return (
            "its stamp is 0: let the driver stamp its messages, or set max_age to 0 to accept them without a known age"
        )
    return (
        f"its stamp is {(clock_ns - stamp_ns) / SECOND:.3g} s behind this machine's clock, more than max_age "
        f"({max_age:g} s): the message is too old, or the clocks differ; synchronise them, or set max_age to 0 "
        "to accept it without a known age"
    )


class RateMeter:
    """How often a stream's messages come: the median of their last intervals, so that pauses and jitter do not matter.

    Parameters
    ----------
    size
        number of intervals that are remembered
    enough
        number of them that a measurement needs
    """

    def __init__(self, size: int = 64, enough: int = 16) -> None:
        self._intervals = np.zeros(size, dtype=np.int64)
        self._enough = enough
        self.forget()

    def forget(self) -> None:
        """Start without any message."""
        self._last_ns: int | None = None
        self._count = 0
        self._period: float | None = None

    def add(self, time_ns: int) -> None:
        """Add a message, by its stamp or its arrival, ns; one that is not after the last one starts anew."""
        if self._last_ns is not None and 0 < time_ns - self._last_ns < 100 * SECOND:
            self._intervals[self._count % len(self._intervals)] = time_ns - self._last_ns
            self._count += 1
        self._last_ns = time_ns

    def measured(self) -> float | None:
        """Seconds from one message to the next; None while too few have come."""
        if self._count < self._enough:
            return None
        return float(np.median(self._intervals[: min(self._count, len(self._intervals))])) / SECOND

    def period(self) -> float | None:
        """The measured period; it keeps its former value as long as that is nearly right.

        So sentences about it do not change all the time.

        Returns
        -------
        float | None
            s; None while it is not known
        """
        measured = self.measured()
        if measured is None:
            return None
        if self._period is None or abs(measured - self._period) > CHANGED * self._period:
            self._period = measured
        return self._period


class Leader:
    """Of several publishers on one topic, the one whose messages are used as a clock, recognised by the names in them.

    For programs that use joint states as a clock and know no joint: a gripper's few joints must not trigger steps
    between the arm's many. The leader is the publisher with most joints, and among equals the first one, until it has
    been silent for a while.

    Parameters
    ----------
    patience
        silence after which a publisher no longer leads, s
    """

    def __init__(self, patience: float = 0.5) -> None:
        self._patience_ns = round(patience * SECOND)
        self._names: list[str] | None = None
        self._heard_ns = 0

    def is_led_by(self, names: Sequence[str], now_ns: int) -> bool:
        """Whether a message with these names triggers a step; `now_ns` is of a clock that does not jump."""
        names = list(names)
        if names != self._names:
            silent = now_ns - self._heard_ns > self._patience_ns
            if self._names is not None and len(names) <= len(self._names) and not silent:
                return False
            self._names = names
        self._heard_ns = now_ns
        return True


class Beat:
    """The times at which somebody who follows a stream makes a step: with each message, and now and then between two.

    Attributes
    ----------
    step_ns : int
        Time of the last step, ns; no two steps have the same, and it never goes back, unless the stream does.
    """

    def __init__(self) -> None:
        self._interval_ns = self._period_ns = self._stamp_ns = self._received_ns = self.step_ns = 0

    def take(self, stamp_ns: int, now_ns: int, restarted: bool = False) -> bool:
        """Whether a message calls for a step.

        Parameters
        ----------
        stamp_ns : int
            Of the message, ns.
        now_ns : int
            When it came, by a clock that does not jump, ns.
        restarted : bool
            Whether time has jumped backwards.

        Returns
        -------
        bool
            False where messages come irregularly, and a step between two of them was for a later time than this one.
        """
        former, self._interval_ns = self._interval_ns, stamp_ns - self._stamp_ns if self._stamp_ns else 0
        self._period_ns = min(former, self._interval_ns)  # a pause is no period
        self._stamp_ns, self._received_ns = stamp_ns, now_ns
        if not restarted and stamp_ns <= self.step_ns:
            return False
        self.step_ns = stamp_ns
        return True

    def between(self, now_ns: int, cost: float = 0.0) -> int | None:
        """The time of a step that is made now, on the clock of the stamps.

        Parameters
        ----------
        now_ns : int
            By the clock of `take`, ns.
        cost : float
            How long the last step took, s.

        Returns
        -------
        int or None
            ns; None where the next message is near (by the shorter one of the last two intervals), where such a step
            would take too long, before the third message, and where there was a step for this time already.
        """
        elapsed = now_ns - self._received_ns
        if not 0 < elapsed < BETWEEN * self._period_ns or cost * SECOND > AFFORDED * self._period_ns:
            return None
        if self._stamp_ns + elapsed <= self.step_ns:
            return None
        self.step_ns = self._stamp_ns + elapsed
        return self.step_ns
