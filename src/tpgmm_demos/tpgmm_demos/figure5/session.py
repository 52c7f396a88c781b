# SPDX-License-Identifier: Apache-2.0
"""A simulated Baxter, the nodes that move it, and whoever touches it: over topics, in lockstep or in real time.

In lockstep the simulator waits, at each pose of the hands, for a wrench. Who touches the robot in several places
takes turns: one wrench per pose, each in force until its next turn.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from geometry_msgs.msg import WrenchStamped
from sensor_msgs.msg import JointState

from tpgmm_core.common.types import Array
from tpgmm_core.robot.model import RobotModel
from tpgmm_ros.messages import conversions
from tpgmm_ros.messages.conversions import JointReader
from tpgmm_ros.messages.qos import STREAM
from tpgmm_ros.runtime.graph import Graph
from tpgmm_ros.runtime.processes import REALTIME_PRIORITY

#: Wrenches per second; so often the simulator publishes poses and, in lockstep, waits for a wrench.
TOUCH_RATE = 500.0
#: Samples per second that are kept.
SAMPLE_RATE = 100.0
START_TIMEOUT = 60.0
SECOND = 1_000_000_000

#: A wrench (6,) at a link, N and N m in base axes, from the time of the segment (s) and the pose (7,) of the link.
Wrench = Callable[[float, Array], Array]


@dataclass(slots=True)
class Trace:
    """What happened in some time with the same contacts: samples at `SAMPLE_RATE`, extremes of all ticks.

    Attributes
    ----------
    time
        (T,), s since its beginning
    q, v, tau
        (T, nv)
    force
        (T,), N, the sum over all contacts of their forces' lengths
    torque_share
        largest |tau| / effort limit of all ticks
    stop_distance
        (nv,), smallest distance to a position limit of all ticks, rad or m
    """

    times: list[float] = field(default_factory=list)
    states: list[tuple[Array, Array, Array]] = field(default_factory=list)
    forces: list[float] = field(default_factory=list)
    torque_share: float = 0.0
    stop_distance: Array = field(default_factory=lambda: np.zeros(0))

    def followed_by(self, other: Trace) -> Trace:
        """Both, one after the other."""
        offset = self.times[-1] + 1.0 / SAMPLE_RATE
        return Trace(
            self.times + [offset + time for time in other.times],
            self.states + other.states,
            self.forces + other.forces,
            max(self.torque_share, other.torque_share),
            np.minimum(self.stop_distance, other.stop_distance),
        )

    @property
    def time(self) -> Array:
        """Times (T,) since the beginning, s."""
        return np.array(self.times)

    @property
    def q(self) -> Array:
        """Joint positions (T, n), rad or m."""
        return np.stack([q for q, _, _ in self.states])

    @property
    def v(self) -> Array:
        """Joint velocities (T, n), rad/s or m/s."""
        return np.stack([v for _, v, _ in self.states])

    @property
    def tau(self) -> Array:
        """Joint torques (T, n), N m or N."""
        return np.stack([tau for _, _, tau in self.states])

    @property
    def force(self) -> Array:
        """Sum (T,) of the lengths of the forces of all contacts, N."""
        return np.array(self.forces)


class Session:
    """The running graph; `run` lets time pass.

    Parameters
    ----------
    graph
        with the program's own node, which nobody else serves meanwhile
    robot
        that is simulated
    lockstep
        simulated time, as fast as all can; else real time
    """

    def __init__(self, graph: Graph, robot: RobotModel, lockstep: bool) -> None:
        self.graph, node = graph, graph.node
        self.robot, self.lockstep = robot, lockstep
        self.data = robot.create_data()
        self._frames: dict[str, int] = {}
        self._reader = JointReader(robot.joint_names)
        self._tau = np.zeros(robot.nv)
        self._tau_stamp_ns = self._stamp_ns = -1
        self._due_ns = -1
        self._waiting = False
        self._last: WrenchStamped | None = None
        self._contacts: Sequence[tuple[str, Wrench]] | None = None
        self._turn = 0
        self._now: dict[str, Array] = {}
        self.q = self.v = np.zeros(robot.nv)
        self._wrenches = node.create_publisher(WrenchStamped, "external_wrench", STREAM)
        node.create_subscription(JointState, "joint_torques", self._take_torques, STREAM)
        node.create_subscription(JointState, "joint_states", self._take_state, STREAM)

    def start_simulator(self, robot_file: Path) -> None:
        """Start it last, when the other nodes are up: in lockstep it waits for them from its first step on."""
        self.graph.processes.start(
            "baxter_simulator",
            robot_file=robot_file,
            lockstep=self.lockstep,
            lockstep_wrench=self.lockstep,
            pose_rate=TOUCH_RATE,
            realtime_priority=self.priority,
        )
        self.graph.wait_for(lambda: self._stamp_ns >= 0, START_TIMEOUT, "the first joint state")

    @property
    def priority(self) -> int:
        """Real-time priority of the nodes; 0 in lockstep, where time waits."""
        return 0 if self.lockstep else REALTIME_PRIORITY

    def pose(self, link: str) -> Array:
        """Pose (7,) of a link where the robot is now."""
        self.data.update(self.q)
        return self._pose(link)

    def settle(self) -> None:
        """In lockstep: let all nodes answer the present state, so that what is changed now counts from the next on."""
        if self.lockstep:
            self.graph.wait_for(
                lambda: self._waiting and self._tau_stamp_ns == self._stamp_ns, START_TIMEOUT, "the nodes' answers"
            )

    def run(self, duration: float, contacts: Sequence[tuple[str, Wrench]] = ()) -> Trace:
        """Let time of the robot pass, while wrenches act on links; they end with it.

        Parameters
        ----------
        duration
            s
        contacts
            names of links, and what acts there

        Returns
        -------
        Trace
            samples of this time

        Raises
        ------
        GraphError
            when a node ends, or time stalls
        """
        segment, begin = Trace(stop_distance=np.full(self.robot.nv, np.inf)), self._stamp_ns
        self._segment, self._begin_ns, self._end_ns = segment, begin, begin + round(duration * SECOND)
        self._sample_ns = begin
        self._contacts = contacts
        # what was touched before and is no more has to be told so, in its turn
        self._released = [link for link in self._now if link not in {link for link, _ in contacts}]
        if self._waiting:
            self._answer()
        deadline = time.monotonic() + 60.0 + 60.0 * duration
        self.graph.wait_for(lambda: self._contacts is None, deadline - time.monotonic(), f"{duration:g} s to pass")
        return segment

    # -- topics -------------------------------------------------------------------------------------------------------

    def _take_torques(self, message: JointState) -> None:
        (self._tau,) = self._reader.read(message, "effort")
        self._tau_stamp_ns = conversions.time_to_ns(message.header.stamp)
        if self._contacts is not None:
            share = float(np.max(np.abs(self._tau) / self.robot.effort_limits))
            self._segment.torque_share = max(self._segment.torque_share, share)

    def _take_state(self, message: JointState) -> None:
        stamp_ns = conversions.time_to_ns(message.header.stamp)
        if stamp_ns <= self._stamp_ns:
            if self._last is not None and not self._waiting:
                self._wrenches.publish(self._last)  # it comes again, since an answer was lost
            return
        self._stamp_ns = stamp_ns
        self.q, self.v = self._reader.read(message, "position", "velocity")
        if self._due_ns < 0:
            self._due_ns = stamp_ns
        if self._contacts is not None:
            robot, nearest = self.robot, self._segment.stop_distance
            np.minimum(nearest, np.minimum(self.q - robot.lower_limits, robot.upper_limits - self.q), out=nearest)
        if stamp_ns < self._due_ns:
            return
        period = round(SECOND / TOUCH_RATE)
        self._due_ns += period * (1 + (stamp_ns - self._due_ns) // period)
        self._waiting = True
        if self._contacts is not None and stamp_ns >= self._end_ns:
            self._contacts = None
        # without anybody to say what follows, time stands still
        if self._contacts is not None or not self.lockstep:
            self._answer()

    def _answer(self) -> None:
        self._waiting = False
        self._sample()
        link, wrench = self._next_wrench()
        self._last = conversions.wrench_from_array(wrench, self._stamp_ns, link)
        self._wrenches.publish(self._last)

    def _next_wrench(self) -> tuple[str, Array]:
        if self._contacts is None:
            return self.robot.endpoints["left"].frame, np.zeros(6)
        if self._released:
            link = self._released.pop()
            del self._now[link]
            return link, np.zeros(6)
        if not self._contacts:
            return self.robot.endpoints["left"].frame, np.zeros(6)
        self._turn += 1
        link, wrench = self._contacts[self._turn % len(self._contacts)]
        self.data.update(self.q)
        self._now[link] = wrench(1e-9 * (self._stamp_ns - self._begin_ns), self._pose(link))
        return link, self._now[link]

    def _sample(self) -> None:
        if self._contacts is None or self._stamp_ns < self._sample_ns:
            return
        self._sample_ns += round(SECOND / SAMPLE_RATE)
        segment = self._segment
        segment.times.append(1e-9 * (self._stamp_ns - self._begin_ns))
        segment.states.append((self.q.copy(), self.v.copy(), self._tau.copy()))
        segment.forces.append(float(sum(np.linalg.norm(wrench[:3]) for wrench in self._now.values())))

    def _pose(self, link: str) -> Array:
        if link not in self._frames:
            self._frames[link] = self.robot.frame_id(link)
        return self.data.frame_pose(self._frames[link])
