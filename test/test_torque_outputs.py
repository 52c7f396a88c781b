# SPDX-License-Identifier: Apache-2.0
"""Torques as messages for what drives the motors: what each holds, and on their topics."""

from __future__ import annotations

import math
import sys
from pathlib import Path

import numpy as np
import pytest
import yaml
from geometry_msgs.msg import Point, PoseStamped
from rclpy.node import Node
from rclpy.qos import QoSProfile, ReliabilityPolicy
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64MultiArray

from ros_graph import ACTIVATE, CONFIGURE, ROOT, Inbox, change_state, ros_arguments
from ros_testing import StartProcess, spin_until
from tpgmm_core.control.controller import Controller, TorqueCommand
from tpgmm_core.control.impedance import ImpedanceLaw
from tpgmm_core.control.pose_target import PoseReference
from tpgmm_core.control.torque_pipeline import TorqueLimits
from tpgmm_core.robot.model import RobotModel
from tpgmm_core.robot.simulation import RobotSimulator
from tpgmm_ros.messages import conversions, torque_outputs
from tpgmm_ros.messages.qos import STREAM
from tpgmm_ros.messages.torque_outputs import OUTPUTS, Leaving, filled, message_class

NODE = "impedance_controller"
PANDA_FILE = ROOT / "config" / "panda.yaml"
PANDA = RobotModel.from_file(PANDA_FILE)
ARM = PANDA.indices("arm")
STAMP_NS = 12_345_678_901
#: What ros2_control's controllers ask for
RELIABLE = QoSProfile(depth=10, reliability=ReliabilityPolicy.RELIABLE)


def controller_at_home(
    shift: tuple[float, float, float], period: float = math.inf, closed_elsewhere: bool = False
) -> tuple[Controller, object]:
    """A controller, and a target that lies aside of the hand (m)."""
    law, data = ImpedanceLaw(PANDA, "hand"), PANDA.create_data()
    data.update(PANDA.home)
    pose = data.pose("hand") + np.array([*shift, 0, 0, 0, 0])
    target = law.pose_target(PoseReference(pose, np.diag([1e-5] * 3 + [1e-3] * 3)))
    limits = TorqueLimits(max_time_step=0.05)
    return Controller(PANDA, law, limits, period, closed_elsewhere=closed_elsewhere), target


@pytest.fixture(scope="module")
def command() -> TorqueCommand:
    """Torques that pull the hand aside, while it moves."""
    controller, target = controller_at_home((0.0, 0.05, 0.0))
    v = np.linspace(-0.1, 0.1, PANDA.nv)
    for _ in range(500):
        command = controller.step(PANDA.home, v, target, 0.001)
    assert command is not None and command.law is not None and not command.reason
    return command


def leaving(command: TorqueCommand, joints: np.ndarray = ARM) -> Leaving:
    names = [PANDA.joint_names[i] for i in joints]
    return Leaving(names, joints, STAMP_NS, command.tau[joints], command)


def test_efforts_leave_by_name_or_in_the_order_of_the_group(command: TorqueCommand) -> None:
    backwards = leaving(command, ARM[::-1])
    state = filled(JointState(), torque_outputs.joint_state(backwards))
    assert list(state.name) == [f"panda_joint{i}" for i in range(7, 0, -1)]
    np.testing.assert_array_equal(state.effort, command.tau[::-1])
    assert conversions.time_to_ns(state.header.stamp) == STAMP_NS
    np.testing.assert_array_equal(
        filled(Float64MultiArray(), torque_outputs.multi_array(backwards)).data, command.tau[::-1]
    )
    fields = torque_outputs.multi_dof_command(backwards)
    assert fields["dof_names"] == state.name
    np.testing.assert_array_equal(fields["values"], command.tau[::-1])
    assert len(fields["values_dot"]) == 0


