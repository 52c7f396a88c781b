# SPDX-License-Identifier: Apache-2.0
"""Topics that are looked at now and then: what came is taken when it is wanted, and costs nothing in between.

Joint states come a thousand times per second and are shown thirty times. A subscription that an executor serves would
cost a callback for each of them.
"""

from __future__ import annotations

import time
from collections.abc import Iterator
from typing import Any

from rclpy.node import Node
from rclpy.qos import QoSProfile

from tpgmm_ros.runtime.rclpy_workarounds import waiting


class Looker:
    """A node that no executor serves, in the namespace of another one, with the same names of topics.

    Parameters
    ----------
    node
        whose topics they are
    """

    def __init__(self, node: Node) -> None:
        self._names = node
        self._node = Node(
            f"{node.get_name()}_view",
            namespace=node.get_namespace(),
            context=node.context,
            use_global_arguments=False,
            enable_rosout=False,
            start_parameter_services=False,
        )

    def topic(self, kind: type, name: str, qos: QoSProfile, *, raw: bool = False) -> Topic:
        """A topic that can be looked at.

        Parameters
        ----------
        kind
            of its messages
        name
            as the node resolves it, remappings included
        qos
            its depth is how many messages can wait
        raw
            whether they are to be bytes

        Returns
        -------
        Topic
            what to look at
        """
        return Topic(self._node, kind, self._names.resolve_topic_name(name), qos, raw)

    def close(self) -> None:
        """Take it away."""
        self._node.destroy_node()


class Topic:
    """What came on one topic.

    Attributes
    ----------
    last
        the newest message that was taken; None before
    came
        when it was taken, s of the steady clock
    """

    def __init__(self, node: Node, kind: type, name: str, qos: QoSProfile, raw: bool) -> None:
        self.last: Any = None
        self.came = float("-inf")
        self._raw = raw
        self._subscription = node.create_subscription(kind, name, lambda _: None, qos, raw=raw)

    def take(self) -> Iterator[Any]:
        """Messages that have come since it was asked last, oldest first."""
        for message in waiting(self._subscription, raw=self._raw):
            self.last, self.came = message, time.monotonic()
            yield message

    def newest(self) -> Any:
        """The newest message that ever came, None before one did."""
        for _ in self.take():
            pass
        return self.last

    @property
    def silence(self) -> float:
        """For how long nothing was taken, s; infinite before the first message."""
        return time.monotonic() - self.came
