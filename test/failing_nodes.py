# SPDX-License-Identifier: Apache-2.0
"""Two nodes in one process: one counts what comes, the other fails at a message, a request, a goal, or at its end."""

from __future__ import annotations

import sys

from rclpy.action import ActionServer, GoalResponse
from rclpy.node import Node
from std_msgs.msg import Int64
from std_srvs.srv import Trigger

from tpgmm_msgs.action import Reproduce
from tpgmm_ros.runtime.executor import run_together


class Counter(Node):
    """Publishes how many messages it has taken."""

    def __init__(self) -> None:
        super().__init__("counter")
        self._taken = 0
        self._count = self.create_publisher(Int64, "count", 10)
        self._twos = self.create_publisher(Int64, "twos", 10)
        self.create_subscription(Int64, "number", self._take, 10)

    def _take(self, message: Int64) -> None:
        self._taken += 1
        self._count.publish(Int64(data=self._taken))
        if message.data == 2:
            self._twos.publish(message)


class Failing(Node):
    """Passes on what comes as `number`, until it is a 7 or an 8, somebody asks, or the other has counted a 2."""

    def __init__(self) -> None:
        super().__init__("failing")
        self._numbers = self.create_publisher(Int64, "number", 10)
        self.create_subscription(Int64, "given", self._take, 10)
        self.create_subscription(Int64, "twos", self._hear, 10)
        self.create_service(Trigger, "fail", self._fail)
        ActionServer(self, Reproduce, "reproduce", lambda goal: Reproduce.Result(), goal_callback=self._accept)
        self._ends_in_order = True

    def _take(self, message: Int64) -> None:
        self._ends_in_order = message.data != 8
        if message.data in (7, 8):
            raise RuntimeError("seven or eight")
        self._numbers.publish(message)

    def _hear(self, message: Int64) -> None:
        raise RuntimeError("a two")

    def _fail(self, request: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        raise RuntimeError("as it was asked")

    def _accept(self, goal: Reproduce.Goal) -> GoalResponse:
        raise RuntimeError("no such goal")

    def destroy_node(self) -> None:
        self._numbers.publish(Int64(data=-1))  # its last word
        if not self._ends_in_order:
            raise RuntimeError("at the end")
        super().destroy_node()


if __name__ == "__main__":
    sys.exit(run_together([Counter, Failing], sys.argv))
