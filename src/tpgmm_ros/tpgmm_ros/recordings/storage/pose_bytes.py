# SPDX-License-Identifier: Apache-2.0
"""PoseStamped out of serialised messages, many times as fast as by way of message objects.

The bytes are CDR (OMG, DDS-XTypes 1.3, section 7.4, XCDR version 1, little endian). Whatever is arranged otherwise is
for others to read.
"""

from __future__ import annotations

import struct
from functools import cache

from rosbags.typesys import Stores, get_typestore
from rosbags.typesys.store import Typestore

from tpgmm_ros.messages.fields import nanoseconds

POSE_STAMPED = "geometry_msgs/msg/PoseStamped"
_LITTLE_ENDIAN = b"\x00\x01"
_BODY = 4
"""Places are counted from here."""
_START = struct.Struct("<iII")

type StampedPose = tuple[int, str, tuple[float, ...]]
"""Stamp in ns, frame_id, and x, y, z, qx, qy, qz, qw."""


def is_standard(store: Typestore) -> bool:
    """Whether PoseStamped in a store of types is that of ROS 2."""
    return store.hash_rihs01(POSE_STAMPED) == _standard_hash()


@cache
def _standard_hash() -> str:
    return get_typestore(Stores.ROS2_JAZZY).hash_rihs01(POSE_STAMPED)


class PoseStampedDecoder:
    """Reads serialised poses, and remembers the frames that they name."""

    def __init__(self) -> None:
        self._known: dict[bytes, tuple[str, struct.Struct]] = {}

    def __call__(self, raw: bytes) -> StampedPose | None:
        """What a message holds; None where it is arranged otherwise, or damaged."""
        if raw[:2] != _LITTLE_ENDIAN or len(raw) < _BODY + _START.size:
            return None
        sec, nanosec, size = _START.unpack_from(raw, _BODY)
        begin = _BODY + _START.size
        text = raw[begin : begin + size]
        known = self._known.get(text)
        if known is None:
            known = self._learned(text)
            if known is None:
                return None
        name, layout = known
        if len(raw) != layout.size:
            return None
        return nanoseconds(sec, nanosec), name, layout.unpack(raw)

    def _learned(self, text: bytes) -> tuple[str, struct.Struct] | None:
        """Name of the frame, and where the numbers are behind it: on a multiple of 8."""
        try:
            name = text[:-1].decode() if text.endswith(b"\0") else None
        except UnicodeDecodeError:
            return None
        if name is None:
            return None
        begin = _BODY + -(-(_START.size + len(text)) // 8) * 8
        self._known[text] = name, struct.Struct(f"<{begin}x7d")
        return self._known[text]
