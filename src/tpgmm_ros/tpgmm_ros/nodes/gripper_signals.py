# SPDX-License-Identifier: Apache-2.0
"""What tells on topics whether a gripper holds something: numbers of messages of any type."""

from __future__ import annotations

import functools
import math
from collections.abc import Callable, Mapping, Sequence
from typing import Any

from rclpy.node import Node
from rclpy.qos import QoSProfile
from rclpy.serialization import deserialize_message
from rclpy.subscription import Subscription

from tpgmm_ros.messages.classes import message_class
from tpgmm_ros.messages.fields import field_parts, number_of
from tpgmm_ros.messages.qos import MIXED
from tpgmm_ros.runtime.batches import Batches
from tpgmm_ros.runtime.fitted_subscription import FittedSubscription
from tpgmm_ros.task.signals import TypedSignal


def subscribe_to_grippers(
    node: Node,
    signals: Mapping[str, TypedSignal],
    told: Callable[[str, bool, int], object],
    refuse: Callable[[str], object],
) -> list[FittedSubscription]:
    """Listen to the grippers that may hold frames.

    As in recordings, what a message says is true when it comes: few of them have stamps. What was said before, and kept
    for those who come later, comes too. All that waits is read: where the arm's driver publishes on the same topic, the
    one message of a gripper is among many of the arm.

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

    Returns
    -------
    list[FittedSubscription]
        one for each frame

    Raises
    ------
    ModuleNotFoundError
        the messages are not installed.
    """

    def take(name: str, signal: TypedSignal, parts: list[Any], messages: Sequence[Any]) -> None:
        for message in messages:
            try:
                number = number_of(message, parts)
            except TypeError as error:
                refuse(f"gripper of '{name}': {signal.topic} has no number {signal.field!r}: {error}")
                continue
            if number is not None and math.isfinite(number):
                told(name, bool(signal.holds(number)), node.get_clock().now().nanoseconds)

    def subscribe(name: str, signal: TypedSignal, qos: QoSProfile) -> Subscription:
        kind = message_class(signal.message_type)
        callback = functools.partial(take, name, signal, list(field_parts(signal.field)))
        read = functools.partial(deserialize_message, message_type=kind)
        return Batches(node, kind, signal.topic, callback, qos, read, qos.depth).subscription

    return [FittedSubscription(node, MIXED, functools.partial(subscribe, *item)) for item in signals.items()]
