# SPDX-License-Identifier: Apache-2.0
"""Signals: whether a number of a topic is above or below a value; the same words wherever files name one.

{topic: recording}                                                    # a std_msgs/Bool is true
{topic: gripper/width, below: 0.03}
{topic: joint_states, field: "position[finger]", below: 0.03}
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tpgmm_core.common.types import Array
from tpgmm_core.common.yaml_sections import Section
from tpgmm_core.common.yaml_values import a_number, a_topic

SIGNAL_KEYS = ("topic", "field", "above", "below")
_FIELD = re.compile(r"[A-Za-z]\w*(\[[^\[\]]+\])?(\.[A-Za-z]\w*(\[[^\[\]]+\])?)*")
_TYPE = re.compile(r"([a-z]\w*)/(?:msg/)?([A-Z]\w*)")


@dataclass(frozen=True, slots=True)
class TopicSignal:
    """Holds where a number is above or below a value.

    Attributes
    ----------
    topic
        relative name
    field
        of its messages, a number or a truth value
    bound
        it holds where the number is above this
    is_below
        or below it
    """

    topic: str
    field: str = "data"
    bound: float = 0.5
    is_below: bool = False

    def holds(self, values: Array | float) -> NDArray[np.bool_]:
        """Where it holds for numbers (T,), or for one."""
        return np.asarray(values < self.bound if self.is_below else values > self.bound)

    def __str__(self) -> str:
        return f"{self.field} of {self.topic} is {'below' if self.is_below else 'above'} {self.bound:g}"


@dataclass(frozen=True, slots=True)
class TypedSignal(TopicSignal):
    """A signal that can be subscribed to.

    Attributes
    ----------
    message_type
        full name of the type of the messages
    """

    message_type: str = "std_msgs/msg/Float64"


def read_signal(section: Section) -> dict[str, Any]:
    """What a part of a file says of a signal.

    Parameters
    ----------
    section
        with `SIGNAL_KEYS`

    Returns
    -------
    dict[str, Any]
        arguments of `TopicSignal`

    Raises
    ------
    YamlError
        the part does not describe one.
    """
    if {"above", "below"} <= section.values.keys():
        raise section.error("has 'above' and 'below': give only one of them")
    readers = {"field": ("field", _a_field), "above": ("bound", a_number()), "below": ("bound", a_number())}
    values = {name: section.required(key, read) for key, (name, read) in readers.items() if key in section.values}
    return {"topic": section.required("topic", a_topic), "is_below": "below" in section.values, **values}


def read_typed_signal(section: Section) -> TypedSignal:
    """A signal with the type of its messages.

    Parameters
    ----------
    section
        with `SIGNAL_KEYS` and `type`

    Returns
    -------
    TypedSignal
        the signal

    Raises
    ------
    YamlError
        the part does not describe one.
    """
    section.refuse_others(*SIGNAL_KEYS, "type")
    return TypedSignal(**read_signal(section), message_type=section.required("type", _a_type))


def _a_field(value: Any) -> str:
    if not isinstance(value, str) or _FIELD.fullmatch(value) is None:
        raise ValueError(
            'a field of a message, such as data, wrench.force.z, "position[0]" or "position[finger_joint]"'
        )
    return value


def _a_type(value: Any) -> str:
    found = _TYPE.fullmatch(value) if isinstance(value, str) else None
    if found is None:
        raise ValueError("the type of the messages, such as sensor_msgs/JointState")
    return f"{found[1]}/msg/{found[2]}"
