# SPDX-License-Identifier: Apache-2.0
"""A topic of JointState out of one bag: positions of chosen joints, by name."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from tpgmm_core.text import listed
from tpgmm_ros.bag_messages import Array, BagError, Nanoseconds, read_messages

JOINT_STATE = "sensor_msgs/msg/JointState"


@dataclass(frozen=True, slots=True)
class JointStream:
    """What the topic holds, in the order of the recorder.

    Attributes:
        topic: the topic's name in the bag.
        stamps: (T,) header stamps in ns.
        recorded: (T,) times at which the recorder received the messages, in ns.
        positions: (T, n), rad or m.
    """

    topic: str
    stamps: Nanoseconds
    recorded: Nanoseconds
    positions: Array

    def at(self, seen: Nanoseconds, times: Nanoseconds) -> Array:
        """Positions (S, n) at times (S,), linear between those seen at (T,) times that never decrease, ns."""
        return np.column_stack([np.interp(times, seen, column) for column in self.positions.T])


def read_joint_stream(path: Path, topic: str, joints: Sequence[str]) -> JointStream:
    """Read positions of joints (n), in this order; a message may hold more joints, in any order.

    Raises:
        BagError: the bag is damaged or incomplete, the topic is absent, empty or of another type, or a message
            lacks a joint, names one twice, or has a position that is not finite.
    """
    several = read_messages(path, [topic], JOINT_STATE)[topic]
    positions = np.empty((len(several.messages), len(joints)))
    order: dict[tuple[str, ...], list[int]] = {}
    for i, message in enumerate(several.messages):
        names = tuple(message.name)
        if names not in order:
            order[names] = _places(path, several.topic, names, joints)
        if len(message.position) != len(names):
            raise BagError(
                path,
                f"{several.topic} has {len(message.position)} positions for {len(names)} joint names in message {i}; "
                "expected as many: record it again",
            )
        positions[i] = np.asarray(message.position)[order[names]]
    finite = np.isfinite(positions).all(axis=1)
    if not finite.all():
        bad = f"{np.count_nonzero(~finite)} of {len(finite)} messages"
        raise BagError(path, f"{several.topic} has positions that are not finite in {bad}: record it again")
    headers = [message.header.stamp for message in several.messages]
    stamps = np.array([stamp.sec * 1_000_000_000 + stamp.nanosec for stamp in headers], np.int64)
    return JointStream(several.topic, stamps, several.recorded, positions)


def _places(path: Path, topic: str, names: tuple[str, ...], joints: Sequence[str]) -> list[int]:
    missing = [joint for joint in joints if joint not in names]
    if missing or len(set(names)) < len(names):
        what = f"lacks the joints {listed(missing)}" if missing else "names joints twice"
        raise BagError(path, f"{topic} {what}; it names {listed(names)}. Record them, or correct the task file")
    return [names.index(joint) for joint in joints]
