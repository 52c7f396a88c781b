# SPDX-License-Identifier: Apache-2.0
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("pinocchio")

import pinocchio as pin

from robots import BAXTER, write_arm
from tpgmm_core.robot.model import RobotModel
from tpgmm_core.robot.simulation import RobotSimulator, RobotState


@pytest.fixture(scope="module")
def baxter() -> RobotModel:
    return RobotModel.from_file(BAXTER)


def gravity(robot: RobotModel, state: RobotState) -> np.ndarray:
    return robot.create_data().nonlinear_effects(state.q, state.v).copy()


def energy(robot: RobotModel, state: RobotState) -> float:
    data = robot.pinocchio.createData()
    kinetic = pin.computeKineticEnergy(robot.pinocchio, data, state.q, state.v)
    return float(kinetic + pin.computePotentialEnergy(robot.pinocchio, data, state.q))


def tilted_arm(folder: Path, friction: dict | None) -> RobotModel:
    """The test arm with its first axis level, so that it swings under gravity."""
    path = write_arm(folder, {"friction": friction})
    urdf = folder / "arm.urdf"
    urdf.write_text(urdf.read_text().replace("0 0 1.5707963267948966", "1.5707963267948966 0 0"))
    return RobotModel.from_file(path)


def test_a_gravity_compensated_robot_stays_where_it_is(baxter: RobotModel) -> None:
    simulator = RobotSimulator(baxter)
    for _ in range(500):
        state = simulator.step(gravity(baxter, simulator.state))
    np.testing.assert_allclose(state.q, baxter.home, atol=1e-9)
    assert state.time == pytest.approx(0.5)
    assert not state.clamped


def test_without_friction_the_arm_falls_as_the_equations_of_motion_say(tmp_path: Path) -> None:
    robot = tilted_arm(tmp_path, {"all": {"viscous": 0.0, "coulomb": 0.0}})
    model = robot.pinocchio
    data = model.createData()
    # the sliding joint is held by its weight and stays off its stops for this long
    v0 = np.array([0.2, 0.1])
    errors = []
    for dt in (2e-3, 1e-3):
        simulator = RobotSimulator(robot, dt)
        simulator.reset(v=v0)
        q, v, h = robot.home.copy(), v0.copy(), dt / 10
        for _ in range(round(0.1 / dt)):
            simulator.step(np.zeros(2))
            for _ in range(10):  # midpoint rule: an error of order h^2
                a = pin.aba(model, data, q, v, np.zeros(2))
                middle = v + 0.5 * h * a
                a = pin.aba(model, data, q + 0.5 * h * v, middle, np.zeros(2))
                q, v = q + h * middle, v + h * a
        errors.append(np.abs(simulator.state.q - q).max())
    assert errors[1] < 2e-3
    assert errors[1] / errors[0] == pytest.approx(0.5, rel=0.1)  # first order, as Euler-Cromer is


@pytest.mark.parametrize("friction", [{"all": {"coulomb": 0.0}}, {"all": {"coulomb": 0.3, "viscous": 0.0}}])
def test_friction_only_takes_energy(tmp_path: Path, friction: dict) -> None:
    robot = tilted_arm(tmp_path, friction)
    simulator = RobotSimulator(robot)
    simulator.reset([-0.5, 0.25], [1.0, 0.0])
    energies = []
    for _ in range(4000):
        energies.append(energy(robot, simulator.state))
        simulator.step(np.zeros(2))
    # Euler-Cromer lets the energy waver by an amount of order dt, which must not add up
    assert max(energies) < energies[0] + 0.05
    assert energies[-1] < energies[0] - 1.0
    assert energies[-1] <= min(energies[:-100]) + 0.01


def test_baxter_collapses_onto_its_stops_and_comes_to_rest(baxter: RobotModel) -> None:
    simulator = RobotSimulator(baxter)
    before = energy(baxter, simulator.state)
    for _ in range(6000):
        state = simulator.step(np.zeros(baxter.nv))
    assert energy(baxter, state) < before
    assert np.abs(state.v).max() < 0.1
    assert (state.q < baxter.upper_limits + 2e-3).all()
    assert (state.q > baxter.lower_limits - 2e-3).all()


