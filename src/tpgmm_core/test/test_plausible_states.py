# SPDX-License-Identifier: Apache-2.0
"""Joint states that cannot be right, where a controller follows a simulated robot, and states that are no fault."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import yaml

pytest.importorskip("pinocchio")

from robots import BAXTER, KINOVA
from test_supervised_controller import AWAY, MS, Bench
from tpgmm_core.control.supervision import ControllerMode
from tpgmm_core.observation.plausible_states import PlausibleStates
from tpgmm_core.robot.model import RobotModel

#: A state of joints as a driver tells it: positions and velocities.
type Told = tuple[np.ndarray, np.ndarray]
JOINT = "left_e0"


@pytest.fixture(scope="module")
def robot() -> RobotModel:
    return RobotModel.from_file(BAXTER)


class Driver(Bench):
    """The bench, with a driver that tells what it likes of the joints."""

    def hear(self, told: Callable[[np.ndarray, np.ndarray], Told], *, refers: bool = True) -> np.ndarray | None:
        """A state as it is told, torques (nv,) out; without an answer the robot keeps the last ones."""
        self.now_ns += MS
        if refers:
            self.refer(self.goal)
        state = self.simulator.state
        q, v = told(state.q.copy(), state.v.copy())
        answer = self.controller.take_state(q, v, self.now_ns, self.now_ns, self.now_ns)
        if answer is not None:
            self.tau = answer.command.tau
        self.simulator.step(self.tau if self.controller.decision.sends else self.idle())
        return None if answer is None else answer.command.tau

    tau: np.ndarray
    goal: np.ndarray

    @property
    def reason(self) -> str:
        return self.controller.decision.reason


@pytest.fixture
def driver(robot: RobotModel) -> Driver:
    bench = Driver(robot)
    bench.tau, bench.goal = robot.create_data().gravity(robot.home), bench.home + 2.0 * AWAY
    return bench


def rightly(q: np.ndarray, v: np.ndarray) -> Told:
    return q, v


def leapt(robot: RobotModel, way: float) -> Callable[[np.ndarray, np.ndarray], Told]:
    def told(q: np.ndarray, v: np.ndarray) -> Told:
        q[robot.joint_names.index(JOINT)] += way
        return q, v

    return told


@pytest.mark.parametrize("way", [0.2, -3.0])
def test_a_state_that_leaps_changes_no_torque_and_no_movement(driver: Driver, way: float) -> None:
    wrong = leapt(driver.robot, way)
    undisturbed = Driver(driver.robot)
    undisturbed.tau, undisturbed.goal = driver.tau, driver.goal
    for i in range(1500):
        right = undisturbed.hear(rightly)
        if i > 10 and i % 100 == 50:
            assert driver.hear(wrong) is None
            assert any(f"{JOINT} leapt by {abs(way):.2g} rad" in words for words in driver.controller.doubts)
        else:
            heard = driver.hear(rightly)
            assert heard is not None and right is not None
            # one torque was a millisecond older
            assert np.abs(heard - right).max() < 0.05 * driver.robot.effort_limits.max()
        assert driver.mode is ControllerMode.ACTIVE
    np.testing.assert_allclose(driver.simulator.state.q, undisturbed.simulator.state.q, atol=1e-3)


def test_of_two_robots_on_one_topic_the_first_is_followed_and_the_other_is_named(driver: Driver) -> None:
    other = driver.robot.home + 0.4
    for i in range(600):
        driver.hear(rightly if i % 2 == 0 else lambda q, v: (other, np.zeros_like(v)))
        assert driver.mode is ControllerMode.ACTIVE
    assert any("whether another robot publishes on this topic" in words for words in driver.controller.doubts)
    assert np.abs(driver.simulator.state.v).max() < 2.0
    driver.goal = driver.home - 2.0 * AWAY
    for _ in range(1100):
        driver.hear(rightly)
        assert driver.mode is ControllerMode.ACTIVE, "however long ago the other one was heard"
    assert not driver.controller.doubts, "told while it lasts"


def test_where_only_leaps_come_nothing_moves_until_states_have_paused(driver: Driver) -> None:
    wrong, torques = leapt(driver.robot, 0.5), []
    for _ in range(300):
        driver.hear(rightly)
    torques = [driver.hear(wrong) for _ in range(400)]
    assert driver.mode is ControllerMode.FAULT and f"{JOINT} leapt by 0.5 rad" in driver.reason
    timeouts = driver.controller.timeouts
    silent = round(1e3 * (timeouts.joint_state_timeout + timeouts.silence_after)) + 2
    assert all(tau is None for tau in torques[:19]) and all(tau is None for tau in torques[silent:])
    damped = [tau for tau in torques if tau is not None]
    assert damped and driver.shares(damped) < 0.1
    # the encoder is well again: it goes on by itself
    for _ in range(5):
        driver.hear(rightly)
    assert driver.mode is ControllerMode.ACTIVE
    for _ in range(50):
        driver.hear(wrong)
    assert driver.mode is ControllerMode.FAULT
    driver.now_ns += 100 * MS  # the driver is started again
    driver.hear(wrong)
    assert driver.mode is ControllerMode.ACTIVE


def test_activated_again_a_controller_believes_where_the_robot_is(driver: Driver) -> None:
    wrong = leapt(driver.robot, 0.5)
    for told in [rightly] * 50 + [wrong] * 50:
        driver.hear(told)
    assert driver.mode is ControllerMode.FAULT
    driver.controller.start()
    driver.hear(wrong)
    assert driver.mode is ControllerMode.ACTIVE


WRONG_VELOCITIES: dict[str, Callable[[np.ndarray, np.ndarray], Told]] = {
    "always zero": lambda q, v: (q, np.zeros_like(v)),
    "in degrees": lambda q, v: (q, np.degrees(v)),
    "of the other sign": lambda q, v: (q, -v),
    "of one joint zero": lambda q, v: (q, np.where(np.arange(len(v)) == MOVES_MOST, 0.0, v)),
}
#: Of all joints, on the way to the driver's goal.
MOVES_MOST = 3


@pytest.mark.parametrize("kind", WRONG_VELOCITIES)
def test_velocities_that_are_not_the_change_of_positions_end_the_motion_with_the_reason(
    driver: Driver, kind: str
) -> None:
    wrong = WRONG_VELOCITIES[kind]
    driver.goal = driver.home + np.array([0.0, 0.3, 0.3, 0.0, 0.0, 0.0, 0.0])
    fastest = moved = 0.0
    for _ in range(3000):
        driver.hear(wrong)
        fastest = max(fastest, float(np.abs(driver.simulator.state.v / driver.robot.velocity_limits).max()))
        if driver.mode is ControllerMode.FAULT:
            break
        moved = float(np.abs(driver.simulator.state.q - driver.robot.home).max())
    assert "velocities contradict positions" in driver.reason and "rad/s" in driver.reason
    assert moved < 0.2 and fastest < 1.2
    for _ in range(1500):  # at rest nothing shows the fault: it is remembered
        driver.hear(wrong)
        driver.simulator.step(driver.idle())
    assert driver.mode is ControllerMode.FAULT


def test_velocities_are_believed_again_when_they_fit_during_a_motion_of_that_joint(robot: RobotModel) -> None:
    states = PlausibleStates(robot)

    now_ns = 1000 * MS

    def words(joint: int, share: float) -> str:
        """After a motion of 0.32 rad at rest before and after, with this share of its velocity told."""
        nonlocal now_ns
        fault = ""
        now_ns += 1000 * MS
        for i in range(400):
            q, v = robot.home.copy(), np.zeros(robot.nv)
            q[joint] += 8e-4 * i
            v[joint] = share * 0.8
            now_ns += MS
            assert not states.leap(q, now_ns, 0.001, 0.02)
            fault = states.accept(q, now_ns, v)
        return fault

    assert robot.joint_names[2] in words(2, 0.0)
    assert words(1, 1.0), "another joint says nothing of this one"
    assert words(2, 0.3) and words(2, -1.0) and words(2, 50.0)
    assert not words(2, 1.0)


@pytest.mark.parametrize("period_ms", [1, 5, 20])
@pytest.mark.parametrize("lag_ms", [0, 30])
def test_nothing_that_a_sound_driver_does_is_a_fault(robot: RobotModel, period_ms: int, lag_ms: int) -> None:
    """At the speed limits, with noise, stamps that jitter, states that are lost, velocities that are filtered."""
    rng = np.random.default_rng(period_ms + lag_ms)
    states, limits = PlausibleStates(robot), robot.velocity_limits
    pause = max(0.02, 4e-3 * period_ms)
    omega = np.linspace(0.5, 5.0, robot.nv)
    start_ns, stamp_ns = 1000 * MS, 0
    for i in range(1, 20_000 // period_ms):
        if rng.random() < 0.05 or i % 997 < 3:
            continue
        moment = 1e-3 * period_ms * i
        q = robot.home + limits / omega * np.sin(omega * moment) + rng.normal(0.0, 1e-4, robot.nv)
        v = limits * np.cos(omega * (moment - 1e-3 * lag_ms)) + rng.normal(0.0, 0.02, robot.nv)
        jitter = rng.uniform(0.0, 0.9) * period_ms * MS
        stamp_ns = max(stamp_ns + 1, start_ns + i * period_ms * MS + round(jitter))
        assert not states.leap(q, stamp_ns, 1e-3 * period_ms, pause)
        assert not states.accept(q, stamp_ns, v), moment
    assert not states.told(stamp_ns)


def test_endless_joints_are_where_they_were_after_each_turn(tmp_path: Path) -> None:
    (tmp_path / "kinova.yaml").write_text(yaml.safe_dump(KINOVA))
    robot = RobotModel.from_file(tmp_path / "kinova.yaml")
    states, q, now_ns = PlausibleStates(robot), robot.home.copy(), 1000 * MS
    for i in range(8000):
        now_ns += MS
        q[3] = (robot.home[3] + 1e-3 * i + np.pi) % (2.0 * np.pi) - np.pi  # as many drivers wrap it
        v = np.zeros(robot.nv)
        v[3] = 1.0
        assert not states.leap(q, now_ns, 0.001, 0.02) and not states.accept(q, now_ns, v)


def test_values_that_are_not_finite_or_of_another_length_are_others_to_refuse(driver: Driver) -> None:
    for _ in range(10):
        driver.hear(rightly)
    driver.hear(lambda q, v: (q, np.full_like(v, np.nan)))
    assert driver.mode is ControllerMode.FAULT and "not finite" in driver.reason
    driver.hear(rightly)
    assert driver.mode is ControllerMode.ACTIVE
    with pytest.raises(ValueError, match="shapes"):
        driver.hear(lambda q, v: (q[:3], v[:3]))


@pytest.mark.parametrize("speed", [1e3, 1e200])
def test_a_single_absurd_velocity_is_forgotten_with_its_state(driver: Driver, speed: float) -> None:
    for i in range(300):
        driver.hear((lambda q, v: (q, v + speed)) if i % 100 == 50 else rightly)
        assert driver.mode is ControllerMode.ACTIVE or i % 100 == 50, (i, driver.reason)


@pytest.mark.parametrize("heard", [0, 1])
def test_a_message_of_somebody_else_at_the_beginning_does_not_shut_the_robot_out(driver: Driver, heard: int) -> None:
    garbage = driver.robot.home + 1e9
    for _ in range(heard):
        driver.hear(rightly)
    driver.now_ns += 1000 * MS  # nothing for a while
    driver.hear(lambda q, v: (garbage, np.zeros_like(v)))
    answers = [driver.hear(rightly) for _ in range(20)]
    assert all(tau is not None for tau in answers[1:]) and driver.mode is ControllerMode.ACTIVE
