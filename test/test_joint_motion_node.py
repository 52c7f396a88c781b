# SPDX-License-Identifier: Apache-2.0
"""joint_motion on topics: a UR5 that takes trajectories gets to a place, and every fault leads to a hold."""

from __future__ import annotations

import sys
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from geometry_msgs.msg import PoseStamped, TwistStamped
from rclpy.action import ActionClient
from rclpy.node import Node
from std_msgs.msg import Float64MultiArray, String

from position_bench import ARM, COVARIANCE, NODE, RELIABLE, UR5, UR5_FILE, Bench, hand
from ros_graph import (
    ACTIVATE,
    ALL_LATCHED,
    CONFIGURE,
    DEACTIVATE,
    Inbox,
    change_state,
    result_of,
    ros_arguments,
)
from ros_testing import StartProcess, spin_until
from tpgmm_core import Demonstration, Frame
from tpgmm_core.control.supervision import ControllerMode
from tpgmm_core.retrieval.recipe import Recipe
from tpgmm_msgs.action import Reproduce
from tpgmm_ros.messages import conversions
from tpgmm_ros.messages.motion_outputs import check_outputs
from tpgmm_ros.messages.qos import STREAM

RATE = 50.0
RATE = 50.0
OUTPUTS = "[joint_trajectory, positions, target_pose, target_stiffness, servo_twist]"


@pytest.fixture(scope="module")
def graph(module_node: Node, start_module_process: StartProcess) -> Bench:
    robot = start_module_process(
        sys.executable, str(Path(__file__).with_name("position_robot.py")), str(UR5_FILE), *ARM
    )
    process = start_module_process(
        NODE,
        *ros_arguments(
            robot_file=UR5_FILE,
            endpoint="tool",
            outputs=OUTPUTS,
            command_rate=RATE,
            horizon=0.06,
            reference_timeout=0.5,
            joint_state_timeout=0.5,
            hold_time=0.5,
            max_lag=0.15,
        ),
    )
    bench = Bench(module_node, (robot, process))
    assert change_state(module_node, NODE, CONFIGURE)
    return bench


@pytest.fixture
def bench(graph: Bench) -> Iterator[Bench]:
    """An active node, a robot that is well, and references to where the flange was at home."""
    graph.offset, graph.covariance, graph.references = np.zeros(3), COVARIANCE, True
    graph.mode("well")
    graph.forgets()
    graph.violations.clear()
    assert change_state(graph.node, NODE, ACTIVATE)
    yield graph
    graph.mode("well")
    assert change_state(graph.node, NODE, DEACTIVATE)
    assert not [message.data for message in graph.violations.messages]


def test_the_flange_gets_to_a_place_by_trajectories_that_keep_the_contract(bench: Bench) -> None:
    bench.until_it_says(ControllerMode.ACTIVE, "following the reference")
    bench.forgets()
    bench.offset = np.array([0.12, 0.15, 0.10])
    begin = time.monotonic()
    bench.until(lambda: bench.missing < 0.001, "the place")
    seconds = time.monotonic() - begin
    print(f"{1e3 * bench.missing:.2f} mm after {seconds:.1f} s, {len(bench.sent.messages) / seconds:.0f} Hz")
    assert bench.missing < 0.01
    assert 0.5 * RATE < len(bench.sent.messages) / seconds < 1.2 * RATE  # a busy machine loses some
    # along the way: speeds and accelerations of one point after the other
    v = np.array([message.points[0].velocities for message in bench.sent.messages])
    assert (np.abs(v) <= 0.4 * UR5.velocity_limits + 1e-9).all() and np.abs(v).max() > 0.1
    assert (np.abs(np.diff(v, axis=0)) <= 5.0 * 0.1 + 1e-9).all()


