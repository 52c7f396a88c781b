# SPDX-License-Identifier: Apache-2.0
"""Nodes that share a process: their topics are local, and what one of them raises ends that one alone."""

from __future__ import annotations

import contextlib
import traceback
from collections import deque
from collections.abc import Callable, Sequence
from functools import partial
from typing import Any

from rclpy.exceptions import InvalidHandle
from rclpy.node import Node
from rclpy.publisher import Publisher
from rclpy.service import Service
from rclpy.subscription import Subscription
from rclpy.timer import Timer

from tpgmm_ros.runtime.local_topics import LocalTopics, Receiver, Sender
from tpgmm_ros.runtime.rclpy_events import guard_waitable


class Member(Node):
    """What a node class is made of, beside itself, where its nodes share a process: see `composed`.

    Attributes
    ----------
    topics : LocalTopics
        Of the process.
    order : int
        Of the nodes of the process, those with lower numbers get what is published first.
    failure : Exception or None
        What one of its callbacks has raised: it is not called back any more.
    """

    topics: LocalTopics
    order: int
    failure: Exception | None = None
    _depth = 0
    _has_left = False

    def call(self, callback: Callable[..., Any], *args: Any) -> Any:
        """Call back, unless the node has failed; then do what was put off meanwhile."""
        if self.failure is not None:
            return None
        self._depth += 1
        try:
            return callback(*args)
        except Exception as error:
            self.fail(error)
            return None
        finally:
            self._depth -= 1
            later = self.__dict__.get("_later")
            while later and not self._depth:
                self.call(*later.popleft())

    def fail(self, error: Exception) -> None:
        """End this node, in its own words (`destroy_node`), as soon as it is at nothing any more."""
        self.failure = error
        self.get_logger().fatal("".join(traceback.format_exception(error)))
        if self.executor is not None:
            self.executor.create_task(self.leave)

    def leave(self) -> None:
        """Leave executor and graph, once; what its last words raise is in the log, and keeps nobody from going on."""
        if self._has_left:
            return
        self._has_left = True
        if self.executor is not None:
            self.executor.remove_node(self)
        end(self)

    def call_when_idle(self, callback: Callable[[Any], object], item: Any) -> None:
        """Call back at once; where the node itself is at something, as soon as it has ended that.

        What it publishes may be answered at once by something that it subscribes to. Its callbacks follow each other,
        as they do on an executor.
        """
        if self._depth:
            self.__dict__.setdefault("_later", deque()).append((callback, item))
        else:
            self.call(callback, item)

    def create_publisher(self, *args: Any, **options: Any) -> Publisher:
        """As of a node; see `local_topics.Sender`."""
        publisher = super().create_publisher(*args, **options)
        Sender(self.topics, publisher)
        return publisher

    def create_lifecycle_publisher(self, *args: Any, **options: Any) -> Any:
        """As of a lifecycle node; see `local_topics.Sender`."""
        publisher = super().create_lifecycle_publisher(*args, **options)  # type: ignore[misc]
        Sender(self.topics, publisher)
        return publisher

    def create_subscription(
        self, msg_type: Any, topic: str, callback: Callable[..., Any], qos_profile: Any, *, raw: bool = False,
        **options: Any,
    ) -> Subscription:  # fmt: skip
        """As of a node; what nodes of this process publish is handed over.

        Parameters
        ----------
        msg_type, topic, callback, qos_profile, raw
            as for `Node.create_subscription`
        **options
            passed on

        Returns
        -------
        Subscription
            the subscription
        """
        receiver: Receiver | None = None

        def take(data: bytes) -> None:
            assert receiver is not None
            self.call(receiver.take, data)

        subscription = super().create_subscription(msg_type, topic, take, qos_profile, raw=True, **options)
        receiver = Receiver(msg_type, callback, self.call_when_idle, self.order, subscription.qos_profile, raw)
        subscription.receiver = receiver  # type: ignore[attr-defined]
        self.topics.add(subscription.topic_name, receiver)
        return subscription

    def destroy_subscription(self, subscription: Subscription) -> bool:
        """As of a node."""
        if subscription in self.subscriptions:
            self.topics.remove(subscription.topic_name, subscription.receiver)  # type: ignore[attr-defined]
        return super().destroy_subscription(subscription)

    def add_waitable(self, waitable: Any) -> None:
        """As of a node; what an action raises ends this node alone."""
        guard_waitable(waitable, lambda: self.failure is not None, self.fail)
        super().add_waitable(waitable)

    def create_timer(self, timer_period_sec: float, callback: Callable[..., Any], *args: Any, **options: Any) -> Timer:
        """As of a node; what its callback raises ends this node alone.

        Parameters
        ----------
        timer_period_sec, callback
            as for `Node.create_timer`
        *args, **options
            passed on

        Returns
        -------
        Timer
            the timer
        """
        return super().create_timer(timer_period_sec, lambda *given: self.call(callback, *given), *args, **options)

    def create_service(self, srv_type: Any, srv_name: str, callback: Callable[..., Any], **options: Any) -> Service:
        """As of a node; a request that it fails at is answered by an empty response.

        Parameters
        ----------
        srv_type, srv_name, callback
            as for `Node.create_service`
        **options
            passed on

        Returns
        -------
        Service
            the service
        """

        def answer(request: Any, response: Any) -> Any:
            answered = self.call(callback, request, response)
            return response if answered is None else answered

        # what callbacks of a transition raise is a matter of the life cycle, and of `guard_transitions`
        of_lifecycle = srv_type.__module__.startswith("lifecycle_msgs.")
        return super().create_service(srv_type, srv_name, callback if of_lifecycle else answer, **options)


def end(node: Node) -> bool:
    """Have a node end in its own words; whether it did, else why not is in the log, and it is gone without them."""
    try:
        node.destroy_node()
        return True
    except Exception as error:
        node.get_logger().fatal("".join(traceback.format_exception(error)))
        with contextlib.suppress(InvalidHandle):  # it came so far by itself
            Node.destroy_node(node)
        return False
    finally:  # rclpy leaves actions to themselves, and with them the node would stay in the graph
        waitables: list[Any] = list(node.waitables)
        for waitable in waitables:
            waitable.destroy()


def guarded(node: Node, callback: Callable[..., Any]) -> Callable[..., Any]:
    """A callback that the node hands to something that calls it back: what it raises ends this node alone."""
    return partial(node.call, callback) if isinstance(node, Member) else callback


def composed(classes: Sequence[type[Node]]) -> list[type[Node]]:
    """Classes of nodes that share this process.

    Parameters
    ----------
    classes : sequence of type
        As they run alone. What one publishes is handed to the others in this order: what comes first in the way of
        the data comes first here, so that each tick is answered with what belongs to it.

    Returns
    -------
    list[type[Node]]
        classes whose nodes hand each other what they publish, in the order given
    """
    topics = LocalTopics()
    return [
        type(item.__name__, (Member, item), {"topics": topics, "order": order, "__module__": item.__module__})
        for order, item in enumerate(classes)
    ]