def test_stops_speed_and_effort_limits_hold_under_violent_torques(baxter: RobotModel) -> None:
    simulator, rng = RobotSimulator(baxter), np.random.default_rng(0)
    for step in range(3000):
        if step % 50 == 0:
            tau = rng.uniform(-3.0, 3.0, baxter.nv) * baxter.effort_limits
        state = simulator.step(tau)
        assert np.maximum(state.q - baxter.upper_limits, baxter.lower_limits - state.q).max() < 0.015
        assert (np.abs(state.v) < 1.3 * baxter.velocity_limits).all()
        assert (np.abs(state.tau) <= baxter.effort_limits).all()
        assert state.clamped == bool((np.abs(tau) > baxter.effort_limits).any())


def test_full_effort_against_a_stop_is_held(tmp_path: Path) -> None:
    robot = RobotModel.from_file(write_arm(tmp_path))
    simulator = RobotSimulator(robot)
    for _ in range(4000):
        state = simulator.step(robot.effort_limits)
    np.testing.assert_allclose(state.q, robot.upper_limits + 1e-3, atol=2e-4)
    np.testing.assert_allclose(state.v, 0.0, atol=1e-3)


def test_full_effort_reaches_the_speed_limit_and_no_more(tmp_path: Path) -> None:
    robot = RobotModel.from_file(write_arm(tmp_path, {"home": {"turn": -1.9, "slide": 0.0}}))
    simulator, turn = RobotSimulator(robot), robot.indices(["turn"])[0]
    tau = np.zeros(2)
    tau[turn] = robot.effort_limits[turn]
    fastest = max(simulator.step(tau).v[turn] for _ in range(1500))
    assert 0.98 * robot.velocity_limits[turn] < fastest < 1.05 * robot.velocity_limits[turn]


@pytest.mark.parametrize("viscous", [0.7, 1e4])
def test_friction_is_stable_on_the_lightest_joints(tmp_path: Path, viscous: float) -> None:
    # explicit Euler would need dt d < 2 m: 0.03 kg fingers with 1e4 N s/m are far beyond that
    text = BAXTER.read_text().replace("coulomb: 1.0", f"coulomb: 1.0, viscous: {viscous}")
    (tmp_path / "robot.yaml").write_text(text)
    robot = RobotModel.from_file(tmp_path / "robot.yaml")
    simulator = RobotSimulator(robot, time_step=0.005)
    v0 = np.zeros(robot.nv)
    for joints in ("grippers", "left_arm"):
        v0[robot.indices(joints)] = 0.5
    speeds = [np.abs(simulator.reset(v=v0).v).max()]
    for _ in range(100):
        speeds.append(np.abs(simulator.step(gravity(robot, simulator.state)).v).max())
    assert max(speeds) < 0.7
    assert np.abs(simulator.state.v[robot.indices("grippers")]).max() < 1e-3


@pytest.mark.parametrize("direction", range(6))
def test_a_wrench_acts_at_its_frame_in_base_axes(baxter: RobotModel, direction: int) -> None:
    simulator, data = RobotSimulator(baxter), baxter.create_data()
    wrench = np.zeros(6)
    wrench[direction] = 5.0
    data.update(baxter.home)
    tau = gravity(baxter, simulator.state)
    pushed = simulator.step(tau, {"left_gripper": wrench})
    data_after = baxter.create_data()
    data_after.update(pushed.q, pushed.v)
    assert wrench @ data_after.twist("left") > 0.0
    simulator.reset()
    driven = simulator.step(tau + data.jacobian("left").T @ wrench)
    np.testing.assert_allclose(pushed.v, driven.v, atol=1e-12)
    np.testing.assert_array_equal(pushed.tau, tau)  # a wrench is not the motors' doing