def test_every_output_says_the_same_motion(bench: Bench) -> None:
    positions = Inbox(bench.node, Float64MultiArray, "forward_position_controller/commands", RELIABLE)
    poses = Inbox(bench.node, PoseStamped, "target_pose", RELIABLE)
    stiffness = Inbox(bench.node, Float64MultiArray, "target_stiffness", RELIABLE)
    twists = Inbox(bench.node, TwistStamped, "servo_node/delta_twist_cmds", RELIABLE)
    boxes = (positions, poses, stiffness, twists)
    bench.offset = np.array([0.0, 0.1, 0.0])
    bench.until(lambda: all(len(box.messages) > 50 for box in boxes), "all outputs")
    there = [hand(np.array(message.data)) for message in positions.messages]
    pose = conversions.pose_to_array(poses.last.pose)
    assert min(np.abs(pose - other).max() for other in there) < 1e-9
    assert poses.last.header.frame_id == twists.last.header.frame_id == "base_link"
    assert max(np.hypot(message.twist.linear.x, message.twist.linear.y) for message in twists.messages) > 0.02
    # softer where the reference is less sure
    (x, y, z, *turns) = stiffness.last.data
    assert x == pytest.approx(2500.0) and min(turns) == pytest.approx(max(turns)) and 0.0 < turns[0] < x
    bench.covariance = np.diag([1e-2, 1e-6, 1e-6, 1e-4, 1e-4, 1e-4])
    bench.until(lambda: stiffness.last.data[0] < 0.1 * stiffness.last.data[1], "a soft direction")


def test_without_a_reference_nothing_is_sent_and_at_its_end_the_robot_stays(bench: Bench) -> None:
    bench.until_it_says(ControllerMode.ACTIVE, "following the reference")
    bench.offset = np.array([0.1, -0.2, 0.1])
    bench.until(lambda: any(np.abs(m.points[0].velocities).max() > 0.05 for m in bench.sent.messages), "motion")
    bench.references = False
    bench.until_it_says(ControllerMode.HOLD, "no reference for 0.5 s")
    bench.until_it_says(ControllerMode.WAITING, "no reference for 0.5 s: nothing is sent")
    bench.forgets()
    before = bench.q.copy()
    bench.until(lambda: "nothing is sent" in bench.diagnostics.messages.get(NODE, ""), "diagnostics")
    assert not bench.sent.messages and np.abs(bench.q - before).max() < 1e-6
    bench.references = True
    bench.until(lambda: bench.missing < 0.01, "the place, in another movement")


def test_joint_states_that_are_lost_and_come_again(bench: Bench) -> None:
    bench.offset = np.array([-0.1, 0.1, 0.15])
    bench.until(lambda: any(np.abs(m.points[0].velocities).max() > 0.05 for m in bench.sent.messages), "motion")
    bench.mode("silent")
    bench.until_it_says(ControllerMode.HOLD, "no new joint state for 0.5 s")
    bench.until_it_says(ControllerMode.WAITING, "no new joint state for 0.5 s: nothing is sent")
    bench.mode("well")
    bench.until(lambda: bench.missing < 0.01, "the place")


def test_a_robot_that_does_not_follow_stays_when_it_is_let_go(bench: Bench) -> None:
    bench.until_it_says(ControllerMode.ACTIVE, "following the reference")
    bench.offset = np.array([0.1, 0.35, 0.1])
    bench.mode("stuck")
    bench.until_it_says(ControllerMode.HOLD, "the robot does not follow")
    stuck = bench.q.copy()

    def told_to_stay() -> bool:
        return bool(bench.sent.messages) and np.abs(np.array(bench.sent.last.points[-1].positions) - stuck).max() < 1e-3

    bench.until(told_to_stay, "positions where it is")
    bench.until_it_says(ControllerMode.WAITING, "it starts again with the next movement: nothing is sent")
    bench.mode("well")
    until = time.monotonic() + 1.0
    bench.until(lambda: time.monotonic() > until, "time to pass")
    assert np.abs(bench.q - stuck).max() < 0.01
    # the jump back, to where it is, is the only one that the robot may see: until it is over, in some messages
    assert any(bench.is_jump_to(message, stuck) for message in bench.violations.messages)
    bench.violations.messages = [m for m in bench.violations.messages if not bench.is_jump_to(m, stuck)]


def test_references_that_cannot_be_used_are_named(bench: Bench) -> None:
    bench.until_it_says(ControllerMode.ACTIVE, "following the reference")
    bench.covariance = np.zeros((6, 6))
    bench.until_it_says(ControllerMode.HOLD, "the newest was refused: the reference's covariance")


