# SPDX-License-Identifier: Apache-2.0
"""Where a bag is cut into demonstrations: by the edits beside it, else by the rule of the task file."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import assert_never

import numpy as np

from tpgmm_core.observation.takes import Take, takes_between_rests, takes_by_signal
from tpgmm_ros.recordings.bag_messages import BagError
from tpgmm_ros.recordings.bag_streams import MOVEMENT, BagStreams
from tpgmm_ros.recordings.edits import SUFFIX, Edits
from tpgmm_ros.recordings.numeric_fields import read_numbers
from tpgmm_ros.task.takes_section import UNTIL_NEXT, StillTakes, TakesRule, TopicTakes

LATE_S = 1.0
"""Edits that end later after the movement may be in another unit, or of another bag."""


@dataclass(frozen=True, slots=True)
class Cut:
    """One demonstration of a bag.

    Attributes
    ----------
    begin_s, end_s
        its first and last time, s from the first sample of the bag's movement
    take
        its number, from 1; 0: the bag is not cut into takes
    note
        what was cut, in words; none where it is the whole bag
    """

    begin_s: float
    end_s: float
    take: int = 0
    note: str = ""


def cuts_of(streams: BagStreams, rule: TakesRule | None, edits: Edits) -> list[Cut]:
    """Where the demonstrations of a bag are.

    `from` and `to` of the edits say what of the bag is looked at at all; takes are searched within that.

    Parameters
    ----------
    streams
        of the bag
    rule
        of the task file; edits that have takes count instead
    edits
        of the bag

    Returns
    -------
    list[Cut]
        one or more, in the order of time

    Raises
    ------
    BagError
        the edits name times that the bag has not got, or no take is found.
    """
    name, duration = f"{streams.path.name}{SUFFIX}", streams.duration_s
    begin, end = edits.begin_s, min(edits.end_s, duration)
    times = streams.seconds
    inside = (times >= begin) & (times <= end)
    if not inside.any():
        why = f"its edits begin at {begin:g} s, and its movement ends after {duration:.2f} s"
        if begin <= duration:
            why = f"its edits keep {begin:g} to {end:g} s, and its movement has no sample there"
        raise BagError(streams.path, f"{why}: correct {name}")
    if edits.takes is None and rule is None:
        if edits.without:
            raise BagError(streams.path, f"its edits leave out some of its takes, and it has none: correct {name}")
        said = "" if inside.all() else f"cut to {begin:.2f} to {end:.2f} s of {duration:.2f} s, as its edits say"
        return [Cut(begin, end, note="; ".join(filter(None, (said, _beyond(edits.end_s, duration)))))]
    if isinstance(edits.takes, tuple):
        takes, how = list(edits.takes), "as its edits say"
        if takes[-1][0] > duration:
            raise BagError(
                streams.path,
                f"its edits have a take from {takes[-1][0]:g} s on, and its movement ends after {duration:.2f} s: "
                f"correct {name}",
            )
        if outside := [take for take in takes if take[1] <= begin or take[0] >= end]:
            raise BagError(
                streams.path,
                f"its edits have a take from {outside[0][0]:g} to {outside[0][1]:g} s, outside of what they keep by "
                f"from and to, {begin:g} to {end:.2f} s: correct {name}",
            )
        how = "; ".join(filter(None, (how, _beyond(takes[-1][1], duration))))
        takes = [(max(first, begin), min(last, end)) for first, last in takes]
    else:
        found = edits.takes or rule
        assert found is not None
        takes, how = _found(streams, found, (float(times[inside][0]), float(times[inside][-1])))
    if max(edits.without, default=0) > len(takes):
        raise BagError(
            streams.path, f"its edits leave out take {max(edits.without)}, and there are {len(takes)}: correct {name}"
        )
    return [
        Cut(first, last, number, f"take {number} of {len(takes)}: {first:.2f} to {last:.2f} s, {how}")
        for number, (first, last) in enumerate(takes, 1)
        if number not in edits.without
    ]


def _beyond(end_s: float, duration_s: float) -> str:
    """What is said of edits that go on after the end of the movement, in words; nothing where they do not."""
    if not duration_s + LATE_S < end_s < math.inf:
        return ""
    return f"they name {end_s:g} s as an end, and the movement ends after {duration_s:.2f} s: are these seconds?"


def _found(streams: BagStreams, rule: TakesRule, span: Take) -> tuple[list[Take], str]:
    """Takes by a rule within a span of the time, and how they were found, in words."""
    times = streams.seconds
    if isinstance(rule, StillTakes):
        kept = (times >= span[0]) & (times <= span[1])
        takes = takes_between_rests(times[kept], streams.values[MOVEMENT][kept], rule.rest, rule.shortest)
        how = f"between pauses of {rule.rest.pause:g} s"
        if takes == [(float(times[kept][0]), float(times[kept][-1]))]:
            how = f"all of it, as there is no pause of {rule.rest.pause:g} s"
        if not takes:
            raise BagError(
                streams.path,
                f"no take is found in it: the hand never moves for {rule.shortest:g} s out of {1e3 * rule.rest.way:g} "
                f"mm and {rule.rest.turn:g} rad. Change still, way, turn or shortest, or name the times in its edits",
            )
    elif isinstance(rule, TopicTakes):
        recorded, values = read_numbers(streams.path, rule.topic, rule.field)
        at = streams.seconds_of(recorded)
        order = np.argsort(at, kind="stable")
        takes = takes_by_signal(
            at[order], rule.holds(values[order]), span, rule.lasts == UNTIL_NEXT, rule.pause, rule.shortest
        )
        how = f"where {rule}"
        if not takes:
            raise BagError(
                streams.path,
                f"no take is found in it: {rule} for {rule.shortest:g} s nowhere during the movement; its values are "
                f"from {values.min():g} to {values.max():g}. Correct takes, or name the times in its edits",
            )
    else:
        assert_never(rule)
    return takes[:: rule.every], how