def test_wrenches_add_up(baxter: RobotModel) -> None:
    both, twice = RobotSimulator(baxter), RobotSimulator(baxter)
    tau, push = gravity(baxter, both.state), np.array([1.0, 2.0, 3.0, 0.1, 0.2, 0.3])
    a = both.step(tau, {"left_gripper": push, "right_gripper": -push})
    first, second = RobotSimulator(baxter), RobotSimulator(baxter)
    v = first.step(tau, {"left_gripper": push}).v + second.step(tau, {"right_gripper": -push}).v
    np.testing.assert_allclose(a.v, v, atol=1e-12)
    np.testing.assert_array_equal(twice.step(tau, {"left_gripper": push}).v, first.state.v)


def test_the_same_input_gives_the_same_result(baxter: RobotModel) -> None:
    runs = []
    for _ in range(2):
        simulator, rng = RobotSimulator(baxter), np.random.default_rng(4)
        for _ in range(200):
            simulator.step(rng.normal(size=baxter.nv) * 5.0, {"left_gripper": rng.normal(size=6)})
        runs.append(simulator.state.q)
    np.testing.assert_array_equal(*runs)


def test_bad_input_is_refused_and_changes_nothing(baxter: RobotModel) -> None:
    simulator = RobotSimulator(baxter)
    good = np.zeros(baxter.nv)
    simulator.step(good)
    before = simulator.state
    bad = good.copy()
    bad[3] = np.nan
    nan_wrench = {"left_gripper": np.full(6, np.nan)}
    for tau, wrenches, message in (
        (bad, {}, "tau has values that are not finite"),
        (good[:7], {}, r"tau has shape \(7,\)"),
        (good, nan_wrench, "wrench at 'left_gripper' has values"),
        (good, {"left_gripper": np.zeros(3)}, "wrench at 'left_gripper' has shape"),
        (good, {"tail": np.zeros(6)}, "no frame 'tail'"),
    ):
        with pytest.raises(ValueError, match=message):
            simulator.step(tau, wrenches)
        assert simulator.state is before
    simulator.step(good)
    reference = RobotSimulator(baxter)
    reference.step(good)
    np.testing.assert_array_equal(reference.step(good).q, simulator.state.q)


def test_bad_starts_are_refused(baxter: RobotModel) -> None:
    with pytest.raises(ValueError, match="time_step"):
        RobotSimulator(baxter, time_step=0.0)
    with pytest.raises(ValueError, match="outside the position limits of .*left_s1"):
        q0 = baxter.home.copy()
        q0[baxter.indices(["left_s1"])] = 2.0
        RobotSimulator(baxter, q0=q0)
    with pytest.raises(ValueError, match="not finite"):
        RobotSimulator(baxter).reset(v=np.full(baxter.nv, np.inf))


def sliding(folder: Path) -> RobotModel:
    """The test arm without friction: its slide of 0.5 kg moves freely between stops at 0 and 0.5 m, with 20 N."""
    return RobotModel.from_file(write_arm(folder, {"friction": {"all": {"viscous": 0.0, "coulomb": 0.0}}}))


def test_a_joint_settles_in_its_stop_as_fast_as_stated_and_leaves_it_unbraked(tmp_path: Path) -> None:
    """The stop is a spring of 20 N/mm, with a damper of 0.01 s times that against what comes: implicit Euler."""
    robot = sliding(tmp_path)
    m, K, dt = 0.5, 20.0 / 1e-3, 1e-3
    D = 0.01 * K
    turn, slide = robot.joint_names.index("turn"), robot.joint_names.index("slide")
    simulator = RobotSimulator(robot, dt)
    start = np.zeros(2)
    start[slide] = 0.5
    simulator.reset(start)
    pull = np.zeros(2)
    depth = v = 0.0
    for force, damping, steps in ((20.0, D, 60), (-20.0, 0.0, 4)):
        pull[slide] = force
        for _ in range(steps):
            v = (m * v + dt * (force - K * depth)) / (m + dt * damping + dt**2 * K)
            depth += dt * v
            state = simulator.step(pull)
            np.testing.assert_allclose([state.q[slide] - 0.5, state.v[slide]], [depth, v], rtol=1e-7, atol=1e-12)
        assert abs(state.q[turn]) < 1e-9
        if force > 0.0:
            assert 0.95e-3 < depth < 1e-3
