# SPDX-License-Identifier: Apache-2.0
"""Which clock tells when the messages of a recording were true, and what is wrong with its clocks.

A message has two times: its header's stamp, and when the recorder received it. Stamps are better, where all topics are
stamped by one clock; the recorder's times are of one clock, but late by what the way took. Steps of a clock show only
in the order of writing: sorted by time, what came before a step back lies among what came after it.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from tpgmm_core.common.types import Nanoseconds
from tpgmm_core.doubt.doubts import Doubt
from tpgmm_core.doubt.stamps import (
    DISORDER_S,
    ENOUGH,
    SLOW_LATENCY_S,
    TopicTimes,
    breaks,
    has_lag,
    is_sane,
    problem_of_stamps,
    tell_nothing,
)

WHOLE = 0.9
"""The longest part of a recording is all of the movement where it has this share of the messages."""
LATENCY_S = 0.25
"""Perception may take so long, or a little more than its own period: stamps tell when a picture was taken."""
STEADY_S = 0.05
STEADY = 0.02
"""A lag is steady where it varies by less than this time, or this share of itself."""
EARLY_S = 0.5
"""A topic whose messages go on later than this stood, until then, where it was last."""


class ClockError(ValueError):
    """Times of a recording that cannot be told."""


@dataclass(frozen=True, slots=True, eq=False)
class CommonClock:
    """When each message was true, on one clock.

    Attributes
    ----------
    kept
        key → numbers (S,) of the messages that are taken, in the order of their times
    times
        key → times (S,) of these, ns, never decreasing
    by_recorder
        whether the times are the recorder's
    notes
        what was put right, in words
    doubts
        what makes no sense
    """

    kept: Mapping[str, NDArray[np.intp]]
    times: Mapping[str, Nanoseconds]
    by_recorder: bool
    notes: tuple[str, ...] = ()
    doubts: tuple[Doubt, ...] = field(default=())


def common_clock(movement: TopicTimes, others: Sequence[TopicTimes]) -> CommonClock:
    """Find the clock of a recording.

    Parameters
    ----------
    movement
        times of what moves; all else is wanted at its times
    others
        times of the other topics

    Returns
    -------
    CommonClock
        which messages are taken, at which times

    Raises
    ------
    ClockError
        the clock steps in the middle of the movement, or a topic lags by what is not steady
    """
    streams = [movement, *others]
    kept = {stream.key: _whole_part(stream, stream is movement) for stream in streams}
    doubts = []
    left_out = len(movement.recorded) - len(kept[movement.key])
    if left_out:
        doubts.append(Doubt("clock", (), _told(movement, kept[movement.key], left_out)))
        begin, end = movement.recorded[kept[movement.key][[0, -1]]]
        for stream in others:
            kept[stream.key] = _within(stream, begin, end)
    streams = [stream.taken(kept[stream.key]) for stream in streams]
    problem = problem_of_stamps(streams)
    if len(streams[0].recorded) > 1 and problem and not np.ptp(streams[0].recorded):
        raise ClockError(
            f"{problem}, and the recorder's times are the same in all {len(streams[0].recorded)} messages: nothing "
            "tells when they were; did all wait for a clock (use_sim_time without /clock)? Record it again"
        )
    if problem:
        times = {stream.key: stream.recorded for stream in streams}
        notes = [f"{problem}: the recorder's times are used instead"]
    else:
        times = {stream.key: stream.stamps for stream in streams}
        notes = []
        for stream in streams[1:]:
            lag = _lag(streams[0], stream)
            if lag is not None:
                corrected, doubt = _judged(streams[0], stream, lag)
                doubts.append(doubt)
                times[stream.key] = stream.stamps + corrected
    order = {key: np.argsort(series, kind="stable") for key, series in times.items()}
    return CommonClock(
        {key: kept[key][order[key]] for key in times},
        {key: times[key][order[key]] for key in times},
        problem is not None,
        tuple(notes),
        tuple(doubts),
    )


def _whole_part(stream: TopicTimes, moves: bool) -> NDArray[np.intp]:
    """Numbers of the messages in the part of a stream that the clock's steps leave whole."""
    everything = np.arange(len(stream.recorded))
    at = breaks(stream.recorded)
    if not len(at) or not moves:
        return everything
    if is_sane(stream.stamps) and not len(breaks(stream.stamps)):
        return everything  # only the recorder's clock steps, which nobody needs then
    parts = np.split(everything, at)
    longest = max(parts, key=len)
    if len(longest) < WHOLE * len(everything):
        k = int(at[0])
        step, begun = (1e-9 * float(stream.recorded[k] - stream.recorded[i]) for i in (k - 1, 0))
        alike = step > 0.0 and abs(1e-9 * float(stream.stamps[k] - stream.stamps[k - 1]) - step) < LATENCY_S
        paused = ", or the recording was paused, as its stamps say the same, and" if alike else ", and"
        raise ClockError(
            f"the clock steps by {step:+.2f} s before message {k} of {stream.name}, {begun - step:.2f} s after the "
            f"first{paused} the time between the parts is unknown; keep clocks synchronised and record it again, or "
            "select the part before or after the step in the edits of the bag (from, to, takes)"
        )
    return longest


