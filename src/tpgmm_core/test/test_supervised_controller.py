# SPDX-License-Identifier: Apache-2.0
"""The controller under supervision, on a simulated robot and a clock that the tests move."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

pytest.importorskip("pinocchio")

from robots import BAXTER
from tpgmm_core import Gaussian
from tpgmm_core.control.controller import REST_TIME
from tpgmm_core.control.impedance import ImpedanceLaw
from tpgmm_core.control.pose_target import PoseTarget
from tpgmm_core.control.supervised_controller import SupervisedController
from tpgmm_core.control.supervision import ControllerMode, Timeouts
from tpgmm_core.control.torque_pipeline import TorqueLimits
from tpgmm_core.geometry.manifold import POSE
from tpgmm_core.model.reference import Reference
from tpgmm_core.robot.model import RobotModel
from tpgmm_core.robot.simulation import RobotSimulator

MS = 1_000_000
AWAY = np.array([0.0, 0.05, 0.05, 0.0, 0.0, 0.0, 0.0])
TIMEOUTS = Timeouts()


class Bench:
    """Robot, controller and clock; a tick is a millisecond."""

    def __init__(self, robot: RobotModel, limits: TorqueLimits | None = None) -> None:
        self.robot, self.simulator = robot, RobotSimulator(robot)
        self.controller: SupervisedController[PoseTarget] = SupervisedController(robot, ImpedanceLaw(robot), limits)
        self.now_ns = 1000 * MS
        data = robot.create_data()
        data.update(robot.home)
        self.home = data.pose("left")

    def refer(self, pose: np.ndarray, stamp_ns: int | None = None) -> None:
        gaussian = Gaussian(pose, np.diag([0.01**2] * 3 + [0.1**2] * 3), POSE)
        stamp_ns = self.now_ns if stamp_ns is None else stamp_ns
        reference = Reference(0.5, gaussian, 0.0, (), np.ones(1), ("object",))
        self.controller.take_reference(reference, stamp_ns, self.now_ns, self.now_ns)

    def tick(self, pose: np.ndarray | None = None) -> np.ndarray:
        """A state and perhaps a reference in, torques (nv,) out, which move the robot."""
        self.now_ns += MS
        if pose is not None:
            self.refer(pose)
        state = self.simulator.state
        answer = self.controller.take_state(state.q, state.v, self.now_ns, self.now_ns, self.now_ns)
        assert answer is not None and answer.stamp_ns == self.now_ns
        self.simulator.step(answer.command.tau)
        return answer.command.tau

    def idle(self) -> np.ndarray:
        """What the robot does by itself when nobody commands it: carry its weight, damp its motion."""
        state = self.simulator.state
        return self.robot.create_data().nonlinear_effects(state.q, state.v) - 2.0 * state.v

    @property
    def mode(self) -> ControllerMode:
        return self.controller.decision.mode

    def shares(self, torques: list[np.ndarray]) -> float:
        """Largest change from one torque to the next, in effort limits."""
        return float((np.abs(np.diff(torques, axis=0)) / self.robot.effort_limits).max())


@pytest.fixture(scope="module")
def robot() -> RobotModel:
    return RobotModel.from_file(BAXTER)


@pytest.fixture
def bench(robot: RobotModel) -> Bench:
    return Bench(robot)


def test_silence_is_answered_by_damping_for_its_time_and_then_by_silence(bench: Bench) -> None:
    for _ in range(200):
        last = bench.tick(bench.home + AWAY)
    stamp_ns, torques = bench.now_ns, [last]
    modes = []
    for _ in range(60):
        bench.now_ns += 5 * MS
        answer = bench.controller.watch(bench.now_ns)
        modes.append(bench.mode)
        if answer is not None:
            assert answer.stamp_ns == stamp_ns
            torques.append(answer.command.tau)
    assert modes[:4] == [ControllerMode.ACTIVE] * 4
    assert modes[4] is ControllerMode.DAMPING and modes[-1] is ControllerMode.WAITING
    assert len(torques) - 1 == 40  # every 5 ms for 0.2 s
    gravity = bench.robot.create_data().gravity(bench.simulator.state.q)
    np.testing.assert_allclose(torques[-1], gravity, atol=0.05)


def test_an_arm_that_moves_is_braked_where_nothing_is_asked_for_and_when_its_states_stop(bench: Bench) -> None:
    home, v, data = bench.robot.home, np.zeros(bench.robot.nv), bench.robot.create_data()
    arm = bench.robot.indices("left_arm")
    v[arm] = 0.05 * bench.robot.velocity_limits[arm]
    felt = 1.0 / np.diagonal(np.linalg.inv(data.mass_matrix(home)))

    def safe(speed: np.ndarray) -> np.ndarray:
        """2 N m s/rad, or as much as takes half of a light joint's speed in 14 ms (`limit_bandwidth`)."""
        data.update(home, speed)
        return np.asarray(data.nonlinear_effects(home, speed) - np.minimum(2.0, 50.0 * felt) * speed)

    for _ in range(2):
        bench.now_ns += MS
        answer = bench.controller.take_state(home, v, bench.now_ns, bench.now_ns, bench.now_ns)
    assert bench.mode is ControllerMode.DAMPING and answer is not None
    np.testing.assert_allclose(answer.command.tau, safe(v), atol=1e-4)  # the arm moves on for a tick
    seen_ns = bench.now_ns
    for _ in range(6):
        bench.now_ns += 5 * MS
        answer = bench.controller.watch(bench.now_ns) or answer
    faded = v * np.exp(-1e-9 * (bench.now_ns - seen_ns) / REST_TIME)
    np.testing.assert_allclose(answer.command.tau, safe(faded), atol=1e-4)


