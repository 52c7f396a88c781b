# SPDX-License-Identifier: Apache-2.0
"""The joint states that a node follows: complete ones, of its own joints, each once, and why none comes."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

from rclpy.clock import Clock, ClockType
from rclpy.node import Node
from sensor_msgs.msg import JointState

from tpgmm_core.common.types import Array
from tpgmm_core.observation.joint_states import MAX_SPREAD
from tpgmm_core.observation.streams import RESTARTED_AFTER, Leader, Stamp, StreamWatch, stamps_ahead, standing_still
from tpgmm_ros.messages.conversions import JointStates, MessageError
from tpgmm_ros.messages.joint_state_bytes import JointStateDecoder, JointStateValues
from tpgmm_ros.messages.qos import STATES
from tpgmm_ros.runtime.batches import Batches
from tpgmm_ros.runtime.parameters import Declared
from tpgmm_ros.runtime.timing import clock_trouble

SPREAD = Declared(
    "joint_state_spread",
    MAX_SPREAD,
    "Largest difference in time between messages that make up one joint state, s",
    0.0,
    1.0,
    fixed=True,
)
JOINT_STATE_RATE = Declared(
    "joint_state_rate",
    1000.0,
    "Rate at which joint states are expected, Hz: lost ones are counted",
    1.0,
    10000.0,
    fixed=True,
)
BROADCAST_ROBOT = Declared(
    "broadcast_transforms",
    False,
    "Publish robot_description, and the links on /tf and /tf_static; only if no robot_state_publisher runs",
    fixed=True,
)
MAX_FUTURE = Declared("max_future", 0.05, "Messages with stamps further in the future are refused, s", 0.001, 10.0)

#: Diagnostics name a silence that is longer, s.
SILENT_AFTER = 1.0


@dataclass(frozen=True, slots=True)
class Heard:
    """A state and what its stamp says: NEW, REPEATED or RESTARTED. Values as the fields were asked for, (n,) each."""

    kind: Stamp
    stamp_ns: int
    values: tuple[Array, ...]


class JointStateStream:
    """Subscribes to messages, and hands on states that are to be answered, each with what its stamp says.

    Of states that have waited together the newest is handed on: the others would be answered too late.

    Parameters
    ----------
    node
        says in its log what is refused
    topic
        of the messages
    answer
        called with each state
    joints
        whose states; None where no joint is known and states are only a beat, which `Leader` gives then
    fields
        what of them, "position", "velocity"
    max_spread
        parts of one state may be this far apart, s
    max_future
        called for what a stamp may be ahead of the clock, s; None: not asked
    """

    def __init__(
        self,
        node: Node,
        topic: str,
        answer: Callable[[Heard], object],
        joints: Sequence[str] | None,
        fields: Sequence[str] = (),
        max_spread: float = MAX_SPREAD,
        max_future: Callable[[], float] | None = None,
    ) -> None:
        self._node, self._answer = node, answer
        self._assembler = None if joints is None else JointStates(joints, fields, max_spread)
        self._leader, self._watch = Leader(), StreamWatch()
        self._max_future = max_future
        self._steady = Clock(clock_type=ClockType.STEADY_TIME)
        self._trouble: Callable[[], str] = str
        Batches(node, JointState, topic, self._take_all, STATES, JointStateDecoder())

    def _take_all(self, messages: Sequence[JointStateValues]) -> None:
        heard = [item for item in map(self.take, messages) if item is not None]
        if heard:
            # a copy that came with its original does not make the state an old one
            kinds = {item.kind for item in heard}
            kind = next(kind for kind in (Stamp.RESTARTED, Stamp.NEW, Stamp.REPEATED) if kind in kinds)
            self._answer(replace(heard[-1], kind=kind))

    def take(self, message: JointStateValues) -> Heard | None:
        """What a message has brought; None where that is nothing to answer."""
        now_ns = self._steady.now().nanoseconds
        stamp_ns = message.stamp_ns
        values: tuple[Array, ...] = ()
        if self._assembler is None:
            if not self._leader.is_led_by(message.name, now_ns):
                return None
        else:
            try:
                sample = self._assembler.take(message)
            except MessageError as error:
                self._refuse(str(error))
                return None
            if sample is None:
                self._trouble = self._assembler.incomplete
                return None
            stamp_ns, values = sample.stamp_ns, sample.values
        ahead = math.inf if self._max_future is None else self._max_future()
        kind = self._watch.judge(stamp_ns, now_ns, self._node.get_clock().now().nanoseconds, RESTARTED_AFTER, ahead)
        if kind is Stamp.FUTURE:
            self._refuse(stamps_ahead(ahead))
            return None
        if kind is Stamp.OLD:
            return None
        if kind is Stamp.REPEATED:
            self._trouble = lambda: standing_still(stamp_ns)
        else:
            self._watch.accept(stamp_ns, now_ns)
            self._trouble = str
        return Heard(kind, stamp_ns, values)

    def why_silent(self) -> str:
        """Why no new state comes, in words."""
        trouble = clock_trouble(self._node) or self._trouble()
        return trouble or "check that the robot is running, and that the topic is correct"

    def silence(self) -> list[str]:
        """That no new state has come for a second, and why, in words; nothing where states come."""
        age = self._watch.age(self._steady.now().nanoseconds)
        if age is not None and age <= SILENT_AFTER:
            return []
        return [f"no {'joint states yet' if age is None else 'more joint states'}: {self.why_silent()}"]

    def _refuse(self, reason: str) -> None:
        self._trouble = lambda: f"the newest was refused: {reason}"
        self._node.get_logger().error(f"joint state refused: {reason}", throttle_duration_sec=1.0)
