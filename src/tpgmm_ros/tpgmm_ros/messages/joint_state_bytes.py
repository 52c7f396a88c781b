# SPDX-License-Identifier: Apache-2.0
"""Joint states out of serialised messages, fast enough for every message of a 1 kHz stream.

rclpy makes a Python object of each number and each name, twice. Of a robot with 15 joints that takes longer than a
controller's step, and a node that falls behind spends all of its time on states that are old already. Here positions,
velocities and efforts stay in the bytes that came, as arrays over them, and names are read only when they change.

The bytes are CDR, the format of DDS (OMG, DDS-XTypes 1.3, section 7.4, XCDR version 1, little endian). Whatever is
arranged otherwise is read by rclpy.
"""

from __future__ import annotations

import struct
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from rclpy.serialization import deserialize_message
from sensor_msgs.msg import JointState

from tpgmm_core.common.types import Array
from tpgmm_ros.messages.fields import nanoseconds, time_to_ns

#: What says that the rest is plain CDR in little endian.
_LITTLE_ENDIAN = b"\x00\x01"
#: Places are counted from here.
_BODY = 4
#: Publishers on one topic whose names are remembered.
_MOST_KNOWN = 8
#: Writers reserve for the largest padding that there can be, and may send what they did not need.
_MOST_SLACK = 3 * 8
_COUNT = struct.Struct("<I")
_STAMP = struct.Struct("<iI")


@dataclass(frozen=True, slots=True)
class JointStateValues:
    """What a JointState holds.

    Parameters
    ----------
    stamp_ns
        of its header, ns
    name
        n names of joints, or none
    position, velocity, effort
        (n,) each, or empty; of rad or m, read only
    """

    stamp_ns: int
    name: Sequence[str]
    position: Array
    velocity: Array
    effort: Array

    @classmethod
    def of(cls, message: JointState) -> JointStateValues:
        """The same out of a message object."""
        columns = [
            np.asarray(column, dtype=np.float64) for column in (message.position, message.velocity, message.effort)
        ]
        return cls(time_to_ns(message.header.stamp), message.name, *columns)


class JointStateDecoder:
    """Reads serialised joint states, and remembers which joints they name."""

    def __init__(self) -> None:
        self._known: list[tuple[bytes, list[str]]] = []

    def __call__(self, data: bytes) -> JointStateValues:
        """What a message holds.

        Parameters
        ----------
        data
            as it came

        Returns
        -------
        JointStateValues
            its fields

        Raises
        ------
        RuntimeError
            when it is no JointState
        """
        try:
            return self._read(data)
        except (ValueError, struct.error):
            return JointStateValues.of(deserialize_message(data, JointState))

    def _read(self, data: bytes) -> JointStateValues:
        """Raises ValueError or struct.error for bytes that are arranged otherwise."""
        if data[:2] != _LITTLE_ENDIAN:
            raise ValueError("another representation")
        sec, nanosec = _STAMP.unpack_from(data, _BODY)
        place = _BODY + _STAMP.size
        known = next((item for item in self._known if data.startswith(item[0], place)), None)
        if known is None:
            names, end = _names(data, place)
            known = data[place:end], names
            self._known = [known, *self._known[: _MOST_KNOWN - 1]]
        beginning, names = known
        place += len(beginning)
        columns = []
        for _ in range(3):
            place += -place % 4
            (n,) = _COUNT.unpack_from(data, place)
            place += _COUNT.size
            if n:
                place += -(place - _BODY) % 8
            columns.append(np.frombuffer(data, "<f8", n, place) if n else _NONE)
            place += 8 * n
        if not 0 <= len(data) - place <= _MOST_SLACK:
            raise ValueError("another length")
        return JointStateValues(nanoseconds(sec, nanosec), names, *columns)


_NONE = np.zeros(0)


def _names(data: bytes, place: int) -> tuple[list[str], int]:
    """The names behind the frame's, and where they end."""
    _, place = _text(data, place)
    place += -place % 4
    (count,) = _COUNT.unpack_from(data, place)
    place += _COUNT.size
    names = []
    for _ in range(count):
        name, place = _text(data, place + -place % 4)
        names.append(name)
    return names, place


def _text(data: bytes, place: int) -> tuple[str, int]:
    (length,) = _COUNT.unpack_from(data, place)
    end = place + _COUNT.size + length
    if length == 0 or end > len(data) or data[end - 1] != 0:
        raise ValueError("no text")
    return data[place + _COUNT.size : end - 1].decode(), end
