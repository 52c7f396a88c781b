# SPDX-License-Identifier: Apache-2.0
"""Times of the messages of one topic, and what forbids to use its header stamps."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tpgmm_core.common.types import Nanoseconds

DISORDER_S = 0.05
"""Messages that were written in another order than they came by no more than this have only overtaken one another."""
LEAP_S = 10.0
LEAP_PERIODS = 200.0
"""A pause longer than both is a leap of the clock, or a recording that was interrupted."""
SLOW_LATENCY_S = 1.0
"""No perception of a moving object takes longer."""
ENOUGH = 5
"""Messages that a rate or a lag needs."""
COARSE = 3.0
"""Messages to a stamp: where there are more, stamps are rounded, and no longer tell the messages apart."""
PACE = 50.0
"""No simulation is so many times as fast, or as slow, as the clock of the recorder."""
SHORTEST_S, LONGEST_S = 2e-4, 0.5
"""Periods of what moves; what is beyond has stamps in another unit."""
SECOND_NS = 1_000_000_000
FRACTIONS = {"ms": 1_000, "us": 1_000_000}
"""How many of them a second has: parts of a second in ns, of a topic that comes at any time, are soon more."""
SEVERAL = 3
"""Messages in a second from which on their parts of a second tell that."""


@dataclass(frozen=True, slots=True, eq=False)
class TopicTimes:
    """Times of the messages of a topic in the order of writing.

    Attributes
    ----------
    key
        name of what is told of, since several things may be on one topic
    name
        of the topic
    stamps, recorded
        (T,) header stamps, and times of the recorder, ns
    """

    key: str
    name: str
    stamps: Nanoseconds
    recorded: Nanoseconds

    def taken(self, which: NDArray[np.intp]) -> TopicTimes:
        """Some of the messages."""
        return TopicTimes(self.key, self.name, self.stamps[which], self.recorded[which])


def breaks(times: Nanoseconds) -> NDArray[np.intp]:
    """Numbers of the messages at times (T,), ns, before which the clock steps back, begins, or leaps."""
    seconds = 1e-9 * np.diff(times)
    period = float(np.median(seconds[seconds > 0.0])) if (seconds > 0.0).any() else 0.0
    begins = (times[:-1] <= 0) & (seconds > max(10.0 * period, 0.5))
    leaps = seconds > max(LEAP_S, LEAP_PERIODS * period)
    return np.flatnonzero((seconds < -DISORDER_S) | begins | leaps) + 1


def is_sane(stamps: Nanoseconds) -> bool:
    """Whether stamps (T,) are there, never decrease, and change."""
    return bool((stamps > 0).all() and (np.diff(stamps) >= 0).all() and stamps[0] != stamps[-1])


def problem_of_stamps(streams: Sequence[TopicTimes]) -> str | None:
    """What forbids to use the header stamps of a recording, or None."""
    movement = streams[0]
    if movement.stamps[0] == movement.stamps[-1]:
        return f"{movement.name} has stamps that never change"
    for stream in streams:
        if (stream.stamps <= 0).any():
            return f"{stream.name} has stamps {'before 1970' if (stream.stamps < 0).any() else 'of zero'}"
        if (np.diff(stream.stamps) < 0).any():
            return f"{stream.name} has stamps that run backwards"
        if unit := _unit_of_fractions(stream):
            return f"{stream.name} has stamps whose field for nanoseconds counts {unit}"
    seconds, recorded = (1e-9 * float(series[-1] - series[0]) for series in (movement.stamps, movement.recorded))
    period, pace = seconds / len(movement.stamps), seconds / max(recorded, 1e-9)
    if (period > LONGEST_S and pace > PACE) or (period < SHORTEST_S and pace < 1.0 / PACE):
        return (
            f"{movement.name} has stamps that run {pace:.3g} times as fast as the recorder's clock, as where ms or us "
            "are written as s, or the reverse"
        )
    stamps, times = (len(np.unique(series)) for series in (movement.stamps, movement.recorded))
    if times > COARSE * stamps:
        return f"{movement.name} has the same stamp in {times / stamps:.0f} messages one after another, as if rounded"
    if len(breaks(movement.stamps)) and not len(breaks(movement.recorded)):
        return f"{movement.name} has stamps that jump"
    for stream in streams[1:]:
        if not has_lag(stream):
            ahead = 1e-9 * (np.median(stream.stamps - stream.recorded) - np.median(movement.stamps - movement.recorded))
            if not -3600.0 < ahead < SLOW_LATENCY_S:
                return f"{stream.name} is stamped {ahead:+.1f} s away from {movement.name}"
    return None


def _unit_of_fractions(stream: TopicTimes) -> str:
    """In what the parts of a second are written, where they are no ns; empty: in ns."""
    fractions, whole = stream.stamps % SECOND_NS, len(np.unique(stream.stamps // SECOND_NS))
    comes_at_any_time = np.ptp(stream.recorded % SECOND_NS) > SECOND_NS // 2 and len(fractions) >= SEVERAL * whole
    if whole < 2 or not comes_at_any_time or len(np.unique(fractions)) < ENOUGH:
        return ""
    return next((unit for unit, count in FRACTIONS.items() if fractions.max() < count), "")


def tell_nothing(stream: TopicTimes) -> bool:
    """Whether the recorder's times are those of a conversion, at which all was written at once, not of the messages."""
    return bool(np.ptp(stream.recorded) * PACE < np.ptp(stream.stamps))


def has_lag(stream: TopicTimes) -> bool:
    """Whether a topic came all the time: one that was sent once may be as old as it is."""
    return len(np.unique(stream.stamps)) >= max(ENOUGH, len(stream.stamps) // 2)
