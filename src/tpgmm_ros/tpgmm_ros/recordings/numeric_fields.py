# SPDX-License-Identifier: Apache-2.0
"""Numbers of any topic out of one bag: a field of its messages, such as data, wrench.force.z or position[finger]."""

from __future__ import annotations

import re
from dataclasses import fields, is_dataclass
from pathlib import Path
from typing import Any

import numpy as np

from tpgmm_core.common.text import listed, one_line
from tpgmm_core.common.types import Array, Nanoseconds
from tpgmm_ros.recordings.bag_messages import BagError, topics_named
from tpgmm_ros.recordings.storage.bag_reader import BagReader

_PART = re.compile(r"(\w+)(?:\[([^\[\]]+)\])?")


def read_numbers(path: Path, topic: str, field: str) -> tuple[Nanoseconds, Array]:
    """Read a number out of each message of a topic, whatever its type is.

    Parameters
    ----------
    path
        of the bag
    topic
        relative name
    field
        names with dots between; ``[3]`` takes an element, and ``[finger]`` that whose name stands in `name` of the same
        message, as in a JointState

    Returns
    -------
    tuple[Nanoseconds, Array]
        times of the recorder (S,), ns, and numbers (S,), in the order of writing; messages without such an element,
        and numbers that are not finite, are left out

    Raises
    ------
    BagError
        the bag is damaged, the topic is absent or empty, or its messages have no such number.
    """
    parts = [(found[1], found[2]) for found in map(_PART.fullmatch, field.split(".")) if found is not None]
    times, numbers = [], []
    with BagReader(path) as reader:
        chosen = topics_named(path, [topic], reader.topics)[topic]
        for _, at, message in reader.messages([chosen]):
            try:
                number = _number(message, parts)
            except TypeError as error:
                raise BagError(
                    path, f"{one_line(chosen.name, 60)} ({one_line(chosen.type, 60)}) has no number {field!r}: {error}"
                ) from None
            if number is not None and np.isfinite(number):
                times.append(at)
                numbers.append(number)
    if not numbers:
        raise BagError(
            path, f"none of the {chosen.count} messages of {one_line(chosen.name, 60)} has a finite number {field!r}"
        )
    return np.array(times, np.int64), np.array(numbers, float)


def _number(message: Any, parts: list[tuple[str, str | None]]) -> float | None:
    """None where there is no such element; raises TypeError where there can be none."""
    value = message
    for name, element in parts:
        holder = value
        if not is_dataclass(holder) or name not in {item.name for item in fields(holder)}:
            there = listed([item.name for item in fields(holder)]) if is_dataclass(holder) else "none: it is a value"
            raise TypeError(f"there is no field {name!r}; its fields are {there}")
        value = getattr(holder, name)
        if element is None:
            continue
        if not hasattr(value, "__len__") or isinstance(value, str):
            raise TypeError(f"{name!r} is no list, so that it has no [{element}]")
        names = list(getattr(holder, "name", ()))
        at = int(element) if element.isdecimal() else names.index(element) if element in names else len(value)
        if at >= len(value):
            return None
        value = value[at]
    if not isinstance(value, bool | int | float | np.number | np.bool_):
        what = "a list: name one of its elements, such as [0]" if hasattr(value, "__len__") else "made of other fields"
        raise TypeError(f"it is {what}")
    return float(value)
