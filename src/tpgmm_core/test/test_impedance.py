# SPDX-License-Identifier: Apache-2.0
from collections import deque
from collections.abc import Callable, Mapping

import numpy as np
import pytest

pytest.importorskip("pinocchio")

from robots import BAXTER
from tpgmm_core import Gaussian
from tpgmm_core.control.control_law import LawTorques
from tpgmm_core.control.controller import Controller, TorqueCommand
from tpgmm_core.control.impedance import ImpedanceConfig, ImpedanceLaw
from tpgmm_core.control.pose_target import PoseReference
from tpgmm_core.geometry import quaternion
from tpgmm_core.model.reference import Reference
from tpgmm_core.robot.model import RobotModel
from tpgmm_core.robot.simulation import RobotSimulator

DT = 0.001
FIRM, SOFT = np.diag([0.005**2] * 3 + [0.02**2] * 3), np.diag([0.1**2] * 3 + [0.4**2] * 3)

Policy = Callable[[float], PoseReference | None]


@pytest.fixture(scope="module")
def baxter() -> RobotModel:
    return RobotModel.from_file(BAXTER)


@pytest.fixture(scope="module")
def law(baxter: RobotModel) -> ImpedanceLaw:
    return ImpedanceLaw(baxter)


@pytest.fixture(scope="module")
def home(baxter: RobotModel) -> np.ndarray:
    data = baxter.create_data()
    data.update(baxter.home)
    return data.pose("left")


class Loop:
    """Controller and simulator in lockstep at 1 kHz, with a delay of the torques in steps."""

    def __init__(self, robot: RobotModel, config: ImpedanceConfig | None = None, delay: int = 0) -> None:
        self.simulator, self.law = RobotSimulator(robot, DT), ImpedanceLaw(robot, "left", config)
        self.controller = Controller(robot, self.law)
        gravity = robot.create_data().gravity(robot.home).copy()
        self._late = deque([gravity] * delay)

    def run(
        self, seconds: float, reference: Policy, wrenches: Mapping[str, np.ndarray] | None = None
    ) -> list[TorqueCommand]:
        commands = []
        for step in range(round(seconds / DT)):
            state = self.simulator.state
            commands.append(self.step(state.q, state.v, reference(step * DT)))
            self._late.append(commands[-1].tau)
            self.simulator.step(self._late.popleft(), wrenches or {})
        return commands

    def step(self, q: np.ndarray, v: np.ndarray, reference: PoseReference | None, dt: float = DT) -> TorqueCommand:
        target = None if reference is None else self.law.pose_target(reference)
        command = self.controller.step(q, v, target, dt)
        assert command is not None
        return command


def asked(command: TorqueCommand) -> LawTorques:
    assert command.law is not None
    return command.law


def at(pose: np.ndarray, covariance: np.ndarray = FIRM) -> Policy:
    return lambda _: PoseReference(pose, covariance)


def largest_step(commands: list[TorqueCommand], robot: RobotModel) -> float:
    """Largest change of a torque from step to step, as a share of its limit."""
    return float((np.abs(np.diff([c.tau for c in commands], axis=0)) / robot.effort_limits).max())


def millimetres(command: TorqueCommand) -> float:
    return 1e3 * float(np.linalg.norm(asked(command).error[:3]))


def degrees(command: TorqueCommand) -> float:
    return float(np.degrees(np.linalg.norm(asked(command).error[3:])))


@pytest.mark.parametrize("delay", [0, 2])
def test_a_slow_movement_is_followed_in_spite_of_friction(baxter: RobotModel, home: np.ndarray, delay: int) -> None:
    duration, way, turn = 3.0, np.array([0.1, 0.2, 0.2]), np.array([0.0, 0.0, np.pi / 3])

    def minimum_jerk(t: float) -> PoseReference:
        s = min(1.0, t / duration)
        share, speed = 10 * s**3 - 15 * s**4 + 6 * s**5, (30 * s**2 - 60 * s**3 + 30 * s**4) / duration
        orientation = quaternion.multiply(quaternion.exp(share * turn), home[3:])
        twist = speed * np.concatenate([way, turn])
        return PoseReference(np.concatenate([home[:3] + share * way, orientation]), FIRM, twist)

    commands = Loop(baxter, delay=delay).run(duration + 0.2, minimum_jerk)
    assert millimetres(commands[-1]) < 3.0
    assert degrees(commands[-1]) < 1.0
    assert max(map(millimetres, commands)) < 5.0
    assert not any(command.limited or command.reason for command in commands)


