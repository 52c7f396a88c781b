# SPDX-License-Identifier: Apache-2.0
"""A driver as drivers are: publishes what it hears on `driver/joint_states`, until SIGINT or SIGTERM.

How, it is told on `driver/manner`, by one of the names in MANNERS. A process of its own: whoever looks on has no time.
"""

from __future__ import annotations

from array import array
from collections.abc import Callable

import numpy as np
import rclpy
from rclpy.signals import SignalHandlerOptions
from sensor_msgs.msg import JointState
from std_msgs.msg import String

from faults.parts import part
from tpgmm_ros.messages import conversions
from tpgmm_ros.messages.qos import LATCHED, STATES, STREAM
from tpgmm_ros.runtime.executor import StopFlag
from tpgmm_ros.runtime.processes import REALTIME_PRIORITY
from tpgmm_ros.runtime.rclpy_events import NodeExecutor
from tpgmm_ros.runtime.scheduling import request_realtime

type Publish = Callable[[JointState], None]

MANNER_TOPIC = "driver/manner"
#: Between two states of a slow driver, ns.
SLOW_NS = 20_000_000


class Relay:
    """Publishes joint states in one of several manners."""

    def __init__(self, publish: Publish) -> None:
        self._publish = publish
        self._rng = np.random.default_rng(0)
        self._late: list[tuple[int, JointState]] = []
        self._count = self._due_ns = 0
        self.manner = "faithfully"

    def take(self, state: JointState) -> None:
        self._count += 1
        MANNERS[self.manner](self, state)

    def faithfully(self, state: JointState) -> None:
        self._publish(state)

    def out_of_order(self, state: JointState) -> None:
        """One in a hundred comes up to 5 states later."""
        if self._rng.random() < 0.01:
            self._late.append((self._count + int(self._rng.integers(1, 6)), state))
            return
        self._publish(state)
        for item in [item for item in self._late if item[0] <= self._count]:
            self._late.remove(item)
            self._publish(item[1])

    def in_parts(self, state: JointState) -> None:
        stamp_ns = conversions.time_to_ns(state.header.stamp)
        left = [name for name in state.name if name.startswith("left")]
        self._publish(part(state, [name for name in state.name if name not in left], stamp_ns))
        self._publish(part(state, left, stamp_ns + 300_000))

    def without_stamps(self, state: JointState) -> None:
        state.header.stamp = conversions.time_from_ns(0)
        self._publish(state)

    def at_50_hz(self, state: JointState) -> None:
        """However many states per second come, up to 500."""
        stamp_ns = conversions.time_to_ns(state.header.stamp)
        if stamp_ns >= self._due_ns:
            self._due_ns = max(self._due_ns + SLOW_NS, stamp_ns + SLOW_NS // 2)
            self._publish(state)

    def leaping(self, state: JointState) -> None:
        """A joint of one state in fifty is elsewhere."""
        if self._count % 50 == 0:
            state.position[state.name.index("left_e0")] += 0.5
        self._publish(state)

    def beside_another_robot(self, state: JointState) -> None:
        """Another robot of this kind rests at other joints."""
        self._publish(state)
        stamp_ns = conversions.time_to_ns(state.header.stamp) + 300_000
        elsewhere = np.full(len(state.name), 0.3)
        self._publish(conversions.joint_state_message(list(state.name), stamp_ns, elsewhere, 0.0 * elsewhere))

    def without_velocities(self, state: JointState) -> None:
        """As drivers do that have none, and must fill the field."""
        state.velocity = array("d", bytes(8 * len(state.name)))
        self._publish(state)

    def in_degrees(self, state: JointState) -> None:
        state.velocity = array("d", np.degrees(state.velocity))
        self._publish(state)

    def without_an_elbow(self, state: JointState) -> None:
        stamp_ns = conversions.time_to_ns(state.header.stamp)
        self._publish(part(state, [name for name in state.name if name != "left_e1"], stamp_ns))


MANNERS: dict[str, Callable[[Relay, JointState], None]] = {
    function.__name__: function
    for function in (
        Relay.faithfully,
        Relay.out_of_order,
        Relay.in_parts,
        Relay.without_stamps,
        Relay.at_50_hz,
        Relay.leaping,
        Relay.beside_another_robot,
        Relay.without_velocities,
        Relay.in_degrees,
        Relay.without_an_elbow,
    )
}


def main() -> None:
    rclpy.init(signal_handler_options=SignalHandlerOptions.NO)
    stop = StopFlag()
    node = rclpy.create_node("driver")
    relay = Relay(node.create_publisher(JointState, "joint_states", STREAM).publish)

    def choose(message: String) -> None:
        relay.manner = message.data
        print(f"manner: {message.data}", flush=True)

    node.create_subscription(JointState, "driver/joint_states", relay.take, STATES)
    node.create_subscription(String, MANNER_TOPIC, choose, LATCHED)
    executor = NodeExecutor()
    executor.add_node(node)
    request_realtime(REALTIME_PRIORITY)
    while not stop.set:
        executor.spin_once(timeout_sec=0.1)
    rclpy.shutdown()


if __name__ == "__main__":
    main()
