# SPDX-License-Identifier: Apache-2.0
"""Serialised joint states are read as rclpy reads them, whatever they hold; what is no joint state is refused."""

from __future__ import annotations

import struct
from array import array

import numpy as np
import pytest
from builtin_interfaces.msg import Time
from hypothesis import given
from hypothesis import strategies as st
from rclpy.serialization import deserialize_message, serialize_message
from sensor_msgs.msg import JointState
from std_msgs.msg import Header

from tpgmm_ros.messages import joint_state_bytes
from tpgmm_ros.messages.joint_state_bytes import JointStateDecoder, JointStateValues

floats = st.lists(st.floats(allow_nan=True), max_size=5)
texts = st.text(st.characters(blacklist_characters="\0", blacklist_categories=["Cs"]), max_size=9)
messages = st.builds(
    lambda sec, nanosec, frame, names, q, v, tau: JointState(
        header=Header(stamp=Time(sec=sec, nanosec=nanosec), frame_id=frame),
        name=names,
        position=array("d", q),
        velocity=array("d", v),
        effort=array("d", tau),
    ),
    st.integers(-(2**31), 2**31 - 1), st.integers(0, 2**32 - 1), texts, st.lists(texts, max_size=4),
    floats, floats, floats,
)  # fmt: skip


def assert_equal(a: JointStateValues, b: JointStateValues) -> None:
    assert (a.stamp_ns, list(a.name)) == (b.stamp_ns, list(b.name))
    for field in ("position", "velocity", "effort"):
        np.testing.assert_array_equal(getattr(a, field), getattr(b, field), strict=True)


@given(st.lists(messages, min_size=1, max_size=4))
def test_bytes_are_read_as_rclpy_reads_them_whoever_published_before(several: list[JointState]) -> None:
    decode = JointStateDecoder()
    for message in [*several, *several]:
        assert_equal(decode(serialize_message(message)), JointStateValues.of(message))


@given(messages)
def test_they_are_read_without_rclpy(message: JointState) -> None:
    with pytest.MonkeyPatch.context() as patch:
        patch.delattr(joint_state_bytes, "deserialize_message")
        assert_equal(JointStateDecoder()(serialize_message(message)), JointStateValues.of(message))


@given(messages, st.data())
def test_damaged_bytes_are_read_as_rclpy_reads_them_or_refused(message: JointState, data: st.DataObject) -> None:
    good = serialize_message(message)
    place = data.draw(st.integers(0, len(good) - 1))
    bad = good[:place] + bytes([data.draw(st.integers(0, 255))]) + good[place + 1 :]
    bad = bad[: data.draw(st.integers(1, len(bad)))]
    decode = JointStateDecoder()
    decode(good)
    try:
        values = decode(bad)
    except RuntimeError:
        return
    if len(bad) == len(good):
        try:
            expected = deserialize_message(bad, JointState)
        except (RuntimeError, UnicodeError):
            return
        assert_equal(values, JointStateValues.of(expected))


def test_big_endian_bytes_are_left_to_rclpy() -> None:
    frame_and_names = struct.pack(">I", 1) + b"\0\0\0\0" + struct.pack(">II", 1, 2) + b"b\0\0\0"
    values = JointStateDecoder()(
        b"\0\0\0\0" + struct.pack(">iI", 3, 7) + frame_and_names + struct.pack(">III", 0, 0, 0)
    )
    assert values.stamp_ns == 3_000_000_007 and list(values.name) == ["b"]