def reach(folder: Path) -> tuple[Path, Path]:
    """A task and a model: the flange goes from home to an object, which was in another place each time."""
    task = folder / "reach.yaml"
    task.write_text(
        "name: reach\nbase_frame: base_link\nmovement: endpoint/tool/pose\nendpoint: tool\n"
        "frames: {robot: {pose: [0, 0, 0, 0, 0, 0, 1]}, object: {topic: object/pose}}\n"
    )
    rng, times, begin = np.random.default_rng(0), np.linspace(0.0, 2.0, 50), hand(UR5.home)
    share = (times / 2.0) ** 3 * (10.0 - 15.0 * times / 2.0 + 6.0 * (times / 2.0) ** 2)
    demonstrations = []
    for _ in range(8):
        goal = begin + [*(np.array([0.05, 0.15, 0.1]) + rng.uniform(-0.05, 0.05, 3)), 0, 0, 0, 0]
        places = begin + share[:, None] * (goal - begin)
        places[:, :3] += 0.002 * rng.normal(size=(len(times), 3))
        frames = {"robot": Frame.from_pose(np.zeros(3), [0, 0, 0, 1]), "object": Frame.from_pose(goal[:3], goal[3:])}
        timed = {name: frame.with_time() for name, frame in frames.items()}
        demonstrations.append(Demonstration(times, np.column_stack([times, places]), timed))
    recipe = Recipe.of({"n_components": 4, "reg_covar": 1e-5})
    model = recipe.learn(demonstrations, "R1 x R3 x S3", ("time", "x", "y", "z", "qx", "qy", "qz", "qw"))
    model.save(folder / "reach.tpgmm")
    return task, folder / "reach.tpgmm"


def test_a_learned_movement_gets_a_robot_without_torques_to_an_object(
    tmp_path: Path, ros_node: Node, start_process: StartProcess
) -> None:
    """All nodes of the launch file, with a robot that publishes joint states alone."""
    task, model = reach(tmp_path)
    there = hand(UR5.home) + np.array([0.08, 0.12, 0.13, 0, 0, 0, 0])
    program = Path(__file__).with_name("position_robot.py")
    robot = start_process(sys.executable, str(program), str(UR5_FILE), *ARM)
    poses = start_process("endpoint_poses", *ros_arguments(robot_file=UR5_FILE))
    values = {"robot_file": UR5_FILE, "task_file": task, "model_file": model, "endpoint": "tool", "autostart": True}
    nodes = ["frame_tracker", "reproduction", "joint_motion"]
    loop = start_process("compose", *nodes, *ros_arguments(**values, start_timeout=30.0))
    processes = (robot, poses, loop)
    seen = ros_node.create_publisher(PoseStamped, "object/pose", STREAM)
    hands = Inbox(ros_node, PoseStamped, "endpoint/tool/pose")
    violations = Inbox(ros_node, String, "violations", ALL_LATCHED)
    ros_node.create_timer(
        0.03,
        lambda: seen.publish(conversions.pose_stamped(there, ros_node.get_clock().now().nanoseconds, UR5.base_frame)),
    )
    client = ActionClient(ros_node, Reproduce, "reproduce")
    spin_until(ros_node, client.server_is_ready, 60.0, "the action", processes)
    goal = result_of(ros_node, client.send_goal_async(Reproduce.Goal()), "the goal to be accepted")
    asked = goal.get_result_async()
    spin_until(ros_node, asked.done, 60.0, "the end of the movement", processes)
    answer = asked.result().result
    print(answer.reason)
    assert answer.success, answer.reason
    error = np.linalg.norm(conversions.pose_to_array(hands.last.pose)[:3] - there[:3])
    print(f"{1e3 * error:.1f} mm from the object")
    assert error < 0.01
    assert not [message.data for message in violations.messages]


def test_outputs_that_make_no_sense_are_refused() -> None:
    for outputs, reason in (
        (["ros1"], "outputs names 'ros1'; expected some of joint_trajectory, positions"),
        (["positions", "positions"], "each once"),
        ([], "each once"),
    ):
        with pytest.raises(ValueError, match=reason):
            check_outputs(outputs)


def test_joints_that_make_no_sense_are_refused(ros_domain: int, start_process: StartProcess) -> None:
    process = start_process(NODE, *ros_arguments(robot_file=UR5_FILE, endpoint="tool", joints="legs", autostart=True))
    assert process.wait(30.0) == 1
    assert "joints names no joint group of the robot file: 'legs'; it has arm" in process.output
