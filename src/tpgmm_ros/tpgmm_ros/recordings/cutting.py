# SPDX-License-Identifier: Apache-2.0
"""Where a bag is cut into demonstrations: by the edits beside it, else by the rule of the task file."""

from __future__ import annotations

from dataclasses import dataclass
from typing import assert_never

import numpy as np

from tpgmm_core.observation.takes import Take, takes_between_rests, takes_by_signal
from tpgmm_ros.recordings.bag_messages import BagError
from tpgmm_ros.recordings.bag_streams import MOVEMENT, BagStreams
from tpgmm_ros.recordings.edits import SUFFIX, Edits
from tpgmm_ros.recordings.numeric_fields import read_numbers
from tpgmm_ros.task.takes_section import UNTIL_NEXT, StillTakes, TakesRule, TopicTakes


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
        raise BagError(
            streams.path,
            f"its edits begin at {begin:g} s, and its movement ends after {duration:.2f} s: correct {name}",
        )
    if edits.takes is None and rule is None:
        if edits.without:
            raise BagError(streams.path, f"its edits leave out some of its takes, and it has none: correct {name}")
        whole = bool(inside.all())
        said = "" if whole else f"cut to {begin:.2f} to {end:.2f} s of {duration:.2f} s, as its edits say"
        return [Cut(begin, end, note=said)]
    if isinstance(edits.takes, tuple):
        takes, how = list(edits.takes), "as its edits say"
        if takes[-1][0] > duration:
            raise BagError(
                streams.path,
                f"its edits have a take from {takes[-1][0]:g} s on, and its movement ends after {duration:.2f} s: "
                f"correct {name}",
            )
        takes = [(max(first, begin), min(last, end)) for first, last in takes if last > begin and first < end]
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


def _found(streams: BagStreams, rule: TakesRule, span: Take) -> tuple[list[Take], str]:
    """Takes by a rule within a span of the time, and how they were found, in words."""
    times = streams.seconds
    if isinstance(rule, StillTakes):
        kept = (times >= span[0]) & (times <= span[1])
        takes = takes_between_rests(times[kept], streams.values[MOVEMENT][kept], rule.rest, rule.shortest)
        how = f"between pauses of {rule.rest.pause:g} s"
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
