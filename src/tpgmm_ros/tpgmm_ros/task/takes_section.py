# SPDX-License-Identifier: Apache-2.0
"""How a bag is cut into several demonstrations, as task files and edits of bags name it.

{still: 1.0}                                        # between pauses of the hand of 1 s
{still: 1.0, every: 2}                              # every second movement: those between lead the hand back
{topic: recording}                                  # as long as a std_msgs/Bool is true
{topic: gripper/width, below: 0.03}                 # as long as a number is below, or above, a value
{topic: joint_states, field: "position[finger]", above: 0.03, lasts: until_next}
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tpgmm_core.common.types import Array
from tpgmm_core.common.yaml_sections import Section
from tpgmm_core.common.yaml_values import a_choice, a_number, a_topic, an_integer
from tpgmm_core.observation.takes import Rest

WHILE, UNTIL_NEXT = "while", "until_next"
_FIELD = re.compile(r"[A-Za-z]\w*(\[[^\[\]]+\])?(\.[A-Za-z]\w*(\[[^\[\]]+\])?)*")


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
class TopicTakes:
    """Takes are told by a topic.

    Attributes
    ----------
    topic
        relative name
    field
        of its messages, a number or a truth value
    bound
        it counts where it is above this
    is_below
        or below it
    lasts
        as long as it counts (while), or until it begins to count again (until_next)
    pause
        where it does not count for less time, that is overlooked, s
    shortest
        takes that last less are none, s
    every
        each n-th counts, from the first
    """

    topic: str
    field: str = "data"
    bound: float = 0.5
    is_below: bool = False
    lasts: str = WHILE
    pause: float = 0.0
    shortest: float = 0.5
    every: int = 1

    def holds(self, values: Array) -> NDArray[np.bool_]:
        """Where numbers (T,) count."""
        return values < self.bound if self.is_below else values > self.bound

    def __str__(self) -> str:
        return f"{self.field} of {self.topic} is {'below' if self.is_below else 'above'} {self.bound:g}"


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
        names = {"still": "pause", "way": "way", "turn": "turn"}
        return StillTakes(
            Rest(**{n: section.required(k, _above_0) for k, n in names.items() if k in section.values}), **common
        )
    section.refuse_others("topic", "field", "above", "below", "lasts", "pause", "shortest", "every")
    if {"above", "below"} <= section.values.keys():
        raise section.error("has 'above' and 'below': give only one of them")
    values = {
        name: section.required(key, read)
        for key, (name, read) in {
            "field": ("field", _a_field),
            "above": ("bound", a_number()),
            "below": ("bound", a_number()),
            "lasts": ("lasts", a_choice(WHILE, UNTIL_NEXT)),
            "pause": ("pause", a_number(0.0)),
        }.items()
        if key in section.values
    }
    return TopicTakes(section.required("topic", a_topic), is_below="below" in section.values, **values, **common)


def _above_0(value: Any) -> float:
    number = a_number(0.0)(value)
    if number == 0.0:
        raise ValueError("a finite number above 0")
    return number


def _a_field(value: Any) -> str:
    if not isinstance(value, str) or _FIELD.fullmatch(value) is None:
        raise ValueError(
            'a field of a message, such as data, wrench.force.z, "position[0]" or "position[finger_joint]"'
        )
    return value
