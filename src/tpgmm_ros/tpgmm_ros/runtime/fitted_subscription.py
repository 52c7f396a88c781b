# SPDX-License-Identifier: Apache-2.0
"""Subscriptions to topics of others, of whom some say a thing once and keep it for those who come later."""

from __future__ import annotations

from collections.abc import Callable, Sequence

from rclpy.clock import Clock, ClockType
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from rclpy.subscription import Subscription
from rclpy.topic_endpoint_info import TopicEndpointInfo

#: So often it is looked who publishes, s.
FIT_PERIOD = 0.5


def are_latched(publishers: Sequence[TopicEndpointInfo]) -> bool:
    """Whether there are publishers, and all of them keep what they have said for those who come later."""
    profiles = [item.qos_profile for item in publishers]
    return bool(profiles) and all(
        item.durability == DurabilityPolicy.TRANSIENT_LOCAL and item.reliability != ReliabilityPolicy.BEST_EFFORT
        for item in profiles
    )


class FittedSubscription:
    """A subscription to all who publish on a topic, and to what was said before it, where all of them keep that.

    A volatile subscription hears everybody, from now on. A transient-local one hears also what was said before, and no
    volatile publisher at all. So it is made anew when others publish than before, as rosbag2's recorder chooses too.

    Parameters
    ----------
    node
        that subscribes
    qos
        of the subscription as long as not all publishers are latched
    subscribe
        makes the subscription with a quality of service

    Attributes
    ----------
    is_latched
        whether all who publish at present keep what they have said
    """

    def __init__(self, node: Node, qos: QoSProfile, subscribe: Callable[[QoSProfile], Subscription]) -> None:
        self._node, self._qos, self._subscribe = node, qos, subscribe
        self.is_latched = False
        self._subscription = subscribe(qos)
        # The graph has to be asked: rclpy does not tell of publishers that come and go
        node.create_timer(FIT_PERIOD, self.fit, clock=Clock(clock_type=ClockType.STEADY_TIME))

    def fit(self) -> None:
        """Look who publishes at present."""
        latched = are_latched(self._node.get_publishers_info_by_topic(self._subscription.topic_name))
        if latched != self.is_latched:
            self.is_latched = latched
            self._renew()

    def hear_again(self) -> None:
        """Hear once more what publishers keep, if they do: it was forgotten."""
        if self.is_latched:
            self._renew()

    def _renew(self) -> None:
        self._node.destroy_subscription(self._subscription)
        reliability, durability = ReliabilityPolicy.RELIABLE, DurabilityPolicy.TRANSIENT_LOCAL
        kept = QoSProfile(depth=self._qos.depth, reliability=reliability, durability=durability)
        self._subscription = self._subscribe(kept if self.is_latched else self._qos)