def test_the_tau_is_the_sum_of_its_terms(baxter: RobotModel, home: np.ndarray) -> None:
    home = home + np.r_[0.01, 0.02, 0.0, np.zeros(4)]
    for command in Loop(baxter).run(0.3, at(home)):
        law = asked(command)
        assert set(law.terms) == {"feedforward", "feedback", "null_space", "hold", "leading"}
        np.testing.assert_allclose(law.tau, sum(law.terms.values()), atol=1e-12)
    np.testing.assert_allclose(command.tau, law.tau, atol=1e-12)
    assert not command.limited


def test_the_hand_obeys_the_gains_of_the_lqr(baxter: RobotModel, home: np.ndarray) -> None:
    """Without friction and with full hold, the hand accelerates by K_P e: the double integrator is no fiction."""
    loop = Loop(baxter)
    command = loop.run(0.6, at(home))[-1]
    goal = home + np.r_[0.002, 0.0, 0.001, np.zeros(4)]
    loop.step(loop.simulator.state.q, loop.simulator.state.v, PoseReference(goal, FIRM))
    q, v = loop.simulator.state.q, np.zeros(baxter.nv)
    command = loop.step(q, v, PoseReference(goal, FIRM))
    data, arm = baxter.create_data(), baxter.indices("left_arm")
    data.update(q)
    J, M = data.jacobian("left")[:, arm], data.mass_matrix(q)[np.ix_(arm, arm)]
    acceleration = J @ np.linalg.solve(
        M, asked(command).terms["feedback"][arm] + asked(command).terms["null_space"][arm]
    )
    Lambda = np.linalg.inv(J @ np.linalg.solve(M, J.T))
    np.testing.assert_allclose(
        Lambda @ acceleration, asked(command).stiffness @ asked(command).error, rtol=1e-6, atol=1e-9
    )
    assert acceleration[0] == pytest.approx(asked(command).error[0] / (0.005 * np.sqrt(0.02)), rel=1e-3)


def test_a_firm_reference_resists_a_push_and_a_soft_one_gives_way(baxter: RobotModel, home: np.ndarray) -> None:
    push = {"left_gripper": np.array([5.0, 0.0, 0.0, 0.0, 0.0, 0.0])}
    moved = {}
    for name, covariance in (("firm", FIRM), ("soft", SOFT)):
        loop = Loop(baxter)
        loop.run(0.6, at(home, covariance))
        moved[name] = millimetres(loop.run(1.5, at(home, covariance), push)[-1])
        assert millimetres(loop.run(2.0, at(home, covariance))[-1]) < 0.5 * moved[name]
    assert moved["firm"] < 10.0
    assert moved["soft"] > 50.0


def test_the_stiff_direction_is_that_of_the_small_variance(baxter: RobotModel, home: np.ndarray) -> None:
    moved = []
    for axis in (0, 1):
        variances = np.array([0.1, 0.1, 0.005, 0.02, 0.02, 0.02]) ** 2
        variances[axis] = 0.005**2
        loop, push = Loop(baxter), np.zeros(6)
        push[1] = 5.0
        loop.run(0.6, at(home, np.diag(variances)))
        loop.run(1.0, at(home, np.diag(variances)), {"left_gripper": push})
        data = baxter.create_data()
        data.update(loop.simulator.state.q)
        moved.append(abs(data.pose("left")[1] - home[1]))
    assert moved[0] > 5.0 * moved[1]


@pytest.mark.parametrize("delay", [0, 2])
def test_the_largest_stiffness_is_stable(baxter: RobotModel, home: np.ndarray, delay: int) -> None:
    certain = np.eye(6) * 1e-10
    loop = Loop(baxter, delay=delay)
    loop.run(0.6, at(home, certain))
    shove = {"left_gripper": np.array([30.0, -30.0, 20.0, 1.0, 0.0, 0.0])}
    loop.run(0.05, at(home, certain), shove)
    commands = loop.run(0.8, at(home, certain))
    assert np.abs(loop.simulator.state.v).max() < 0.02
    assert millimetres(commands[-1]) < 1.0