def _told(movement: TopicTimes, kept: NDArray[np.intp], left_out: int) -> str:
    count, first = len(movement.recorded), int(kept[0])
    where = f"the first {left_out}" if first == left_out else f"{left_out}"
    if first and (movement.recorded[:first] <= 0).all():
        why = "were recorded at time 0, before simulated time was available"
    else:
        k = int(breaks(movement.recorded)[0])
        step = 1e-9 * (movement.recorded[k] - movement.recorded[k - 1])
        why = f"are separated from the others by a step of the clock of {step:+.1f} s"
    return f"{where} of {count} messages of {movement.name} {why}: left out"


def _within(stream: TopicTimes, begin: int, end: int) -> NDArray[np.intp]:
    """Messages of another topic that go with a part of the movement; the last one before it stands for what it was."""
    if not len(breaks(stream.recorded)) and (stream.recorded > 0).all():
        return np.arange(len(stream.recorded))
    margin = int(1e9 * DISORDER_S)
    inside = (stream.recorded >= begin - margin) & (stream.recorded <= end + margin)
    if not inside.any():
        return np.arange(len(stream.recorded))
    first = int(np.flatnonzero(inside)[0])
    if first and stream.recorded[first] > begin + int(1e9 * EARLY_S):
        inside[first - 1] = True
    return np.flatnonzero(inside)


def _lag(movement: TopicTimes, stream: TopicTimes) -> NDArray[np.float64] | None:
    """How much later a topic's messages are than their stamps say, compared with the movement's, (T,) s."""
    if not has_lag(stream) or tell_nothing(movement) or tell_nothing(stream):
        return None
    order = np.argsort(movement.recorded, kind="stable")
    known = movement.recorded[order]
    reference = np.interp(stream.recorded, known, (movement.recorded - movement.stamps)[order])
    lag = 1e-9 * (stream.recorded - stream.stamps - reference)
    period = 1e-9 * float(np.median(np.diff(stream.stamps)))
    low, high = np.quantile(lag, (0.05, 0.95))
    return None if abs(np.median(lag)) <= max(LATENCY_S, 1.2 * period) and high - low < SLOW_LATENCY_S else lag


def _judged(movement: TopicTimes, stream: TopicTimes, lag: NDArray[np.float64]) -> tuple[int, Doubt]:
    """What is to be added to the stamps, ns, and what is said."""
    middle, low, high = float(np.median(lag)), *np.quantile(lag, (0.05, 0.95))
    said = f"{stream.name} is stamped {-middle:+.2f} s away from {movement.name}, compared with the recorder's times"
    if high - low <= max(STEADY_S, STEADY * abs(middle)):
        text = (
            f"{said}, by a constant time: its clock differs, which was corrected; synchronise the clocks (NTP, chrony)"
        )
        return round(1e9 * middle), Doubt("lag", (), text)
    if -LATENCY_S <= low and high <= SLOW_LATENCY_S:
        return 0, Doubt("lag", (), f"{said}, by a varying time ({low:.2f} to {high:.2f} s): taken as slow perception")
    raise ClockError(
        f"{said}, by a varying time ({-high:+.2f} to {-low:+.2f} s): its clock steps or drifts, so the true times of "
        "its messages are unknown; synchronise the clocks (NTP, chrony), and record it again"
    )


def gaps(times: Nanoseconds, longest_s: float, periods: float) -> list[tuple[float, float]]:
    """Pauses of a topic: when they begin, s after its first message, and how long they are, s.

    Parameters
    ----------
    times
        (T,) of a topic's messages, ns, never decreasing
    longest_s, periods
        a pause is longer than both: this time, and so many of the topic's periods

    Returns
    -------
    list[tuple[float, float]]
        the longest first
    """
    if len(times) < ENOUGH:
        return []
    seconds = 1e-9 * np.diff(times)
    limit = max(longest_s, periods * float(np.median(seconds)))
    found = [(1e-9 * float(times[k] - times[0]), float(seconds[k])) for k in np.flatnonzero(seconds > limit)]
    return sorted(found, key=lambda gap: -gap[1])
