# SPDX-License-Identifier: Apache-2.0
"""What tests do with running nodes: collect messages, call services, change states and parameters."""

from __future__ import annotations

import contextlib
import time
from pathlib import Path
from typing import Any

from diagnostic_msgs.msg import DiagnosticArray
from lifecycle_msgs.msg import State, Transition
from lifecycle_msgs.srv import ChangeState, GetState
from rcl_interfaces.msg import SetParametersResult
from rcl_interfaces.srv import SetParametersAtomically
from rclpy.node import Node
from rclpy.parameter import Parameter
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from rclpy.task import Future

from ros_testing import STARTUP_TIMEOUT, spin_until

ROOT = Path(__file__).resolve().parents[1]
ROBOT_FILE = ROOT / "config" / "baxter.yaml"
TASK_FILE = ROOT / "config" / "pick_place.yaml"
SECOND = 1_000_000_000
#: A request without an answer for so long is sent again, s.
ASK_AGAIN = 8.0

#: Keeps all that comes from a stream, which is best effort.
ALL = QoSProfile(depth=1000, reliability=ReliabilityPolicy.BEST_EFFORT)
#: Keeps all that comes from a latched topic, with what was there before.
ALL_LATCHED = QoSProfile(
    depth=1000, reliability=ReliabilityPolicy.RELIABLE, durability=DurabilityPolicy.TRANSIENT_LOCAL
)

CONFIGURE = Transition.TRANSITION_CONFIGURE
ACTIVATE = Transition.TRANSITION_ACTIVATE
DEACTIVATE = Transition.TRANSITION_DEACTIVATE
CLEANUP = Transition.TRANSITION_CLEANUP
LEADS_TO = {
    CONFIGURE: State.PRIMARY_STATE_INACTIVE,
    ACTIVATE: State.PRIMARY_STATE_ACTIVE,
    DEACTIVATE: State.PRIMARY_STATE_INACTIVE,
    CLEANUP: State.PRIMARY_STATE_UNCONFIGURED,
}


class Inbox:
    """All messages of a topic since the start, or since `clear()`."""

    def __init__(self, node: Node, kind: type, topic: str, qos: QoSProfile = ALL) -> None:
        self.messages: list[Any] = []
        node.create_subscription(kind, topic, self.messages.append, qos)

    @property
    def last(self) -> Any:
        """The newest message, None without one."""
        return self.messages[-1] if self.messages else None

    def clear(self) -> None:
        self.messages.clear()


class Diagnostics:
    """What each node has said last about itself on `/diagnostics`: its message and its values."""

    def __init__(self, node: Node) -> None:
        self.messages: dict[str, str] = {}
        self.values: dict[str, dict[str, str]] = {}
        node.create_subscription(DiagnosticArray, "/diagnostics", self._take, 10)

    def _take(self, array: DiagnosticArray) -> None:
        for status in array.status:
            self.messages[status.name] = status.message
            self.values[status.name] = {item.key: item.value for item in status.values}


def result_of(node: Node, future: Future, what: str, timeout: float = STARTUP_TIMEOUT) -> Any:
    """The result of a future, served by `node` until it is there."""
    spin_until(node, future.done, timeout, what)
    return future.result()


def call(node: Node, kind: type, name: str, request: Any) -> Any:
    """The response of a service."""
    return ask(node, kind, name, request)[0]


def ask(node: Node, kind: type, name: str, request: Any) -> tuple[Any, int]:
    """The response of a service, and how often it was asked.

    It is asked again after some seconds: on a busy machine the middleware may drop a response, where the server has
    not discovered the client's side of the response yet when it has the request.
    """
    client = node.create_client(kind, name)
    asked: list[Future] = []
    due = 0.0

    def is_answered() -> bool:
        nonlocal due
        if time.monotonic() >= due:
            due = time.monotonic() + ASK_AGAIN
            asked.append(client.call_async(request))
        return any(future.done() for future in asked)

    try:
        spin_until(node, client.service_is_ready, message=f"service {name}")
        spin_until(node, is_answered, message=f"{name} to answer")
        if len(asked) > 1:  # what was asked again is not obeyed after what is asked next; an answer may be lost
            with contextlib.suppress(AssertionError):
                spin_until(node, lambda: all(future.done() for future in asked), ASK_AGAIN)
        return next(future.result() for future in asked if future.done()), len(asked)
    finally:
        node.destroy_client(client)


def change_state(node: Node, target: str, *transitions: int) -> bool:
    """Ask a lifecycle node for transitions; whether all succeeded."""
    for transition in transitions:
        request = ChangeState.Request(transition=Transition(id=transition))
        response, asked = ask(node, ChangeState, f"{target}/change_state", request)
        if not response.success:
            # one that was asked for again may have been made at the first request, whose answer is lost
            state = call(node, GetState, f"{target}/get_state", GetState.Request()).current_state.id
            if asked == 1 or state != LEADS_TO.get(transition):
                return False
    return True


def set_parameters(node: Node, target: str, **values: bool | int | float | str) -> SetParametersResult:
    """Set parameters of another node, all or none."""
    request = SetParametersAtomically.Request(
        parameters=[Parameter(name, value=value).to_parameter_msg() for name, value in values.items()]
    )
    return call(node, SetParametersAtomically, f"{target}/set_parameters_atomically", request).result


def ros_arguments(**parameters: object) -> list[str]:
    """The command line that gives a node its parameters."""
    arguments = ["--ros-args"]
    for name, value in parameters.items():
        arguments += ["-p", f"{name}:={str(value).lower() if isinstance(value, bool) else value}"]
    return arguments
