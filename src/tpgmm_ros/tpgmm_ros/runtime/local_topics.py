# SPDX-License-Identifier: Apache-2.0
"""Topics between nodes that share a process: objects are handed over, without being written and read as messages.

The nodes create publishers and subscriptions as ever. What one of them publishes is handed at once to the others that
subscribe to it. The middleware gets it only where somebody else listens, or may come later and ask for the last one
(transient local). Then it comes back to the own subscriptions too, where it is known by its bytes and dropped.

The objects that are handed over belong to nobody: neither the sender nor a receiver changes them.
"""

from __future__ import annotations

import time
from collections import defaultdict, deque
from collections.abc import Callable, Iterator
from typing import Any

from rclpy.lifecycle import LifecyclePublisher
from rclpy.publisher import Publisher
from rclpy.qos import DurabilityPolicy, QoSCompatibility, QoSProfile, qos_check_compatible
from rclpy.serialization import deserialize_message, serialize_message
from rclpy.subscription import Subscription

from tpgmm_ros.runtime.rclpy_workarounds import waiting

#: Messages that may be on their way through the middleware back into this process, of each topic: best effort loses
#: some of them, so that the oldest ones are forgotten.
MAX_COPIES = 64
#: Who begins to listen is heard of within this time, s.
ASK_PERIOD = 0.02


class Receiver:
    """A subscription of a node in this process.

    Parameters
    ----------
    kind : type
        Of the messages.
    callback : callable
        Gets each message.
    run : callable
        ``run(callback, item)`` calls back for the node: at once, or as soon as the node has ended what it is at.
    order : int
        Of all receivers of a message, those with lower numbers get it first.
    qos : QoSProfile
        Of the subscription.
    raw : bool
        Whether the callback gets messages as bytes.
    """

    def __init__(
        self,
        kind: type,
        callback: Callable[[Any], object],
        run: Callable[[Callable[[Any], object], Any], None],
        order: int,
        qos: QoSProfile,
        raw: bool = False,
    ) -> None:
        self.kind, self.order, self.qos, self.raw = kind, order, qos, raw
        self.take_value: Callable[[Any], object] | None = None
        self._callback, self.run = callback, run
        self._copies: deque[bytes] = deque(maxlen=MAX_COPIES)

    def hand_over(self, message: Any) -> None:
        """A message from this process, as the object that it is, or as bytes where these are asked for."""
        self.run(self._callback, serialize_message(message) if self.raw else message)

    def expect(self, copy: bytes) -> None:
        """What was handed over comes through the middleware too."""
        self._copies.append(copy)

    def unpack(self, data: bytes) -> Any | None:
        """A message that came through the middleware; None for one that was handed over already."""
        if data in self._copies:
            while self._copies.popleft() != data:  # those before it are lost
                pass
            return None
        return data if self.raw else deserialize_message(data, self.kind)

    def take(self, data: bytes) -> None:
        """Call back with a message that came through the middleware."""
        if (message := self.unpack(data)) is not None:
            self.run(self._callback, message)


class LocalTopics:
    """All topics between the nodes of this process."""

    def __init__(self) -> None:
        self._receivers: defaultdict[tuple[str, Any], list[Receiver]] = defaultdict(list)
        #: Counts up with each receiver that comes or goes.
        self.version = 0

    def add(self, topic: str, receiver: Receiver) -> None:
        """From now on it gets what is published on the topic, by its full name."""
        receivers = self._receivers[topic, receiver.kind]
        receivers.append(receiver)
        receivers.sort(key=lambda item: item.order)
        self.version += 1

    def remove(self, topic: str, receiver: Receiver) -> None:
        """From now on it gets nothing more."""
        self._receivers[topic, receiver.kind].remove(receiver)
        self.version += 1

    def of(self, topic: str, kind: Any, qos: QoSProfile) -> list[Receiver]:
        """Who gets what is published with a quality of service: those whom the middleware would connect, too.

        Parameters
        ----------
        topic
            full name
        kind
            type of its messages
        qos
            of the publisher

        Returns
        -------
        list[Receiver]
            the receivers
        """
        return [
            item
            for item in self._receivers[topic, kind]
            if qos_check_compatible(qos, item.qos)[0] != QoSCompatibility.ERROR
        ]