def test_linear_feedback_holds_the_measured_state_the_torque_and_how_it_changes(command: TorqueCommand) -> None:
    joints = ARM[::-1]
    fields = torque_outputs.linear_feedback(leaving(command, joints))
    gain, forward = fields["feedback_gain"], fields["feedforward"]
    assert [(d.label, d.size, d.stride) for d in gain.layout.dim] == [("rows", 7, 98), ("cols", 14, 14)]
    assert [(d.label, d.size, d.stride) for d in forward.layout.dim] == [("rows", 7, 7), ("cols", 1, 1)]
    assert command.law is not None
    stiffness, damping = command.law.joint_gains()
    K = np.array(gain.data).reshape(7, 14)
    np.testing.assert_array_equal(K[:, :7], stiffness[::-1, ::-1])
    np.testing.assert_array_equal(K[:, 7:], damping[::-1, ::-1])
    assert np.abs(stiffness).max() > 10.0
    np.testing.assert_array_equal(forward.data, command.tau[::-1])
    state = fields["initial_state"]["joint_state"]
    np.testing.assert_array_equal(state.position, command.q[::-1])
    np.testing.assert_array_equal(state.velocity, command.v[::-1])
    np.testing.assert_array_equal(state.effort, command.tau[::-1])
    assert fields["initial_state"]["base_pose"].orientation.w == 1.0


def test_the_safe_torque_has_no_linear_feedback() -> None:
    controller, target = controller_at_home((0.0, 0.05, 0.0))
    controller.step(PANDA.home, np.zeros(PANDA.nv), target, 0.001)
    safe = controller.rest(0.0, 0.001)
    assert safe is not None and safe.law is None
    assert not np.array(torque_outputs.linear_feedback(leaving(safe))["feedback_gain"].data).any()


def hand_under_a_push(period_ms: int, feedback: bool, cycle: float = 0.001) -> np.ndarray:
    """Path (T, 3) of a hand that is pushed, m; the controller speaks every so often, linear feedback in between.

    The robot takes a torque every `cycle` s, and keeps to the rate limit of its makers.
    """
    controller, target = controller_at_home((0.0, 0.0, 0.0), cycle, closed_elsewhere=feedback)
    simulator, data = RobotSimulator(PANDA), PANDA.create_data()
    command: TorqueCommand | None = None
    path = []
    for ms in range(1200):
        state = simulator.state
        if ms % period_ms == 0:
            last, command = command, controller.step(state.q, state.v, target, 1e-3 * period_ms)
            assert command is not None
            fields = torque_outputs.linear_feedback(leaving(command))
            forward = np.array(fields["feedforward"].data)
            K = np.array(fields["feedback_gain"].data).reshape(7, 14)
            known = fields["initial_state"]["joint_state"]
        away = np.concatenate([known.position, known.velocity]) - np.concatenate([state.q, state.v])
        pushed = {"panda_hand_tcp": [0.0, 30.0, 0.0, 0.0, 0.0, 0.0]} if 600 <= ms < 700 else {}
        sent = forward + K @ away if feedback else forward
        if feedback and ms % period_ms == 0 and last is not None:
            # what acts when new torques come is what the last ones and their gains make of the state
            assert (np.abs(sent - last.acting(state.q, state.v)) < PANDA.torque_rates * cycle).all()
        simulator.step(sent, pushed)
        data.update(simulator.state.q)
        path.append(data.pose("hand")[:3])
    return np.array(path)


@pytest.mark.parametrize("cycle", [0.001, math.inf])
def test_with_linear_feedback_a_slow_controller_acts_like_a_fast_one(cycle: float) -> None:
    fast = hand_under_a_push(1, feedback=False)
    errors = [np.abs(hand_under_a_push(20, feedback, cycle) - fast).max() for feedback in (True, False)]
    assert np.ptp(fast, axis=0).max() > 2e-3
    assert errors[0] < 5e-4
    assert errors[1] > 10.0 * errors[0]


def test_messages_within_messages_are_filled() -> None:
    message = filled(PoseStamped(), {"header": {"frame_id": "base"}, "pose": {"position": Point(x=1.0)}})
    assert (message.header.frame_id, message.pose.position.x) == ("base", 1.0)
    with pytest.raises(AttributeError):
        filled(PoseStamped(), {"colour": "red"})


