# SPDX-License-Identifier: Apache-2.0
"""What has to be different in rclpy from how it comes, and what it does not offer; for which version, and why.

This module and `rclpy_events` are the only ones that use private or undocumented parts of rclpy, as they are in 7.1,
the version of Jazzy. Each function says what rclpy does by itself.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from concurrent.futures import Future
from typing import Any

import rclpy
from lifecycle_msgs.srv import ChangeState
from rclpy.event_handler import PublisherEventCallbacks, SubscriptionEventCallbacks
from rclpy.impl.implementation_singleton import rclpy_implementation
from rclpy.lifecycle import LifecycleNode, LifecycleState, TransitionCallbackReturn
from rclpy.node import Node
from rclpy.subscription import Subscription
from rclpy.time_source import TimeSource
from rosgraph_msgs.msg import Clock as ClockMessage

from tpgmm_ros.runtime.rclpy_events import silence_destroyed
from tpgmm_ros.runtime.transport import avoid_shared_memory


def init_rclpy(**options: Any) -> None:
    """`rclpy.init` for every process that has an `EventsExecutor`: see the functions below, and `transport`."""
    avoid_shared_memory()
    without_status_events()
    guard_clock()
    silence_destroyed()
    rclpy.init(**options)


def without_status_events() -> None:
    """From now on, publishers and subscriptions watch no status event of the middleware that nobody asked for.

    By default rclpy watches each of them for partners with an incompatible quality of service, to log a warning. With
    an executor that is called on events, rmw_fastrtps then holds a lock of its own while it asks Fast DDS for the
    status, and Fast DDS holds one of its own while it tells rmw_fastrtps of a new one: where both happen at once, the
    node stands still for ever, with all of its topics. (ros2/rmw_fastrtps, pull request 890, of June 2026;
    rmw_fastrtps 8.4.3 of the Jazzy wheels is older.) Without such an event there is nothing to ask for.
    `graph_checks` finds out from the graph who cannot be heard, with the name of the other node.
    """
    for callbacks in (PublisherEventCallbacks, SubscriptionEventCallbacks):
        defaults = callbacks.__init__.__kwdefaults__
        assert defaults is not None
        defaults["use_default_callbacks"] = False


def guard_clock() -> None:
    """From now on a time on ``/clock`` that is none is refused: rclpy would raise in its callback and end the node."""
    take = TimeSource.clock_callback
    if take.__name__ == "guarded":  # once for each process
        return

    def guarded(self: TimeSource, message: ClockMessage) -> None:
        time = message.clock
        if time.sec >= 0 and time.nanosec < 1_000_000_000:
            take(self, message)
        elif (node := self._get_node()) is not None:
            node.get_logger().error(
                f"time on /clock refused: {time.sec} s and {time.nanosec} ns; expected at least 0, and below 1e9",
                throttle_duration_sec=1.0,
            )

    TimeSource.clock_callback = guarded  # type: ignore[method-assign, assignment]


def guard_transitions(node: LifecycleNode, tell: Callable[[Exception], None]) -> None:
    """From now on a lifecycle node refuses transitions that its state does not have, and tells what callbacks raise.

    rclpy's service lets the error of the first one through: to activate an active controller would end its process.
    What a callback of a transition raises, rclpy keeps to itself: the node would be in an error state without a word.

    Parameters
    ----------
    node
        Created, and served by no executor yet.
    tell
        Gets what a callback raised, before rclpy does.
    """
    service: Any = node._service_change_state
    follow = service.callback

    def change_state(request: ChangeState.Request, response: ChangeState.Response) -> ChangeState.Response:
        try:
            return follow(request, response)
        except rclpy_implementation.RCLError:
            _, state = node._state_machine.current_state
            asked = request.transition.label or request.transition.id
            node.get_logger().error(f"transition {asked} refused: it is not possible in the state '{state}'")
            response.success = False
            return response

    def telling(callback: Callable[[LifecycleState], TransitionCallbackReturn]) -> Callable[..., Any]:
        def call(state: LifecycleState) -> TransitionCallbackReturn:
            try:
                return callback(state)
            except Exception as error:
                tell(error)
                raise

        return call

    service.callback = change_state
    node._callbacks = {state: telling(callback) for state, callback in node._callbacks.items()}


def create_deferred_service(node: Node, kind: type, name: str, callback: Callable[[Any], Future[Any]]) -> None:
    """A service whose response may come after its callback has returned.

    It is sent as soon as the future that the callback returns has it, set in the executor's thread. Meanwhile the node
    goes on.

    rclpy sends what the callback returns as soon as it does, and `EventsExecutor` takes no coroutine for a callback.
    """
    service: Any = node.create_service(kind, name, lambda request, _: callback(request))
    send = service.send_response
    service.send_response = lambda answer, header: answer.add_done_callback(lambda done: send(done.result(), header))


def parameter_overrides(node: Node) -> set[str]:
    """Names of the parameters that were given to a node at its start, declared or not.

    rclpy keeps those that no node declares to itself, and says nothing of them.

    Parameters
    ----------
    node
        the node

    Returns
    -------
    set[str]
        the names
    """
    return set(node._parameter_overrides)


def waiting(subscription: Subscription, *, raw: bool = False) -> Iterator[Any]:
    """The messages that have come since the executor has taken one.

    rclpy hands messages to callbacks, one for each turn of an executor, and has no call to take what waits.

    Parameters
    ----------
    subscription
        whose messages they are
    raw
        whether they are to be bytes

    Yields
    ------
    Any
        a message
    """
    with subscription.handle:
        while (taken := subscription.handle.take_message(subscription.msg_type, raw)) is not None:
            yield taken[0]
