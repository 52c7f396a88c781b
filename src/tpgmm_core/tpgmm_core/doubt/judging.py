# SPDX-License-Identifier: Apache-2.0
"""All doubts about recordings that are to be learned from together."""

from __future__ import annotations

from collections.abc import Callable, Sequence

from tpgmm_core.doubt.agreement import doubts_of_copies, doubts_of_durations, doubts_of_misfits
from tpgmm_core.doubt.cameras import doubts_of_cameras
from tpgmm_core.doubt.doubts import Doubt, RawDemonstration
from tpgmm_core.doubt.frames import doubts_of_frames_on_the_hand, doubts_of_inverse_poses, doubts_of_swaps
from tpgmm_core.doubt.groups import doubts_of_groups
from tpgmm_core.doubt.quaternion_order import doubts_of_quaternion_order
from tpgmm_core.doubt.rests import doubts_of_frozen_hands, doubts_of_rests
from tpgmm_core.doubt.values import (
    doubts_of_rounding,
    doubts_of_speed,
    doubts_of_stillness,
    doubts_of_turns_taken,
    doubts_of_units,
)


def judged_alone(one: RawDemonstration) -> list[Doubt]:
    """What makes no sense in one recording, whatever the others are; it takes all samples."""
    rounded = doubts_of_rounding(one)  # steps pass for leaps and for rests
    moves = rounded or [*doubts_of_speed(one), *doubts_of_turns_taken(one), *doubts_of_frozen_hands(one)]
    return [*moves, *doubts_of_stillness(one), *doubts_of_swaps(one)]


def judged(
    shown: Sequence[RawDemonstration], alone: Callable[[RawDemonstration], Sequence[Doubt]] = judged_alone
) -> list[Doubt]:
    """What makes no sense in recordings of one task.

    Parameters
    ----------
    shown
        one or more
    alone
        what makes no sense in each by itself: where outlines are judged, what was found before

    Returns
    -------
    list[Doubt]
        those that refuse first; how demonstrations agree is not judged where their units are mixed
    """
    units = doubts_of_units(shown)
    if any(doubt.refuses for doubt in units):
        return units
    rests = doubts_of_rests(shown)
    single = [doubt for one in shown for doubt in alone(one)]
    inverse = doubts_of_inverse_poses(shown)
    return [
        *units,
        *single,
        *doubts_of_quaternion_order(shown),
        *(inverse or doubts_of_cameras(shown)),
        *doubts_of_frames_on_the_hand(shown),
        *rests,
        *doubts_of_copies(shown),
        *doubts_of_durations(shown),
        *doubts_of_misfits(shown),
        *([] if rests else doubts_of_groups(shown)),
    ]