class Sender:
    """What `publish` of a publisher does from now on.

    Parameters
    ----------
    topics : LocalTopics
        Of the process.
    publisher : Publisher
        Its `publish` is replaced.
    """

    def __init__(self, topics: LocalTopics, publisher: Publisher) -> None:
        self._topics, self._publisher, self._write = topics, publisher, publisher.publish
        self._name = publisher.topic_name
        self._keeps = publisher.qos_profile.durability == DurabilityPolicy.TRANSIENT_LOCAL
        self._managed = isinstance(publisher, LifecyclePublisher)
        self._version, self._ask_again, self._others = -1, 0.0, False
        self._receivers: list[Receiver] = []
        publisher.publish = self.publish  # type: ignore[method-assign, assignment]
        publisher.sender = self  # type: ignore[attr-defined]

    def publish(self, message: Any) -> None:
        """Hand a message over to who is here, and write it for who is not."""
        if isinstance(message, bytes):
            self._write(message)
        else:
            self.publish_value(None, lambda _: message)

    def publish_value(self, value: Any, message_of: Callable[[Any], Any]) -> None:
        """The same with what the message is made of, unless that is None."""
        if self._managed and not self._publisher.is_activated:  # type: ignore[attr-defined]
            return
        if self._version != self._topics.version:
            self._version, self._ask_again = self._topics.version, 0.0
            self._receivers = self._topics.of(self._name, self._publisher.msg_type, self._publisher.qos_profile)
        receivers = self._receivers
        is_written = self._keeps or self._has_others()
        takers = [None if value is None else item.take_value for item in receivers]
        message = message_of(value) if is_written or not all(takers) else None
        for item, take in zip(receivers, takers, strict=True):
            if take is None:
                item.hand_over(message)
            else:
                item.run(take, value)
        if is_written and receivers:
            data = serialize_message(message)
            for item in receivers:
                item.expect(data)
            self._write(data)
        elif is_written:
            self._write(message)

    def _has_others(self) -> bool:
        """Whether somebody outside this process listens: asked of the middleware now and then, since it takes time."""
        now = time.monotonic()
        if now >= self._ask_again:
            self._ask_again = now + ASK_PERIOD
            self._others = self._publisher.get_subscription_count() > len(self._receivers)
        return self._others


def publish_value(publisher: Publisher, value: Any, message_of: Callable[[Any], Any]) -> None:
    """Publish a value of the core.

    Parameters
    ----------
    publisher : Publisher
        Of a node that may share its process with others, or not.
    value : object
        Immutable. Subscriptions in this process that `receive_values` get it as it is.
    message_of : callable
        Makes the message, where one is needed.
    """
    sender = getattr(publisher, "sender", None)
    if sender is None:
        publisher.publish(message_of(value))
    else:
        sender.publish_value(value, message_of)


def receive_values(subscription: Subscription, take: Callable[[Any], object]) -> None:
    """Have what nodes of this process publish by `publish_value` come as it is: `take` gets the value.

    Messages of other processes still come to the subscription's callback.
    """
    receiver: Receiver | None = getattr(subscription, "receiver", None)
    if receiver is not None:
        receiver.take_value = take


def waiting_messages(subscription: Subscription) -> Iterator[Any]:
    """The messages that have come since the executor has taken one."""
    receiver: Receiver | None = getattr(subscription, "receiver", None)
    if receiver is None:
        yield from waiting(subscription, raw=subscription.raw)
        return
    for data in waiting(subscription, raw=True):
        if (message := receiver.unpack(data)) is not None:
            yield message
