# SPDX-License-Identifier: Apache-2.0
"""How a bag is cut into several demonstrations, as task files and edits of bags name it.

{still: 1.0}                                        # between pauses of the hand of 1 s
{still: 1.0, every: 2}                              # every second movement: those between lead the hand back
{topic: recording}                                  # as long as a std_msgs/Bool is true
{topic: gripper/width, below: 0.03}                 # as long as a number is below, or above, a value
{topic: joint_states, field: "position[finger]", above: 0.03, lasts: until_next}
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from tpgmm_core.common.yaml_sections import Section
from tpgmm_core.common.yaml_values import a_choice, a_number, an_integer
from tpgmm_core.observation.takes import Rest
from tpgmm_ros.task.signals import SIGNAL_KEYS, TopicSignal, read_signal

WHILE, UNTIL_NEXT = "while", "until_next"
SHORTEST_PAUSE_S = 0.05
"""In less, no hand comes to rest, and a recording would be looked at in endlessly many parts."""


@dataclass(frozen=True, slots=True)
class StillTakes:
    """Takes are what is between pauses of the hand.

    Attributes
    ----------
    rest
        what a pause is
    shortest
        movements that take less time are none, s
    every
        each n-th counts, from the first
    """

    rest: Rest
    shortest: float = 0.5
    every: int = 1


@dataclass(frozen=True, slots=True)
class TopicTakes(TopicSignal):
    """Takes are told by a topic: where its signal holds.

    Attributes
    ----------
    lasts
        as long as it holds (while), or until it begins to hold again (until_next)
    pause
        where it does not hold for less time, that is overlooked, s
    shortest
        takes that last less are none, s
    every
        each n-th counts, from the first
    """

    lasts: str = WHILE
    pause: float = 0.0
    shortest: float = 0.5
    every: int = 1


type TakesRule = StillTakes | TopicTakes


def read_takes(section: Section) -> TakesRule:
    """The rule that a part of a file names.

    Parameters
    ----------
    section
        with `still` or `topic`

    Returns
    -------
    TakesRule
        the rule

    Raises
    ------
    YamlError
        the part does not describe one.
    """
    if len(section.values.keys() & {"still", "topic"}) != 1:
        raise section.error(
            "needs exactly one of 'still' (cut where the hand rests for this many seconds) and 'topic' (cut by its "
            "messages)"
        )
    common = {
        key: section.required(key, read)
        for key, read in {"shortest": a_number(0.0), "every": an_integer(1)}.items()
        if key in section.values
    }
    if "still" in section.values:
        section.refuse_others("still", "way", "turn", "shortest", "every")
        return StillTakes(
            Rest(
                section.required("still", _a_pause),
                **{key: section.required(key, _above_0) for key in ("way", "turn") if key in section.values},
            ),
            **common,
        )
    section.refuse_others(*SIGNAL_KEYS, "lasts", "pause", "shortest", "every")
    values = {
        key: section.required(key, read)
        for key, read in {"lasts": a_choice(WHILE, UNTIL_NEXT), "pause": a_number(0.0)}.items()
        if key in section.values
    }
    return TopicTakes(**read_signal(section), **values, **common)


def _above_0(value: Any) -> float:
    number = a_number(0.0)(value)
    if number == 0.0:
        raise ValueError("a finite number above 0")
    return number


def _a_pause(value: Any) -> float:
    try:
        return a_number(SHORTEST_PAUSE_S)(value)
    except ValueError:
        raise ValueError(f"a pause of at least {SHORTEST_PAUSE_S:g} s, such as 1.0") from None
