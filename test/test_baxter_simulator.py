# SPDX-License-Identifier: Apache-2.0
"""baxter_simulator on its topics: torques of all kinds in, joint states and end point poses out."""

from __future__ import annotations

import signal
from collections.abc import Callable, Sequence
from functools import partial

import numpy as np
import pytest
from geometry_msgs.msg import PoseStamped, WrenchStamped
from rclpy.node import Node
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import JointState

from ros_graph import ALL, ROBOT_FILE, SECOND, Inbox, ros_arguments
from ros_testing import RunningProcess, StartProcess, spin_until
from tpgmm_core.robot.model import RobotModel
from tpgmm_ros.messages import conversions
from tpgmm_ros.messages.conversions import JointReader
from tpgmm_ros.messages.qos import STREAM

ROBOT = RobotModel.from_file(ROBOT_FILE)
DATA = ROBOT.create_data()
NAMES = list(ROBOT.joint_names)
TICK_NS = SECOND // 1000
LEFT_ARM = ROBOT.indices(ROBOT.endpoints["left"].joints)

Torque = Callable[[np.ndarray, np.ndarray], np.ndarray]


def compensation(q: np.ndarray, v: np.ndarray) -> np.ndarray:
    """Torques (nv,) that carry the robot, and nothing else."""
    return DATA.nonlinear_effects(q, v).copy()


def leading(q: np.ndarray, v: np.ndarray) -> np.ndarray:
    """Torques (nv,) under which the left arm may be led and the other joints are damped firmly."""
    damping = np.full(ROBOT.nv, 5.0)
    damping[LEFT_ARM] = 1.0
    return compensation(q, v) - damping * v


def stamp_of(message: JointState) -> int:
    return conversions.time_to_ns(message.header.stamp)


class Lockstep:
    """Answers the states of a simulator in lockstep, as many as it is asked to."""

    def __init__(self, node: Node, process: RunningProcess) -> None:
        self.node, self.process = node, process
        self.reader = JointReader(NAMES)
        self.torques = node.create_publisher(JointState, "joint_torques", STREAM)
        self.wrenches = node.create_publisher(WrenchStamped, "external_wrench", STREAM)
        self.clock = Inbox(node, Clock, "/clock")
        self.states: list[JointState] = []
        self._left = 0
        self._torque: Torque = compensation
        self._order: Sequence[int] = range(ROBOT.nv)
        node.create_subscription(JointState, "joint_states", self._take, ALL)
        spin_until(node, lambda: self.states, message="a joint state", processes=(process,))

    @property
    def state(self) -> tuple[np.ndarray, np.ndarray]:
        """Positions and velocities (nv,) that came last."""
        q, v = self.reader.read(self.states[-1], "position", "velocity")
        return q, v

    @property
    def hand(self) -> np.ndarray:
        """Position (3,) of the left hand, m."""
        DATA.update(self.state[0])
        return DATA.pose("left")[:3]

    @property
    def hand_speed(self) -> float:
        DATA.update(*self.state)
        return float(np.linalg.norm(DATA.twist("left")[:3]))

    def advance(self, ticks: int, torque: Torque = compensation, order: Sequence[int] | None = None) -> JointState:
        """Answer this many states; returns the one that came of it. `order`: in which the joints are named."""
        goal = stamp_of(self.states[-1]) + ticks * TICK_NS
        self._left, self._torque, self._order = ticks, torque, range(ROBOT.nv) if order is None else order
        self._answer(self.states[-1])
        spin_until(
            self.node, lambda: stamp_of(self.states[-1]) >= goal, message="the next states", processes=(self.process,)
        )
        return self.states[-1]

    def _take(self, message: JointState) -> None:
        new = not self.states or stamp_of(message) > stamp_of(self.states[-1])
        self.states.append(message)
        self._left -= new
        # A state that comes again says that the answer was lost
        if self._left > 0:
            self._answer(message)

    def _answer(self, message: JointState) -> None:
        tau = self._torque(*self.reader.read(message, "position", "velocity"))
        names = [NAMES[i] for i in self._order]
        self.torques.publish(conversions.joint_state_message(names, stamp_of(message), effort=tau[list(self._order)]))

    def refuse_to_advance(self, publish: Callable[[], None], until: Callable[[], bool]) -> None:
        """Publish until a condition holds and the same state has come again, and see that time stood still."""
        self._left = 0
        stamp, seen = stamp_of(self.states[-1]), len(self.states)

        def asked_again() -> bool:
            publish()
            return until() and len(self.states) > seen + 1

        spin_until(self.node, asked_again, message="the same state again", processes=(self.process,))
        assert {stamp_of(message) for message in self.states[seen:]} == {stamp}


