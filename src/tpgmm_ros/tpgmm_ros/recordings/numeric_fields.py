# SPDX-License-Identifier: Apache-2.0
"""Numbers of any topic out of one bag: a field of its messages, such as data, wrench.force.z or position[finger]."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from tpgmm_core.common.text import one_line
from tpgmm_core.common.types import Array, Nanoseconds
from tpgmm_ros.messages.fields import field_parts, number_of
from tpgmm_ros.recordings.bag_messages import BagError, topics_named
from tpgmm_ros.recordings.storage.bag_reader import BagReader


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
    parts = field_parts(field)
    times, numbers = [], []
    with BagReader(path) as reader:
        chosen = topics_named(path, [topic], reader.topics)[topic]
        for _, at, message in reader.messages([chosen]):
            try:
                number = number_of(message, parts)
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
