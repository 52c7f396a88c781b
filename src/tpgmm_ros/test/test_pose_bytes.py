# SPDX-License-Identifier: Apache-2.0
"""Poses out of bytes: the same as by way of message objects, and what is arranged otherwise is left to these."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from rosbags.typesys import Stores, get_typestore

from tpgmm_ros.messages.fields import time_to_ns
from tpgmm_ros.recordings.storage.message_types import quick_decoder
from tpgmm_ros.recordings.storage.pose_bytes import POSE_STAMPED, PoseStampedDecoder
from tpgmm_ros.recordings.storage.storage_file import FileTopic

STORE = get_typestore(Stores.ROS2_JAZZY)
DEFINITION = STORE.generate_msgdef(POSE_STAMPED, ros_version=2)[0]


def message(frame_id: str, numbers: list[float], sec: int = 3, nanosec: int = 4) -> Any:
    types: Any = STORE.types
    pose = types["geometry_msgs/msg/Pose"](
        types["geometry_msgs/msg/Point"](*numbers[:3]), types["geometry_msgs/msg/Quaternion"](*numbers[3:])
    )
    stamp = types["builtin_interfaces/msg/Time"](sec, nanosec)
    return types[POSE_STAMPED](types["std_msgs/msg/Header"](stamp, frame_id), pose)


def topic(definition: str, encoding: str = "cdr") -> FileTopic:
    return FileTopic(1, "/pose", POSE_STAMPED, encoding, definition.encode(), "ros2msg", 1)


@given(
    st.text(st.characters(exclude_characters="\0", exclude_categories=["Cs"]), max_size=20),
    st.lists(st.floats(), min_size=7, max_size=7),
    st.integers(-(2**31), 2**31 - 1),
    st.integers(0, 2**32 - 1),
)
def test_poses_are_the_same_as_by_way_of_messages(frame_id: str, numbers: list[float], sec: int, nanosec: int) -> None:
    sent = message(frame_id, numbers, sec, nanosec)
    found = PoseStampedDecoder()(bytes(STORE.serialize_cdr(sent, POSE_STAMPED)))
    assert found is not None and found[:2] == (time_to_ns(sent.header.stamp), frame_id)
    np.testing.assert_array_equal(found[2], numbers)


@given(st.binary(max_size=120))
def test_bytes_that_are_no_pose_are_left_to_others(raw: bytes) -> None:
    decode = PoseStampedDecoder()
    for data in (raw, b"\x00\x01\x00\x00" + raw):
        found = decode(data)
        assert found is None or len(found[2]) == 7


def test_another_byte_order_and_other_definitions_go_by_way_of_messages() -> None:
    good = message("base", [1.0, 2.0, 3.0, 0.0, 0.0, 0.0, 1.0])
    raw, swapped = (bytes(STORE.serialize_cdr(good, POSE_STAMPED, little_endian=little)) for little in (True, False))
    decode = quick_decoder(Path("bag"), topic(DEFINITION))
    assert decode(raw) == (3_000_000_004, "base", (1.0, 2.0, 3.0, 0.0, 0.0, 0.0, 1.0))
    assert decode(swapped).pose.position.y == 2.0 and decode(swapped).header.frame_id == "base"
    with pytest.raises(Exception, match="."):
        decode(raw[:-1])
    other = DEFINITION.replace("Pose pose", "Pose pose\nfloat64 weight", 1)
    slow = quick_decoder(Path("bag"), topic(other))
    assert slow(raw + bytes(8)).weight == 0.0
    assert quick_decoder(Path("bag"), topic("")) is not None