@pytest.fixture(scope="module")
def lockstep(module_node: Node, start_module_process: StartProcess) -> Lockstep:
    process = start_module_process("baxter_simulator", *ros_arguments(robot_file=ROBOT_FILE, lockstep=True))
    return Lockstep(module_node, process)


def test_in_lockstep_the_clock_stands_still_until_a_state_is_answered(lockstep: Lockstep) -> None:
    lockstep.refuse_to_advance(publish=lambda: None, until=lambda: True)
    before = stamp_of(lockstep.states[-1])
    lockstep.clock.clear()
    after = lockstep.advance(20)
    assert stamp_of(after) - before == 20 * TICK_NS
    clock = [conversions.time_to_ns(message.clock) for message in lockstep.clock.messages]
    # a state that comes again brings its time again
    assert clock == sorted(clock) and set(clock) <= {before + i * TICK_NS for i in range(21)}


def test_an_unanswered_state_comes_again_with_its_time_for_who_came_later(lockstep: Lockstep) -> None:
    stamp = stamp_of(lockstep.states[-1])
    lockstep.clock.clear()
    seen = len(lockstep.states)
    spin_until(lockstep.node, lambda: len(lockstep.clock.messages) > 1 and len(lockstep.states) > seen + 1)
    assert {conversions.time_to_ns(message.clock) for message in lockstep.clock.messages} == {stamp}
    assert {stamp_of(state) for state in list(lockstep.states)[seen:]} == {stamp}


