# SPDX-License-Identifier: Apache-2.0
"""A person's hand that leads a robot's: it gets there, softly, and never swings."""

from __future__ import annotations

import numpy as np
import pytest

from robots import BAXTER
from tpgmm_core.geometry.manifold import POSE
from tpgmm_core.robot.led_hand import LeadingConfig, LedHand
from tpgmm_core.robot.model import RobotModel
from tpgmm_core.robot.simulation import RobotSimulator


@pytest.mark.parametrize("step", [0.001, 0.004])
def test_a_simulated_baxter_is_led_to_a_pose_and_rests_there(step: float) -> None:
    robot = RobotModel.from_file(BAXTER)
    simulator, data = RobotSimulator(robot, time_step=0.001), robot.create_data()
    data.update(simulator.state.q)
    begin = data.pose("left").copy()
    aim = POSE.exp(begin, np.array([0.05, 0.15, -0.08, 0.0, 0.0, 0.4]))
    person, config, fastest = LedHand(begin), LeadingConfig(), 0.0
    for _ in range(round(5.0 / step)):
        state = simulator.state
        data.update(state.q, state.v)
        wrench = person.wrench(step, aim, data.pose("left"), data.twist("left"))
        assert np.abs(wrench[:3]).max() <= config.max_force and np.abs(wrench[3:]).max() <= config.max_torque
        fastest = max(fastest, float(np.linalg.norm(data.twist("left")[:3])))
        # gravity compensation with a little damping, as without a reference
        torque = data.nonlinear_effects(state.q, state.v) - 1.0 * state.v
        for _ in range(round(step / 0.001)):
            simulator.step(torque, {robot.endpoints["left"].frame: wrench})
    error = POSE.log(data.pose("left"), aim)
    assert np.linalg.norm(error[:3]) < 0.01 and np.linalg.norm(error[3:]) < 0.09
    assert np.abs(simulator.state.v).max() < 0.05
    assert fastest < 1.5 * config.max_speed


def test_a_place_that_leaps_gives_no_blow() -> None:
    begin = np.array([0.6, 0.2, 0.1, 0.0, 1.0, 0.0, 0.0])
    person = LedHand(begin)
    aim = POSE.exp(begin, np.array([3.0, 0.0, 0.0, 0.0, 0.0, 3.0]))
    forces = [person.wrench(0.004, aim, begin, np.zeros(6)) for _ in range(500)]
    steps = np.abs(np.diff(forces, axis=0))
    assert np.abs(forces[0]).max() < 10.0 and steps[:, :3].max() < 8.0


def test_a_setting_out_of_its_range_is_refused() -> None:
    with pytest.raises(ValueError, match="max_force"):
        LeadingConfig(max_force=-1.0)
