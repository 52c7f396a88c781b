# SPDX-License-Identifier: Apache-2.0
"""What was destroyed is not called back any more, although the executor has it in its queue."""

from __future__ import annotations

import threading

import pytest
from rclpy.action import ActionClient, ActionServer
from rclpy.duration import Duration
from rclpy.node import Node
from rclpy.qos import QoSProfile
from rclpy.timer import Timer
from std_msgs.msg import Int64
from std_srvs.srv import Trigger

from ros_testing import spin_until
from tpgmm_msgs.action import Reproduce
from tpgmm_ros.runtime.rclpy_workarounds import waiting

TURNS = 20


def turns(node: Node) -> None:
    """As many as all that waits can take."""
    for _ in range(TURNS):
        assert node.executor is not None
        node.executor.spin_once(timeout_sec=0.01)


def test_of_two_timers_that_are_due_at_once_the_first_can_destroy_the_second_and_what_it_publishes(
    ros_node: Node,
) -> None:
    timers: dict[str, Timer] = {}
    publishers = {name: ros_node.create_publisher(Int64, name, 1) for name in ("a", "b")}
    called: list[str] = []

    def first_of(name: str, other: str) -> None:
        publishers[name].publish(Int64())
        called.append(name)
        ros_node.destroy_timer(timers[other])
        ros_node.destroy_publisher(publishers[other])

    timers["a"] = ros_node.create_timer(1.0, lambda: first_of("a", "b"))
    timers["b"] = ros_node.create_timer(1.0, lambda: first_of("b", "a"))
    turns(ros_node)  # known to the executor, and both due before it has its next turn
    assert not called
    threading.Event().wait(1.2)
    turns(ros_node)
    assert len(set(called)) == 1


def test_a_subscription_can_be_destroyed_while_messages_wait_for_it(ros_node: Node) -> None:
    qos = QoSProfile(depth=10)
    taken: list[Int64] = []

    def take(message: Int64) -> None:
        if not taken:
            ros_node.destroy_subscription(subscription)
        else:  # as a node does that wants all that waits
            taken.extend(waiting(subscription))
        taken.append(message)

    subscription = ros_node.create_subscription(Int64, "numbers", take, qos)
    publisher = ros_node.create_publisher(Int64, "numbers", qos)
    spin_until(ros_node, lambda: publisher.get_subscription_count() == 1)
    turns(ros_node)
    for number in range(5):
        publisher.publish(Int64(data=number))
    assert publisher.wait_for_all_acked(Duration(seconds=10.0))
    turns(ros_node)
    assert [message.data for message in taken] == [0]


@pytest.mark.parametrize("kind", ["service", "action"])
def test_a_request_to_what_was_destroyed_meanwhile_ends_nobody(ros_node: Node, kind: str) -> None:
    asked: list[object] = []

    def answer(request: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        asked.append(request)
        return response

    assert ros_node.executor is not None
    client: ActionClient | object
    if kind == "service":
        service = ros_node.create_service(Trigger, "asked", answer)
        client = ros_node.create_client(Trigger, "asked")
        spin_until(ros_node, client.service_is_ready)
        turns(ros_node)
        client.call_async(Trigger.Request())
        threading.Event().wait(0.3)  # it has come, and no turn was given
        ros_node.destroy_service(service)
    else:
        server = ActionServer(ros_node, Reproduce, "asked", asked.append, goal_callback=asked.append)
        client = ActionClient(ros_node, Reproduce, "asked")
        spin_until(ros_node, client.server_is_ready)
        turns(ros_node)
        client.send_goal_async(Reproduce.Goal())
        threading.Event().wait(0.3)
        server.destroy()
    turns(ros_node)
    assert not asked