def test_after_a_pause_of_its_own_it_reads_what_came_before_it_calls_the_others_silent(bench: Bench) -> None:
    for _ in range(2):
        bench.tick(bench.home)
        bench.controller.watch(bench.now_ns)
    bench.now_ns += 500 * MS
    assert bench.controller.watch(bench.now_ns) is None
    assert bench.mode is ControllerMode.ACTIVE
    bench.now_ns += 5 * MS
    assert bench.controller.watch(bench.now_ns) is None
    assert bench.mode is ControllerMode.WAITING


@pytest.mark.parametrize("gap_ms", [30, 150, 1000])
def test_after_a_silence_the_law_takes_over_from_the_measured_state(bench: Bench, gap_ms: int) -> None:
    for _ in range(600):
        bench.tick(bench.home + AWAY)
    torques = [bench.tick(bench.home + AWAY)]
    for _ in range(gap_ms // 5):
        bench.now_ns += 5 * MS
        answer = bench.controller.watch(bench.now_ns)
        torques += [answer.command.tau] if answer is not None else []
        for _ in range(5):
            bench.simulator.step(torques[-1] if answer is not None else bench.idle())
    torques += [bench.tick(bench.home + AWAY) for _ in range(900)]
    assert bench.mode is ControllerMode.ACTIVE
    assert bench.shares(torques) < 0.16  # 5 ms at 30 effort limits per second, where the safe torque takes over
    assert bench.shares(torques[-899:]) < 0.02


def test_a_repeated_state_is_answered_as_before_and_an_overtaken_one_not_at_all(bench: Bench) -> None:
    tau = bench.tick()
    state = bench.simulator.state
    again = bench.controller.take_state(state.q, state.v, bench.now_ns, bench.now_ns + MS, bench.now_ns)
    assert again is not None
    np.testing.assert_array_equal(again.command.tau, tau)
    assert bench.controller.take_state(state.q, state.v, bench.now_ns - MS, bench.now_ns + MS, bench.now_ns) is None


def test_a_reference_made_between_two_states_is_answered_once_within_the_rate_and_only_where_it_is_followed(
    bench: Bench,
) -> None:
    controller = bench.controller

    def between(share: float) -> np.ndarray | None:
        """A reference for this share of a tick after the last state, and what answers it."""
        bench.now_ns += round(share * MS)
        bench.refer(bench.home - AWAY)
        answer = controller.answer_again(bench.now_ns)
        return None if answer is None else answer.command.tau

    bench.tick()
    assert between(0.3) is None  # no reference was followed before, and how often states come is not known
    bench.now_ns += round(0.7 * MS)
    for _ in range(400):
        last = bench.tick(bench.home + AWAY)
    state_ns = bench.now_ns
    assert controller.answer_again(bench.now_ns) is None  # it belongs to the state that was answered
    tau = between(0.25)
    assert tau is not None and controller.decision.mode is ControllerMode.ACTIVE
    change = np.abs(tau - last)
    assert 0.0 < change.max() and (change <= 30.0 * 0.00025 * bench.robot.effort_limits + 1e-9).all()
    assert between(0.25) is None  # once
    bench.now_ns = state_ns
    following = bench.tick()
    assert (np.abs(following - tau) <= 30.0 * 0.00075 * bench.robot.effort_limits + 1e-9).all()
    assert between(0.95) is None  # the next state is near
    bench.now_ns = state_ns + 100 * MS
    bench.controller.watch(bench.now_ns)
    bench.controller.watch(bench.now_ns + 5 * MS)
    assert between(0.0) is None  # joint states have stopped


def test_between_the_stamps_of_two_states_torques_keep_their_rate_also_where_the_second_comes_late_after_two_answers(
    bench: Bench,
) -> None:
    """A robot with cycles of its own compares with the torque of its last cycle, whenever messages came."""
    controller, asked = bench.controller, [bench.home + AWAY, bench.home - AWAY]
    for _ in range(400):
        last = bench.tick(asked[0])
    answered = 0
    for tick in range(100):
        stamp_ns = bench.now_ns  # of the last state
        bench.now_ns += MS // 4
        bench.refer(asked[tick % 2])
        again = controller.answer_again(bench.now_ns)
        answered += again is not None
        bench.now_ns = stamp_ns + MS + (2 * MS if tick % 3 == 0 else 0)  # on its way for two ticks
        state = bench.simulator.state
        answer = controller.take_state(state.q, state.v, stamp_ns + MS, bench.now_ns, bench.now_ns)
        assert answer is not None
        bench.simulator.step(answer.command.tau)
        assert (np.abs(answer.command.tau - last) <= 30.0 * 0.001 * bench.robot.effort_limits + 1e-9).all()
        last, bench.now_ns = answer.command.tau, stamp_ns + MS
    assert answered > 50


def test_a_clock_that_jumps_backwards_is_a_new_start_without_the_old_reference(bench: Bench) -> None:
    for _ in range(300):
        before = bench.tick(bench.home + AWAY)
    bench.now_ns -= 200 * MS
    tau = bench.tick()
    assert bench.mode is ControllerMode.DAMPING and "no reference yet" in bench.controller.decision.reason
    assert (np.abs(tau - before) <= 30.0 * 0.005 * bench.robot.effort_limits).all()
    bench.tick(bench.home)
    assert bench.mode is ControllerMode.ACTIVE


def test_a_reference_counts_by_its_stamp_where_that_is_older_than_its_arrival(bench: Bench) -> None:
    bench.tick()
    bench.refer(bench.home, stamp_ns=bench.now_ns - 90 * MS)
    bench.tick()
    assert bench.mode is ControllerMode.ACTIVE
    for _ in range(10):
        bench.tick()
    assert bench.mode is ControllerMode.HOLD


def test_a_state_or_a_reference_from_the_future_is_refused(bench: Bench) -> None:
    bench.tick(bench.home)
    bench.refer(bench.home, stamp_ns=bench.now_ns + 49 * MS)  # within max_future
    with pytest.raises(ValueError, match="ahead of this machine's clock"):
        bench.refer(bench.home, stamp_ns=bench.now_ns + 51 * MS)
    state = bench.simulator.state
    answer = bench.controller.take_state(state.q, state.v, bench.now_ns + 49 * MS, bench.now_ns, bench.now_ns)
    assert bench.mode is ControllerMode.ACTIVE
    assert answer is not None and answer.command.law is not None
    answer = bench.controller.take_state(state.q, state.v, bench.now_ns + 51 * MS, bench.now_ns, bench.now_ns)
    assert bench.mode is ControllerMode.FAULT
    assert answer is not None and answer.command.law is None


@pytest.mark.parametrize("rate", [30.0, 2.0])
def test_the_last_torques_lead_to_the_safe_one_as_fast_as_the_rate_permits(robot: RobotModel, rate: float) -> None:
    bench = Bench(robot, TorqueLimits(torque_rate=rate))
    stuck = bench.simulator.state.q
    for tick in range(500):
        last = bench.tick(bench.home + min(1.0, tick / 300) * AWAY)
        bench.simulator.reset(stuck)
    torques, done = [last], False
    while not done:
        command, done = bench.controller.release(0.001)
        assert command is not None and len(torques) < 1000
        torques.append(command.tau)
    gravity = bench.robot.create_data().gravity(stuck)
    assert np.abs(last - gravity).max() > 1.0
    np.testing.assert_allclose(torques[-1], gravity, atol=0.01)
    assert bench.shares(torques) <= 0.001 * rate + 1e-12
    assert len(torques) > 2


def test_before_the_first_state_nothing_is_sent_whatever_comes(bench: Bench) -> None:
    bench.refer(bench.home)
    assert bench.controller.watch(bench.now_ns + 500 * MS) is None
    assert bench.controller.refuse_state("it lacks joints", bench.now_ns, bench.now_ns) is None
    assert bench.mode is ControllerMode.FAULT
    assert bench.controller.release(0.001) == (None, True)
    bench.tick()
    assert bench.mode in (ControllerMode.ACTIVE, ControllerMode.DAMPING)


def test_changed_parameters_change_the_gains_of_the_reference_that_is_followed(bench: Bench) -> None:
    for _ in range(800):
        bench.tick(bench.home)
    law = bench.controller.law
    assert isinstance(law, ImpedanceLaw)
    law.configure(replace(law.config, max_stiffness=20.0))
    bench.controller.configure(TorqueLimits(), TIMEOUTS)
    state = bench.simulator.state
    answer = None
    for _ in range(400):
        bench.now_ns += MS
        bench.refer(bench.home)
        answer = bench.controller.take_state(state.q, state.v, bench.now_ns, bench.now_ns, bench.now_ns)
    assert answer is not None and answer.command.law is not None
    eigenvalues = np.linalg.eigvals(answer.command.law.stiffness @ np.linalg.inv(answer.command.law.damping))
    assert eigenvalues.real.max() < 1.01 * np.sqrt(20.0 / 2.0)  # K_P K_V^-1 = K_V / 2


def test_changed_parameters_change_the_gains_of_the_pose_that_is_held(bench: Bench) -> None:
    for _ in range(800):
        bench.tick(bench.home)
    law = bench.controller.law
    assert isinstance(law, ImpedanceLaw)

    def stiffest() -> float:
        """Largest eigenvalue of K_P K_V^-1 = K_V / 2, half a second later."""
        for _ in range(500):
            bench.now_ns += MS
            state = bench.simulator.state
            answer = bench.controller.take_state(state.q, state.v, bench.now_ns, bench.now_ns, bench.now_ns)
        assert bench.mode is ControllerMode.HOLD
        assert answer is not None and answer.command.law is not None
        return float(
            np.linalg.eigvals(answer.command.law.stiffness @ np.linalg.inv(answer.command.law.damping)).real.max()
        )

    assert stiffest() > 2.0 * np.sqrt(20.0 / 2.0)
    law.configure(replace(law.config, max_stiffness=20.0))
    bench.controller.configure(TorqueLimits(), TIMEOUTS)
    assert stiffest() < 1.01 * np.sqrt(20.0 / 2.0)