def test_poses_of_an_earlier_step_come_again_too_for_who_was_started_again_since(lockstep: Lockstep) -> None:
    poses = Inbox(lockstep.node, PoseStamped, "endpoint/left/pose", ALL)
    after_a_pose = lockstep.advance(10 - stamp_of(lockstep.states[-1]) // TICK_NS % 10 + 3)
    poses.clear()  # this one listened only now
    spin_until(lockstep.node, lambda: len(poses.messages) > 1, message="the pose", processes=(lockstep.process,))
    stamps = {conversions.time_to_ns(message.header.stamp) for message in poses.messages}
    assert stamps == {stamp_of(after_a_pose) - 3 * TICK_NS}


def test_an_answer_to_another_state_does_not_advance_the_clock(lockstep: Lockstep) -> None:
    stamp = stamp_of(lockstep.states[-1])
    for wrong in (stamp - TICK_NS, stamp + TICK_NS, 0):
        late = conversions.joint_state_message(NAMES, wrong, effort=np.zeros(ROBOT.nv))
        lockstep.refuse_to_advance(partial(lockstep.torques.publish, late), until=lambda: True)


def test_torques_are_matched_by_the_joints_names(lockstep: Lockstep) -> None:
    asked = np.arange(ROBOT.nv) * 0.1
    order = np.random.default_rng(0).permutation(ROBOT.nv)
    state = lockstep.advance(1, lambda q, v: asked, order=order.tolist())
    (applied,) = lockstep.reader.read(state, "effort")
    np.testing.assert_allclose(applied, np.minimum(asked, ROBOT.effort_limits))


def test_torques_beyond_the_limits_are_clamped_to_them(lockstep: Lockstep) -> None:
    for sign in (1.0, -1.0):
        beyond = np.full(ROBOT.nv, sign * 1e6)
        state = lockstep.advance(3, lambda q, v, beyond=beyond: beyond)  # type: ignore[misc]
        (applied,) = lockstep.reader.read(state, "effort")
        np.testing.assert_allclose(applied, sign * ROBOT.effort_limits)
        assert np.isfinite(lockstep.state).all()


@pytest.mark.parametrize(
    ("reason", "names", "effort"),
    [
        ("effort of left_s0 is not finite", NAMES, np.where(np.array(NAMES) == "left_s0", np.nan, 1.0)),
        ("joints missing: head_pan", [name for name in NAMES if name != "head_pan"], np.ones(ROBOT.nv - 1)),
        (f"effort has 3 numbers for {ROBOT.nv} joint names", NAMES, np.ones(3)),
        ("left_s0 is named twice", [*NAMES[1:], NAMES[1]], np.ones(ROBOT.nv)),
    ],
)
def test_torques_that_cannot_be_used_are_refused_with_the_reason(
    lockstep: Lockstep, reason: str, names: list[str], effort: np.ndarray
) -> None:
    bad = conversions.joint_state_message(names, stamp_of(lockstep.states[-1]), effort=effort)
    lockstep.refuse_to_advance(
        lambda: lockstep.torques.publish(bad), until=lambda: f"torques refused: {reason}" in lockstep.process.output
    )
    lockstep.advance(1)


def test_a_push_moves_the_hand_its_way_and_ends_when_it_is_not_repeated(lockstep: Lockstep) -> None:
    for direction in (np.array([0.0, 1.0, 0.0]), np.array([0.0, 0.0, 1.0])):
        lockstep.advance(300, lambda q, v: compensation(q, v) - 5.0 * v)  # to rest
        start = lockstep.hand
        push = conversions.wrench_from_array([*(10.0 * direction), 0.0, 0.0, 0.0], 0, "left_gripper")
        for _ in range(15):
            lockstep.wrenches.publish(push)
            lockstep.advance(10, leading)
        way = lockstep.hand - start
        assert way @ direction > 0.005
        assert way @ direction > 0.7 * np.linalg.norm(way)
        lockstep.advance(250, leading)  # the wrench's time-out is 0.2 s
        speed = lockstep.hand_speed
        lockstep.advance(300, leading)
        assert lockstep.hand_speed < 0.9 * speed, "friction alone brakes a hand that nobody pushes any more"


def test_a_hand_that_is_led_is_let_go_of_at_once(lockstep: Lockstep) -> None:
    lead = lockstep.node.create_publisher(PoseStamped, "lead/left/pose", STREAM)
    lockstep.advance(300, lambda q, v: compensation(q, v) - 5.0 * v)  # to rest
    far = np.array([*(lockstep.hand + [0.0, 0.0, 0.3]), 0.0, 1.0, 0.0, 0.0])
    own = np.array([0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0])

    def told(pose: np.ndarray, frame: str, ticks: int) -> float:
        """Tell the simulator all the time; the hand's speed, m/s, then."""
        for _ in range(ticks // 10):
            lead.publish(conversions.pose_stamped(pose, stamp_of(lockstep.states[-1]), frame))
            lockstep.advance(10, leading)
        return lockstep.hand_speed

    slow, fast = (told(far, ROBOT.base_frame, ticks) for ticks in (150, 100))
    assert fast > slow, "it is still being pulled faster"
    speed = told(own, ROBOT.endpoints["left"].frame, 30)
    assert told(own, ROBOT.endpoints["left"].frame, 100) < 0.9 * speed, "and is not, long before the time-out of 0.2 s"


def test_pushes_at_two_links_that_have_waited_together_both_count(lockstep: Lockstep) -> None:
    for _ in range(3):
        lockstep.advance(500, lambda q, v: compensation(q, v) - 5.0 * v)
        DATA.update(*lockstep.state)
        before = np.array([DATA.twist(hand)[2] for hand in ("left", "right")])  # what earlier pushes have left
        lockstep.process.send_signal(signal.SIGSTOP)
        for hand in ("left", "right"):
            push = [0.0, 0.0, 10.0, 0.0, 0.0, 0.0]
            lockstep.wrenches.publish(conversions.wrench_from_array(push, 0, ROBOT.endpoints[hand].frame))
        lockstep.process.send_signal(signal.SIGCONT)
        lockstep.advance(100)
        DATA.update(*lockstep.state)
        left, right = np.array([DATA.twist(hand)[2] for hand in ("left", "right")]) - before
        assert min(left, right) > 0.05, (left, right)


@pytest.mark.parametrize(
    ("reason", "link", "force"), [("nowhere", "nowhere", 1.0), ("is not finite", "left_gripper", np.nan)]
)
def test_a_push_that_cannot_be_applied_is_refused_with_the_reason(
    lockstep: Lockstep, reason: str, link: str, force: float
) -> None:
    wrench = conversions.wrench_from_array([force, 0.0, 0.0, 0.0, 0.0, 0.0], 0, link)

    def refused() -> bool:
        lockstep.wrenches.publish(wrench)
        lockstep.advance(1, leading)
        lines = [line for line in lockstep.process.output.splitlines() if "wrench refused" in line]
        return any(reason in line for line in lines)

    spin_until(lockstep.node, refused, message=f"'{reason}' in the log")
    assert np.isfinite(lockstep.state).all()


def test_in_real_time_the_robot_carries_itself_and_brakes_while_nobody_commands_it(
    ros_node: Node, start_process: StartProcess
) -> None:
    process = start_process("baxter_simulator", *ros_arguments(robot_file=ROBOT_FILE, rate=500.0))
    states = Inbox(ros_node, JointState, "joint_states")
    poses = {name: Inbox(ros_node, PoseStamped, f"endpoint/{name}/pose") for name in ROBOT.endpoints}
    torques = ros_node.create_publisher(JointState, "joint_torques", STREAM)
    reader = JointReader(NAMES)

    def wait(condition: Callable[[], bool], message: str) -> None:
        spin_until(ros_node, condition, message=message, processes=(process,))

    def velocity() -> np.ndarray:
        return reader.read(states.last, "velocity")[0]

    wait(lambda: len(states.messages) > 200, "joint states")
    wait(lambda: all(len(inbox.messages) > 10 for inbox in poses.values()), "poses of both hands")
    for message in states.messages:
        assert sorted(message.name) == sorted(NAMES)
        assert np.isfinite(reader.read(message, "position", "velocity", "effort")).all()
    assert all(b > a for a, b in zip(map(stamp_of, states.messages), map(stamp_of, states.messages[1:]), strict=False))
    (q,) = reader.read(states.last, "position")
    np.testing.assert_allclose(q, ROBOT.home, atol=1e-3)
    for name, inbox in poses.items():
        DATA.update(ROBOT.home)
        assert inbox.last.header.frame_id == ROBOT.base_frame
        np.testing.assert_allclose(conversions.pose_to_array(inbox.last.pose), DATA.pose(name), atol=2e-3)

    elbow = NAMES.index("left_e1")

    def driven() -> bool:
        tau = compensation(*reader.read(states.last, "position", "velocity"))
        tau[elbow] -= 3.0
        torques.publish(conversions.joint_state_message(NAMES, stamp_of(states.last), effort=tau))
        return velocity()[elbow] < -0.2

    def at_rest_under(effort: np.ndarray | None) -> Callable[[], bool]:
        def at_rest() -> bool:
            if effort is not None:
                torques.publish(conversions.joint_state_message(NAMES, stamp_of(states.last), effort=effort))
            return bool(np.abs(velocity()).max() < 0.02)

        return at_rest

    wait(driven, "the elbow to move")
    wait(at_rest_under(None), "braking after the torques have stopped")
    wait(driven, "the elbow to move")
    wait(at_rest_under(np.full(ROBOT.nv, np.nan)), "braking while only torques that are not finite come")
    assert "torques refused" in process.output
