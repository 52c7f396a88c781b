# SPDX-License-Identifier: Apache-2.0
"""joint_motion by FollowJointTrajectory: what becomes of goals that are refused, canceled, ended or not answered."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from action_msgs.srv import CancelGoal
from rclpy.node import Node

from position_bench import ARM, NODE, UR5_FILE, Bench
from ros_graph import ACTIVATE, CONFIGURE, DEACTIVATE, change_state, result_of, ros_arguments
from ros_testing import StartProcess
from tpgmm_core.control.supervision import ControllerMode

ACTION = "joint_trajectory_controller/follow_joint_trajectory"
AGAIN = "; it starts again with the next movement: nothing is sent"


@pytest.fixture(scope="module")
def graph(module_node: Node, start_module_process: StartProcess) -> Bench:
    values = {"command_rate": 20.0, "horizon": 0.1, "reference_timeout": 0.5, "joint_state_timeout": 0.5}
    process = start_module_process(
        NODE,
        *ros_arguments(
            robot_file=UR5_FILE, endpoint="tool", outputs=f"[{Path(ACTION).name}]", hold_time=0.5, max_lag=0.3, **values
        ),
    )
    bench = Bench(module_node, (process,))
    assert change_state(module_node, NODE, CONFIGURE)
    assert change_state(module_node, NODE, ACTIVATE)
    bench.until_it_says(ControllerMode.WAITING, f"no controller offers the action {ACTION}: nothing is sent")
    assert change_state(module_node, NODE, DEACTIVATE)
    robot = start_module_process(
        sys.executable, str(Path(__file__).with_name("position_robot.py")), str(UR5_FILE), *ARM
    )
    bench.processes = (process, robot)
    return bench


@pytest.fixture
def bench(graph: Bench) -> Iterator[Bench]:
    """A robot on its way to a place."""
    graph.mode("well")
    graph.references, graph.offset = True, np.zeros(3)
    graph.forgets()
    graph.violations.clear()
    assert change_state(graph.node, NODE, ACTIVATE)
    before = graph.q.copy()
    if graph.missing < 0.2:  # otherwise back to where the flange was at home
        graph.offset = np.array([0.12, 0.3, 0.1])
    graph.until(lambda: np.abs(graph.q - before).max() > 0.1, "motion")
    yield graph
    assert change_state(graph.node, NODE, DEACTIVATE)
    assert not [message.data for message in graph.violations.messages]


def stays(bench: Bench) -> bool:
    """Whether the robot, which takes a moment to stop, rests."""
    before, begin_ns = bench.q.copy(), bench.stamp_ns
    bench.until(lambda: bench.stamp_ns - begin_ns > 300_000_000, "joint states")
    return bool(np.abs(bench.q - before).max() < 1e-6)


def test_the_flange_gets_to_a_place_and_stops_where_references_do(bench: Bench) -> None:
    bench.until(lambda: bench.missing < 0.001, "the place")
    bench.offset = np.zeros(3) if bench.offset.any() else np.array([0.12, 0.3, 0.1])
    bench.until(lambda: bench.missing < 0.25, "motion")
    bench.references = False
    bench.until_it_says(ControllerMode.WAITING, "no reference for 0.5 s: nothing is sent")
    assert stays(bench) and bench.missing > 0.01


def test_what_another_program_cancels_is_not_moved_again_until_the_next_movement(bench: Bench) -> None:
    cancel = bench.node.create_client(CancelGoal, f"{ACTION}/_action/cancel_goal")
    assert result_of(bench.node, cancel.call_async(CancelGoal.Request()), "the cancelling").goals_canceling
    bench.until_it_says(ControllerMode.WAITING, f"another program canceled the trajectory{AGAIN}")
    bench.until(lambda: stays(bench), "rest")
    far = bench.missing
    assert far > 0.01
    bench.references = False
    end_ns = bench.stamp_ns + 700_000_000
    bench.until(lambda: bench.stamp_ns > end_ns, "a pause of the references")
    bench.references = True
    bench.until(lambda: bench.missing < 0.5 * far, "another movement")


@pytest.mark.parametrize(
    ("mode", "words"),
    [
        ("refusing", "the controller refused a trajectory"),
        ("stuck", "the controller ended the trajectory: PATH_TOLERANCE_VIOLATED, "),
        ("deaf", "the controller has not answered a trajectory for 1 s"),
    ],
)
def test_a_controller_that_takes_no_goal_ends_the_movement_with_the_reason(bench: Bench, mode: str, words: str) -> None:
    bench.mode(mode)
    bench.until_it_says(ControllerMode.WAITING, words)
    assert bench.states.last.reason.endswith(AGAIN)
    bench.mode("well")
    bench.until(lambda: stays(bench), "rest")
    if mode == "stuck":  # goals that were on their way when the robot was stopped lead away from there; no more follow
        assert all(message.data.startswith("jump: ") for message in bench.violations.messages)
        bench.violations.clear()
        assert stays(bench)
