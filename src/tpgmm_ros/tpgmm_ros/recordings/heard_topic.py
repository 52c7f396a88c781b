# SPDX-License-Identifier: Apache-2.0
"""`HeardTopic`: what a recorder knows of a topic that it listens to; and how publishers' promises are written."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass, field

from rclpy.qos import QoSProfile
from rclpy.subscription import Subscription
from rosbags.interfaces import (
    Connection,
    Qos,
    QosDurability,
    QosHistory,
    QosLiveliness,
    QosReliability,
    QosTime,
)

MOST_KEPT = 200
"""Messages that came once and go into every bag, of one topic: transforms of so many publishers."""
SECOND = 1_000_000_000


@dataclass
class HeardTopic:
    """A topic that is listened to.

    Attributes
    ----------
    name
        as it was asked for
    type
        full name of its messages' type; None as long as it is not known
    subscription
        None as long as its type is not known
    latched
        publishers keep what they have sent for those who listen later
    came
        messages since the recorder began
    times
        when the last of them came, s
    kept
        messages of a latched topic that hold still
    last
        the last message of this bag
    count
        messages since this bag began
    connection
        the topic in this bag; None as long as it has none
    trouble
        why it cannot be recorded, in words
    """

    name: str
    type: str | None
    subscription: Subscription | None = None
    latched: bool = False
    came: int = 0
    times: deque[float] = field(default_factory=lambda: deque(maxlen=64))
    kept: list[bytes] = field(default_factory=list)
    last: bytes = b""
    count: int = 0
    connection: Connection | None = None
    trouble: str = ""

    def take(self, data: bytes, now: float) -> None:
        """Note that a message has come, at a time, s."""
        self.came += 1
        self.times.append(now)
        if self.latched and data not in self.kept:
            # each message with transforms holds for ever; of others the newest one does
            before = self.kept[1 - MOST_KEPT :] if self.name.endswith("tf_static") else []
            self.kept = [*before, data]

    def begin(self) -> None:
        """A bag begins."""
        self.count, self.last, self.connection = 0, b"", None

    def rate(self, now: float) -> float | None:
        """Messages per second, of the last ones; None where they are too few, or have ceased, at a time, s."""
        times = list(self.times)
        if len(times) < 3 or times[-1] == times[0]:
            return None
        period = (times[-1] - times[0]) / (len(times) - 1)
        return None if now - times[-1] > max(1.0, 5.0 * period) else 1.0 / period


def bag_qos(profile: QoSProfile) -> Qos:
    """What a publisher offers, as the metadata of a bag have it: players publish with the same."""
    return Qos(
        QosHistory(profile.history.value),
        profile.depth,
        QosReliability(profile.reliability.value),
        QosDurability(profile.durability.value),
        QosTime(*divmod(profile.deadline.nanoseconds, SECOND)),
        QosTime(*divmod(profile.lifespan.nanoseconds, SECOND)),
        QosLiveliness(profile.liveliness.value),
        QosTime(*divmod(profile.liveliness_lease_duration.nanoseconds, SECOND)),
        profile.avoid_ros_namespace_conventions,
    )