def test_an_output_whose_package_is_missing_says_what_to_install(monkeypatch: pytest.MonkeyPatch) -> None:
    for module in ("control_msgs.msg", "linear_feedback_controller_msgs.msg"):
        monkeypatch.setitem(sys.modules, module, None)
    with pytest.raises(
        ValueError, match="'pid_controller' needs MultiDOFCommand of control_msgs.*apt install ros-jazzy-control-msgs"
    ):
        message_class("pid_controller")
    with pytest.raises(ValueError, match="ros-jazzy-linear-feedback-controller-msgs"):
        message_class("linear_feedback_controller")
    with pytest.raises(ValueError, match="'ros1'; expected some of joint_state, effort_controller"):
        message_class("ros1")


@pytest.mark.parametrize("name", OUTPUTS)
def test_the_real_message_takes_the_fields(name: str, command: TorqueCommand) -> None:
    try:
        kind = message_class(name)
    except ValueError as error:
        assert OUTPUTS[name].package not in ("sensor_msgs", "std_msgs")
        pytest.skip(str(error))
    message = filled(kind(), OUTPUTS[name].fields(leaving(command)))
    assert message != kind()


# -- on topics --------------------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def robot_file(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The Panda with another group: its arm, backwards."""
    content = yaml.safe_load(PANDA_FILE.read_text())
    content["joint_groups"]["backwards"] = content["joint_groups"]["arm"][::-1]
    path = tmp_path_factory.mktemp("robot") / "panda.yaml"
    path.write_text(yaml.safe_dump(content))
    return path


@pytest.mark.parametrize("gravity_compensated", [False, True])
def test_torques_leave_on_each_topic_that_was_asked_for(
    gravity_compensated: bool, robot_file: Path, ros_node: Node, start_process: StartProcess
) -> None:
    process = start_process(
        NODE,
        *ros_arguments(
            robot_file=robot_file,
            endpoint="hand",
            torque_outputs="[joint_state, effort_controller]",
            torque_joints="backwards",
            gravity_compensated=gravity_compensated,
            joint_state_timeout=5.0,
        ),
    )
    by_name = Inbox(ros_node, JointState, "joint_torques")
    by_order = Inbox(ros_node, Float64MultiArray, "effort_controller/commands", RELIABLE)
    states = ros_node.create_publisher(JointState, "joint_states", STREAM)
    assert change_state(ros_node, NODE, CONFIGURE, ACTIVATE)

    def answered() -> bool:
        stamp_ns = ros_node.get_clock().now().nanoseconds
        states.publish(
            conversions.joint_state_message(list(PANDA.joint_names), stamp_ns, PANDA.home, np.zeros(PANDA.nv))
        )
        return len(by_name.messages) > 5 and len(by_order.messages) > 5

    spin_until(ros_node, answered, message="torques", processes=(process,))
    # at rest, without reference: what carries the arm
    carried = PANDA.create_data().gravity(PANDA.home)[::-1].copy()
    assert np.abs(carried).max() > 20.0
    expected = np.zeros(PANDA.nv) if gravity_compensated else carried
    assert list(by_name.last.name) == list(PANDA.joint_names)[::-1]
    np.testing.assert_allclose(by_name.last.effort, expected, atol=1e-6)
    np.testing.assert_allclose(by_order.last.data, expected, atol=1e-6)


@pytest.mark.parametrize(
    ("parameters", "reason"),
    [
        ({"torque_outputs": "[ros1]"}, "torque_outputs names 'ros1'"),
        ({"torque_outputs": "[joint_state, joint_state]"}, "each once"),
        ({"torque_joints": "legs"}, "names no joint group of the robot file: 'legs'"),
    ],
)
def test_outputs_that_make_no_sense_are_refused(
    parameters: dict[str, str], reason: str, ros_node: Node, start_process: StartProcess
) -> None:
    process = start_process(NODE, *ros_arguments(robot_file=PANDA_FILE, endpoint="hand", **parameters))
    assert not change_state(ros_node, NODE, CONFIGURE)
    spin_until(ros_node, lambda: reason in process.output, message=reason, processes=(process,))
