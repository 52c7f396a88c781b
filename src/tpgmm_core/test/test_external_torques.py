# SPDX-License-Identifier: Apache-2.0
"""Pushes out of joint torques: found at the hand, not made up where nobody pushes, whatever moves and comes late."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest
import yaml

from robots import BAXTER, KINOVA
from tpgmm_core.common.types import Array
from tpgmm_core.observation.external_torques import LEVER, ExternalTorques, size_of
from tpgmm_core.robot.model import RobotModel
from tpgmm_core.robot.simulation import RobotSimulator

STEP, PER_BATCH = 0.004, 8
HAND = "left_gripper"


@pytest.fixture(scope="module")
def robot() -> RobotModel:
    return RobotModel.from_file(BAXTER)


@dataclass
class Arm:
    """A simulated robot that swings its left arm about where it is at home, observed in batches as a page does."""

    robot: RobotModel

    def __post_init__(self) -> None:
        self.simulator = RobotSimulator(self.robot, STEP)
        self.data = self.robot.create_data()
        self.observer = ExternalTorques(self.robot, "left")
        self.moving = self.robot.indices("left_arm")

    def command(self, swing: float) -> Array:
        """Computed torques along a sine of `swing` rad."""
        state, robot = self.simulator.state, self.robot
        rate = 2.0 * np.pi * 0.25
        shape = np.zeros(robot.nv)
        shape[self.moving] = swing
        wanted = robot.home + shape * (1.0 - np.cos(rate * state.time))
        speed = shape * rate * np.sin(rate * state.time)
        acceleration = shape * rate**2 * np.cos(rate * state.time)
        drive = acceleration + 400.0 * (wanted - state.q) + 40.0 * (speed - state.v)
        return self.data.mass_matrix(state.q) @ drive + self.data.nonlinear_effects(state.q, state.v)

    def run(self, seconds: float, wrench: Array | None = None, swing: float = 0.15, gap: int = 0) -> list[float]:
        """The force that is found after each batch, N; of `gap` batches out of one more none is seen."""
        found = []
        wrenches = {} if wrench is None else {HAND: wrench}
        for batch in range(round(seconds / STEP / PER_BATCH)):
            for _ in range(PER_BATCH):
                state = self.simulator.step(self.command(swing), wrenches)
                if batch % (gap + 1) == 0:
                    self.observer.take(round(1e9 * state.time), state.q, state.v, state.tau)
            self.observer.step()
            found.append(self.observer.hand_force())
        return found


def test_a_push_at_the_hand_of_a_moving_arm_is_found_and_none_where_nobody_pushes(robot: RobotModel) -> None:
    arm = Arm(robot)
    free = arm.run(4.0)
    assert arm.observer.is_known and max(free) < 3.0, max(free)
    for wrench in ([20.0, 0.0, 0.0], [0.0, -20.0, 0.0], [0.0, 0.0, 20.0]):
        held = arm.run(1.0, np.array([*wrench, 0.0, 0.0, 0.0]))
        assert 12.0 < held[-1] < 24.0, (wrench, held[-1])
        assert arm.run(1.0)[-1] < 3.0
    turned = arm.run(0.6, np.array([0.0, 0.0, 0.0, 0.0, 0.0, 20.0 * LEVER]), swing=0.0)
    assert 12.0 < turned[-1] < 24.0


def test_time_that_is_set_back_begins_anew(robot: RobotModel) -> None:
    arm = Arm(robot)
    take = arm.observer.take
    back = 0

    def later(stamp_ns: int, q: Array, v: Array, tau: Array) -> None:
        take(stamp_ns + 100_000_000_000 - back, q, v, tau)

    arm.observer.take = later  # type: ignore[method-assign]
    arm.run(0.5, np.array([20.0, 0.0, 0.0, 0.0, 0.0, 0.0]))
    back = 100_000_000_000
    found = arm.run(1.0)
    assert np.isfinite(found).all() and found[-1] < 3.0, found


def test_states_that_come_twice_tell_the_same(robot: RobotModel) -> None:
    arms = Arm(robot), Arm(robot)
    take = arms[1].observer.take

    def twice(stamp_ns: int, q: Array, v: Array, tau: Array) -> None:
        take(stamp_ns, q, v, tau)
        take(stamp_ns, q, v, tau)

    arms[1].observer.take = twice  # type: ignore[method-assign]
    once, again = (arm.run(1.0, np.array([20.0, 0.0, 0.0, 0.0, 0.0, 0.0])) for arm in arms)
    assert arms[1].observer.is_known and once == again


def test_a_page_that_looks_seldom_finds_the_same(robot: RobotModel) -> None:
    arm = Arm(robot)
    assert max(arm.run(4.0, gap=14)) < 3.0  # half a second between two looks, of which 32 ms are seen
    held = arm.run(1.0, np.array([0.0, 0.0, 20.0, 0.0, 0.0, 0.0]), gap=14)
    assert 12.0 < held[-1] < 24.0


def test_a_joint_that_reports_its_angle_wrapped_pushes_nobody(tmp_path: Path) -> None:
    path = tmp_path / "kinova.yaml"
    path.write_text(yaml.safe_dump(KINOVA))
    kinova = RobotModel.from_file(path)
    observer, data = ExternalTorques(kinova, "hand"), kinova.create_data()
    q, v = kinova.home.copy(), np.zeros(kinova.nv)
    v[3], begin = 0.5, 3.0  # an endless joint of the arm, through half a turn
    forces = []
    for number in range(200):
        q[3] = begin + v[3] * STEP * number
        wrapped = q.copy()
        wrapped[3] = (q[3] + np.pi) % (2.0 * np.pi) - np.pi
        observer.take(round(1e9 * (1.0 + STEP * number)), wrapped, v, data.nonlinear_effects(q, v).copy())
        if number % PER_BATCH == PER_BATCH - 1:
            observer.step()
            forces.append(observer.hand_force())
    assert q[3] > 3.3 and max(forces) < 0.5, max(forces)
    observer.forget()
    assert not observer.is_known and observer.hand_force() == 0.0


def test_one_state_alone_or_two_at_the_same_time_tell_nothing(robot: RobotModel) -> None:
    observer = ExternalTorques(robot, "left")
    for _ in range(2):
        observer.take(10, robot.home, np.zeros(robot.nv), np.zeros(robot.nv))
        observer.step()
    assert not observer.is_known


def test_a_torque_counts_as_the_force_at_its_lever() -> None:
    assert size_of(np.array([3.0, 4.0, 0.0, 0.0, 0.0, 0.1])) == 5.0
    assert size_of(np.array([3.0, 4.0, 0.0, 0.0, 0.0, -2.0 * LEVER * 5.0])) == pytest.approx(10.0)
