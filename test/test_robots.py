# SPDX-License-Identifier: Apache-2.0
"""Robots by their own interfaces: what their stand-ins call broken, one of them in the task; `make robots` runs all."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from geometry_msgs.msg import PoseStamped
from std_msgs.msg import Float64MultiArray

from interfaces.cases import CASES, Case
from interfaces.contract import broken_by_stiffness, broken_by_target, broken_by_torques, broken_by_trajectory
from interfaces.run import Conditions, run
from position_bench import ARM, UR5
from tpgmm_core.robot.model import RobotModel
from tpgmm_ros.messages import conversions
from tpgmm_ros.messages.motion_outputs import Motion, joint_trajectory
from tpgmm_ros.runtime.resources import config_file

HOME = UR5.home[UR5.indices(ARM)]
NONE = np.zeros(6)
PANDA = RobotModel.from_file(config_file("panda.yaml"))


def motion(q: np.ndarray = HOME, v: np.ndarray = NONE, horizon: float = 0.1) -> Motion:
    return Motion(ARM, q, v, horizon, q, 0.1, np.zeros(7), NONE, None, 0, "base_link")


def kinds(broken: list[str]) -> set[str]:
    return {text.partition(":")[0] for text in broken}


def test_a_trajectory_as_the_node_makes_it_keeps_the_contract_and_each_change_of_it_is_named() -> None:
    assert not broken_by_trajectory(UR5, ARM, joint_trajectory(motion(v=NONE + 0.1)), HOME)
    assert kinds(broken_by_trajectory(UR5, ARM[::-1], joint_trajectory(motion()), HOME)) == {"joints"}
    for broken, kind in (
        (motion(HOME + 0.2), "jump"),
        (motion(v=NONE + 4.0), "velocities"),
        (motion(horizon=0.0), "times"),
        (motion(HOME + 7.0), "positions"),
    ):
        assert kind in kinds(broken_by_trajectory(UR5, ARM, joint_trajectory(broken), HOME))
    message = joint_trajectory(motion())
    message.points[-1].velocities[0] = 0.1
    message.header.stamp.sec = 1
    assert kinds(broken_by_trajectory(UR5, ARM, message, HOME)) == {"end", "stamp"}
    message.points = []
    assert "points" in kinds(broken_by_trajectory(UR5, ARM, message, HOME))


def test_a_target_that_goes_on_keeps_the_contract_and_each_change_of_it_is_named() -> None:
    last, now = np.array([0.4, 0.0, 0.3, 1.0, 0.0, 0.0, 0.0]), 5_000_000_000

    def target(pose: np.ndarray = last, stamp: int = now, frame: str = "base") -> PoseStamped:
        return conversions.pose_stamped(pose, stamp, frame)

    def broken(message: PoseStamped, since: float = 0.01) -> set[str]:
        return kinds(broken_by_target(message, "base", last, now, since))

    ahead = last + np.array([0.009, 0, 0, 0, 0, 0, 0])
    assert not broken(target(ahead))
    assert broken(target(last + np.array([0.02, 0, 0, 0, 0, 0, 0]))) == {"jump"}
    assert not broken(target(last + np.array([0.02, 0, 0, 0, 0, 0, 0])), 0.05)
    assert broken(target(frame="world", stamp=now - 10**9)) == {"frame", "stamp"}
    assert broken(target(2.0 * last)) == {"pose"}
    assert not broken_by_stiffness(Float64MultiArray(data=[500.0] * 3 + [30.0] * 3))
    for values in ([500.0] * 3, [500.0] * 5 + [-1.0], [6000.0] * 6, [float("nan")] * 6):
        assert kinds(broken_by_stiffness(Float64MultiArray(data=values))) == {"stiffness"}


def test_torques_within_the_limits_keep_the_contract_and_each_change_of_them_is_named() -> None:
    stamps = np.arange(5, dtype=np.int64) * 1_000_000
    tau = np.outer(np.arange(5), np.full(PANDA.nv, 0.9))
    assert not broken_by_torques(PANDA, stamps, tau, 0.02, 0.001)
    assert kinds(broken_by_torques(PANDA, stamps, 2.0 * tau, 0.02, 0.001)) == {"rate"}
    twice = stamps - np.array([0, 0, 0, 1, 1], np.int64) * 1_000_000  # the fourth answers the third state again
    assert kinds(broken_by_torques(PANDA, twice, tau, 0.02, 0.001)) == {"rate"}
    assert kinds(broken_by_torques(PANDA, stamps, tau + 100.0, 0.02, 0.001)) == {"effort"}
    assert kinds(broken_by_torques(PANDA, stamps * 30, tau, 0.02, 0.001)) == {"silence"}
    assert "torques" in kinds(broken_by_torques(PANDA, stamps, np.full_like(tau, np.nan), 0.02, 0.001))


@pytest.mark.parametrize("case", CASES, ids=lambda case: case.name)
def test_each_robot_is_started_by_files_of_config_and_arguments_of_the_launch_file(case: Case, tmp_path: Path) -> None:
    for path in (config_file(case.robot), config_file(case.task)):
        assert path.is_file()
    executables = [process.executable for process in case.processes(tmp_path / "a.tpgmm")]
    assert executables == (["compose", "endpoint_poses"] if case.stand_in else ["compose"])


def test_a_panda_gets_to_the_end_of_the_task_by_torques_that_keep_its_contract(
    model_file: Path, tmp_path: Path
) -> None:
    """In lockstep, so that a busy machine gives the same; the model is one that is learned in a moment."""
    found = run(CASES[0], model_file, tmp_path, Conditions(rate=200.0, slower=1.0))
    print(found)
    assert found["checks"]["the movement ended well"] and found["checks"]["the contract was kept"], found
    assert found["commands"] > 1000