@pytest.mark.parametrize("period", [1, 10, 100])
def test_leaping_stiffness_does_not_shake_the_arm(baxter: RobotModel, home: np.ndarray, period: int) -> None:
    rng = np.random.default_rng(period)
    covariances = []
    for _ in range(1500 // period + 1):
        axes, _ = np.linalg.qr(rng.normal(size=(6, 6)))
        covariances.append((axes * 10.0 ** rng.uniform(-8, -1, 6)) @ axes.T)
    offset = home + np.r_[0.005, -0.005, 0.005, np.zeros(4)]
    loop = Loop(baxter)
    commands = loop.run(1.5, lambda t: PoseReference(offset, covariances[round(t / DT) // period]))
    assert max(map(millimetres, commands)) < 15.0
    assert np.abs(loop.simulator.state.v).max() < 0.5


def test_a_reference_takes_hold_without_a_jump(baxter: RobotModel, home: np.ndarray) -> None:
    commands = Loop(baxter).run(0.8, at(home + np.r_[0.05, 0.05, 0.05, np.zeros(4)]))
    assert largest_step(commands[:10], baxter) < 0.001
    assert largest_step(commands, baxter) < 0.02
    assert [asked(commands[0]).blend, asked(commands[-1]).blend] == pytest.approx([DT / 0.5, 1.0])


@pytest.mark.parametrize("gap", [0.05, 0.2, 1.0])
def test_a_reference_lost_and_found_again_makes_no_jump(baxter: RobotModel, home: np.ndarray, gap: float) -> None:
    loop, push = Loop(baxter), {"left_gripper": np.array([4.0, 2.0, -2.0, 0.0, 0.0, 0.0])}
    loop.run(1.5, at(home), push)
    seen: Policy = lambda t: None if t < gap else PoseReference(home, FIRM)  # noqa: E731
    commands = loop.run(gap + 1.5, seen, push)
    assert largest_step(commands, baxter) < 0.02
    assert millimetres(commands[-1]) < 10.0


def test_without_reference_the_arm_can_be_led_by_hand_and_comes_to_rest(baxter: RobotModel) -> None:
    loop, arm = Loop(baxter), baxter.indices("left_arm")
    start = loop.simulator.state.q
    loop.run(0.3, lambda _: None)
    np.testing.assert_allclose(loop.simulator.state.q, start, atol=1e-6)
    loop.run(1.0, lambda _: None, {"left_gripper": np.array([5.0, 5.0, 0.0, 0.0, 0.0, 0.0])})
    led = loop.simulator.state.q
    assert np.abs(led - start)[arm].max() > 0.1
    released = np.abs(loop.simulator.state.v[arm]).max()
    loop.run(2.0, lambda _: None)
    assert np.abs(loop.simulator.state.v[arm]).max() < 0.5 * released
    others = np.setdiff1d(np.arange(baxter.nv), arm)
    np.testing.assert_allclose(loop.simulator.state.q[others], start[others], atol=2e-3)


def test_the_null_space_returns_to_the_rest_posture_while_the_hand_stays(baxter: RobotModel) -> None:
    config = ImpedanceConfig(posture_stiffness=25.0, posture_damping=10.0)
    loop = Loop(baxter, config)
    q0, arm = baxter.home.copy(), baxter.indices("left_arm")
    data = baxter.create_data()
    data.update(q0)
    _, _, rows = np.linalg.svd(data.jacobian("left")[:, arm])
    q0[arm] += 0.3 * rows[-1]
    data.update(q0)
    loop.simulator.reset(q0)
    commands = loop.run(4.0, at(data.pose("left")))
    before, after = (np.linalg.norm((q - baxter.home)[arm]) for q in (q0, loop.simulator.state.q))
    assert after < 0.5 * before
    assert max(map(millimetres, commands)) < 5.0


def test_a_far_reference_is_approached_at_the_bounded_speed(baxter: RobotModel, home: np.ndarray) -> None:
    loop = Loop(baxter)
    goal = home + np.r_[0.05, 0.3, 0.25, np.zeros(4)]
    data, fastest = baxter.create_data(), 0.0
    for _ in range(35):
        command = loop.run(0.1, at(goal))[-1]
        data.update(loop.simulator.state.q, loop.simulator.state.v)
        fastest = max(fastest, float(np.linalg.norm(data.twist("left")[:3])))
    assert 0.3 < fastest < 0.5
    assert millimetres(command) < 5.0


def test_the_effort_limits_hold_whatever_is_asked(baxter: RobotModel, home: np.ndarray) -> None:
    rng = np.random.default_rng(0)
    q = v = None
    loop = Loop(baxter)
    previous = None
    for _ in range(300):
        q = rng.uniform(baxter.lower_limits, baxter.upper_limits)
        v = rng.normal(size=baxter.nv) * baxter.velocity_limits
        goal = np.concatenate([rng.normal(size=3), quaternion.normalize(rng.normal(size=4))])
        command = loop.step(q, v, PoseReference(goal, FIRM, rng.normal(size=6)))
        assert (np.abs(command.tau) <= baxter.effort_limits).all()
        if previous is not None:
            assert (np.abs(command.tau - previous) <= (30.0 * DT + 1e-12) * baxter.effort_limits).all()
            assert command.limited
        previous = command.tau


BAD = np.array([np.nan] + [0.0] * 6)


@pytest.mark.parametrize(
    ("change", "reason"),
    [
        ({"pose": BAD}, "not finite"),
        ({"pose": np.r_[0.5, 0.0, 0.0, np.zeros(4)]}, "quaternion of the reference is zero"),
        ({"covariance": np.full((6, 6), np.nan)}, "not finite"),
        ({"covariance": np.zeros((6, 6))}, "not positive definite"),
        ({"covariance": -np.eye(6)}, "not positive definite"),
        ({"covariance": np.eye(6) * 1e-320}, "not positive definite"),
        ({"twist": np.full(6, np.inf)}, "not finite"),
        ({"acceleration": np.full(6, np.nan)}, "not finite"),
    ],
)
def test_a_bad_reference_is_refused_with_the_reason(
    law: ImpedanceLaw, home: np.ndarray, change: dict, reason: str
) -> None:
    good = {"pose": home, "covariance": FIRM}
    with np.errstate(all="ignore"), pytest.raises(ValueError, match=reason):
        law.pose_target(PoseReference(**{**good, **change}))


def test_a_reference_that_is_no_pose_is_refused(law: ImpedanceLaw) -> None:
    plane = Reference(0.0, Gaussian(np.zeros(2), np.eye(2)), 0.0, (), np.ones(1), ())
    with pytest.raises(ValueError, match="expected a pose on 'R3 x S3'"):
        law.target(plane, moving=True)


@pytest.mark.parametrize("which", ["q", "v"])
def test_a_state_that_is_not_finite_gives_gravity_compensation_where_the_robot_was_last(
    baxter: RobotModel, which: str
) -> None:
    controller, zero = Loop(baxter).controller, np.zeros(baxter.nv)
    bad = {"q": baxter.home, "v": zero, which: np.full(baxter.nv, np.nan)}
    assert controller.step(bad["q"], bad["v"], None, DT) is None  # nothing is known of the robot yet
    for _ in range(100):
        good = controller.step(baxter.home, zero, None, DT)
    command = controller.step(bad["q"], bad["v"], None, DT)
    assert good is not None and command is not None
    np.testing.assert_allclose(command.tau, good.tau, atol=1e-9)
    assert "not finite" in command.reason


def test_finite_but_absurd_input_gives_finite_torques(baxter: RobotModel, home: np.ndarray) -> None:
    loop, huge = Loop(baxter), np.full(6, 1e300)
    loop.run(0.6, at(home))
    state = loop.simulator.state
    with np.errstate(all="ignore"):
        far = PoseReference(np.r_[1e300, 0.0, 0.0, home[3:]], FIRM, huge, huge)
        assert np.isfinite(loop.step(state.q, state.v, far).tau).all()
        command = loop.step(state.q, np.full(baxter.nv, 1e200), None)
    assert "out of all proportion" in command.reason
    assert np.isfinite(command.tau).all()


@pytest.mark.parametrize("dt", [0.0, -1.0, np.nan, 1e9, np.inf])
def test_no_time_step_makes_the_torque_jump(baxter: RobotModel, home: np.ndarray, dt: float) -> None:
    loop = Loop(baxter)
    aside = home + np.r_[0.1, 0.0, 0.0, np.zeros(4)]
    before = loop.run(0.1, at(aside))
    state = loop.simulator.state
    command = loop.step(state.q, state.v, PoseReference(aside, FIRM), dt)
    assert np.isfinite(command.tau).all()
    assert asked(command).blend <= asked(before[-1]).blend + 0.005 / 0.5 + 1e-12
    assert (np.abs(command.tau - before[-1].tau) <= 30.0 * 0.005 * baxter.effort_limits).all()


def test_reset_starts_anew(baxter: RobotModel, home: np.ndarray) -> None:
    loop = Loop(baxter)
    first = loop.run(0.2, at(home))[0]
    loop.controller.reset()
    again = loop.step(baxter.home, np.zeros(baxter.nv), PoseReference(home, FIRM))
    np.testing.assert_array_equal(again.tau, first.tau)


def test_wrong_shapes_and_settings_are_refused(baxter: RobotModel, home: np.ndarray) -> None:
    controller = Loop(baxter).controller
    with pytest.raises(ValueError, match=r"shapes \(7,\)"):
        controller.step(np.zeros(7), np.zeros(7), None, DT)
    with pytest.raises(ValueError, match="covariance of the reference has shape"):
        PoseReference(home, np.eye(3))
    with pytest.raises(ValueError, match="no end point 'tail'"):
        ImpedanceLaw(baxter, "tail")
    with pytest.raises(ValueError, match="rest_posture"):
        ImpedanceLaw(baxter, rest_posture=[0.0])
    with pytest.raises(ValueError, match="control_cost is 0.0, expected"):
        ImpedanceConfig(control_cost=0.0)
    with pytest.raises(ValueError, match="above max_stiffness"):
        ImpedanceConfig(min_stiffness=10.0, max_stiffness=1.0)
