# SPDX-License-Identifier: Apache-2.0
"""What tells on topics whether a gripper holds something: numbers of messages of any type."""

from __future__ import annotations

import functools
import math
from collections.abc import Callable, Mapping, Sequence
from typing import Any

from rclpy.node import Node

from tpgmm_ros.messages.classes import message_class
from tpgmm_ros.messages.fields import field_parts, number_of
from tpgmm_ros.messages.qos import STREAM
from tpgmm_ros.task.signals import TypedSignal


def subscribe_to_grippers(
    node: Node,
    signals: Mapping[str, TypedSignal],
    told: Callable[[str, bool, int], object],
    refuse: Callable[[str], object],
) -> None:
    """Listen to the grippers that may hold frames.

    As in recordings, what a message says is true when it comes: few of them have stamps.

    Parameters
    ----------
    node
        that subscribes
    signals
        by frame name
    told
        called with a frame's name, whether the gripper is closed, and the ROS time, ns
    refuse
        called with the reason, where a message has no such number

    Raises
    ------
    ModuleNotFoundError
        the messages are not installed.
    """

    def take(name: str, signal: TypedSignal, parts: Sequence[Any], message: Any) -> None:
        try:
            number = number_of(message, list(parts))
        except TypeError as error:
            refuse(f"gripper of '{name}': {signal.topic} has no number {signal.field!r}: {error}")
            return
        if number is not None and math.isfinite(number):
            told(name, bool(signal.holds(number)), node.get_clock().now().nanoseconds)

    for name, signal in signals.items():
        callback = functools.partial(take, name, signal, field_parts(signal.field))
        node.create_subscription(message_class(signal.message_type), signal.topic, callback, STREAM)
