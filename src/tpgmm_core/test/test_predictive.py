# SPDX-License-Identifier: Apache-2.0
"""Model predictive control within limits, on problems whose answers are known and on Baxter's arm."""

import subprocess
import sys

import numpy as np
import pytest

from robots import BAXTER

pytest.importorskip("daqp")

from tpgmm_core.control.predictive import JointLimits, JointReference, Plan, PredictiveController
from tpgmm_core.geometry.manifold import POSE
from tpgmm_core.kinematics.joint_space import to_joint_space
from tpgmm_core.lqr.batch import batch_gains
from tpgmm_core.lqr.double_integrator import double_integrator, double_integrator_gains, double_integrator_value
from tpgmm_core.robot.model import RobotModel
from tpgmm_core.robot.simulation import RobotSimulator

Array = np.ndarray
STEPS = np.full(10, 0.05)


def limits(n: int, torque: float = np.inf, velocity: float = np.inf, position: float = np.inf) -> JointLimits:
    full = np.full(n, 1.0)
    return JointLimits(torque=torque * full, velocity=velocity * full, lower=-position * full, upper=position * full)


def reference(positions: Array, precision: Array, N: int = 10) -> JointReference:
    n = len(precision)
    return JointReference(positions=np.broadcast_to(positions, (N, n)), precisions=np.tile(precision, (N, 1, 1)))


def controller(joint_limits: JointLimits, **options: object) -> PredictiveController:
    return PredictiveController(STEPS, joint_limits, control_cost=1e-2, **options)  # type: ignore[arg-type]


INERTIA, BIAS = np.array([[1.2, 0.3], [0.3, 0.5]]), np.array([2.0, -1.0])
PRECISION = np.array([[40.0, 10.0], [10.0, 20.0]])


def solve(mpc: PredictiveController, q: Array, v: Array, goal: Array) -> Plan:
    return mpc.solve(q, v, reference(goal, PRECISION), INERTIA, BIAS)


def test_far_from_its_limits_it_is_the_endless_lqr() -> None:
    """With the infinite-horizon value as terminal cost, small steps make the law of continuous time."""
    mpc = PredictiveController(np.full(25, 2e-3), limits(2), control_cost=1e-2)
    q, v, goal = np.array([0.3, -0.2]), np.array([0.1, 0.5]), np.array([0.5, 0.1])
    plan = mpc.solve(q, v, reference(goal, PRECISION, 25), INERTIA, BIAS)
    gains = double_integrator_gains(PRECISION, 1e-2)
    expected = gains.stiffness @ (goal - q) - gains.damping @ v
    np.testing.assert_allclose(plan.accelerations[0], expected, rtol=0.06, atol=0.06 * np.abs(expected).max())
    np.testing.assert_allclose(plan.stiffness, gains.stiffness, rtol=0.06, atol=0.06 * np.abs(gains.stiffness).max())
    np.testing.assert_allclose(plan.torque, INERTIA @ plan.accelerations[0] + BIAS, rtol=1e-12)
    assert plan.status == "optimal"


def test_without_limits_it_is_the_batch_solution() -> None:
    mpc = controller(limits(2))
    q, v, goal = np.array([0.3, -0.2]), np.array([0.1, 0.5]), np.array([0.5, 0.1])
    Q, r = np.zeros((11, 4, 4)), np.tile([*goal, 0.0, 0.0], (11, 1))
    Q[1:, :2, :2] = 0.05 * PRECISION
    Q[-1] += double_integrator_value(PRECISION, 1e-2)
    law = batch_gains(*double_integrator(2, 0.05), Q, 0.05 * 1e-2, r)
    plan = solve(mpc, q, v, goal)
    np.testing.assert_allclose(plan.accelerations, law.controls(np.concatenate([q, v])), rtol=1e-7, atol=1e-7)


def test_all_limits_are_kept_on_the_way_and_the_goal_is_reached() -> None:
    mpc = controller(limits(2, torque=6.0, velocity=0.8, position=1.0))
    q, v, goal = np.array([-0.9, 0.9]), np.zeros(2), np.array([0.95, -0.95])
    fastest, strongest = 0.0, 0.0
    for _ in range(100):
        plan = solve(mpc, q, v, goal)
        assert plan.status == "optimal"
        assert (np.abs(plan.torque) <= 6.0).all()
        assert (np.abs(plan.velocities) <= 0.8 + 1e-6).all() and (np.abs(plan.positions) <= 1.0 + 1e-6).all()
        q, v = plan.positions[0], plan.velocities[0]  # the model is exact here
        fastest, strongest = max(fastest, np.abs(v).max()), max(strongest, np.abs(plan.torque).max())
    np.testing.assert_allclose(q, goal, atol=1e-3)
    assert fastest > 0.79 and strongest > 5.9  # the limits were met, or nothing would have been shown


def test_a_goal_beyond_a_stop_ends_at_the_stop() -> None:
    mpc = controller(limits(2, torque=20.0, velocity=2.0, position=0.5))
    q, v = np.zeros(2), np.zeros(2)
    for _ in range(60):
        plan = solve(mpc, q, v, np.array([3.0, 3.0]))
        q, v = plan.positions[0], plan.velocities[0]
        assert plan.status == "optimal" and (q <= 0.5 + 1e-6).all()
    assert q[0] == pytest.approx(0.5, abs=1e-3)


@pytest.mark.parametrize(("q", "v"), [([1.4, 0.0], [0.0, 0.0]), ([0.95, 0.0], [3.0, 0.0]), ([0.0, 0.0], [5.0, -5.0])])
def test_where_limits_cannot_be_kept_it_comes_back_as_torques_allow(q: list[float], v: list[float]) -> None:
    """Beyond a stop, too fast before one, and faster than any brake."""
    mpc = controller(limits(2, torque=6.0, velocity=0.8, position=1.0))
    where, how_fast = np.array(q), np.array(v)
    plan = solve(mpc, where, how_fast, np.zeros(2))
    assert plan.status == "softened" and plan.excess > 0.0
    assert (np.abs(plan.torque) <= 6.0).all()
    for _ in range(400):
        plan = solve(mpc, where, how_fast, np.zeros(2))
        assert (np.abs(plan.torque) <= 6.0).all()
        where, how_fast = plan.positions[0], plan.velocities[0]
    assert plan.status == "optimal"
    np.testing.assert_allclose(where, 0.0, atol=1e-2)


def test_a_solver_that_is_stopped_gives_the_law_without_limits_cut_to_its_torques() -> None:
    mpc = controller(limits(2, torque=6.0, velocity=0.8, position=1.0), max_iterations=1)
    plan = solve(mpc, np.array([-0.9, 0.9]), np.zeros(2), np.array([5.0, -5.0]))
    assert plan.status == "fallback"
    assert (np.abs(plan.torque) <= 6.0).all() and np.isfinite(plan.accelerations).all()
    np.testing.assert_allclose(plan.torque, INERTIA @ plan.accelerations[0] + BIAS, rtol=1e-9)


def test_the_answer_depends_on_nothing_but_the_question() -> None:
    """Also after a problem whose limits were all met: nothing of it is kept."""
    mpc = controller(limits(2, torque=6.0, velocity=0.8, position=1.0))
    question = np.array([-0.9, 0.9]), np.zeros(2), np.array([0.95, -0.95])
    first = solve(mpc, *question)
    assert solve(mpc, np.array([1.4, 0.0]), np.array([3.0, -3.0]), np.array([9.0, 9.0])).status == "softened"
    again = solve(mpc, *question)
    np.testing.assert_array_equal(again.accelerations, first.accelerations)
    assert again.status == "optimal"


def test_velocities_are_tracked_where_they_matter() -> None:
    mpc = controller(limits(2))
    wanted = JointReference(
        positions=np.zeros((10, 2)),
        precisions=np.tile(1e-6 * np.eye(2), (10, 1, 1)),
        velocities=np.tile([0.4, -0.3], (10, 1)),
        velocity_precisions=np.tile(50.0 * np.eye(2), (10, 1, 1)),
    )
    plan = mpc.solve(np.zeros(2), np.zeros(2), wanted, INERTIA, BIAS)
    np.testing.assert_allclose(plan.velocities[5], [0.4, -0.3], atol=0.01)


def test_a_moving_reference_is_met_ahead_and_its_end_is_no_stop() -> None:
    mpc = controller(limits(2))
    course = 0.5 * mpc.times[:, None] * np.ones(2)
    moving = JointReference(positions=course, precisions=np.tile(1e4 * np.eye(2), (10, 1, 1)))
    plan = mpc.solve(np.zeros(2), np.full(2, 0.5), moving, INERTIA, BIAS)
    np.testing.assert_allclose(plan.positions, course, atol=1e-6)
    np.testing.assert_allclose(plan.accelerations, 0.0, atol=1e-5)


def test_baxters_hand_follows_a_frame_that_leaps_within_all_limits() -> None:
    """In the simulator, with friction: plans at 50 Hz, in between the feedback around the plan at 1 kHz."""
    robot = RobotModel.from_file(BAXTER)
    arm = robot.indices(robot.endpoints["left"].joints)
    torque, velocity = robot.effort_limits[arm], robot.velocity_limits[arm]
    lower, upper = robot.lower_limits[arm], robot.upper_limits[arm]
    arm_limits = JointLimits(torque=torque, velocity=velocity, lower=lower, upper=upper)
    mpc = PredictiveController(STEPS, arm_limits, control_cost=1e-2)
    simulator, data = RobotSimulator(robot), robot.create_data()
    data.update(robot.home)
    start = data.pose("left")
    fastest = 0.0
    for step in range(2500):
        q, v = simulator.state.q, simulator.state.v
        if step % 20 == 0:
            data.update(q, v)
            goal = POSE.exp(start, [0.0, 0.0, 0.15 if step < 1000 else -0.1, 0.0, 0.0, 0.3])
            tasks = [np.diag([1e4] * 3 + [1e3] * 3), 1e-2 * np.eye(7)]
            errors = [POSE.log(data.pose("left"), goal), robot.home[arm] - q[arm]]
            precision, positions = to_joint_space(tasks, [data.jacobian("left")[:, arm], np.eye(7)], errors, q[arm])
            M, h = data.mass_matrix(q)[np.ix_(arm, arm)].copy(), data.nonlinear_effects(q, v)[arm].copy()
            plan = mpc.solve(q[arm], v[arm], reference(positions, precision), M, h)
            assert plan.status != "fallback" and (np.abs(plan.torque) <= torque).all()
            q_plan, v_plan = q[arm].copy(), v[arm].copy()
        q_plan += 1e-3 * v_plan
        v_plan += 1e-3 * plan.accelerations[0]
        feedback = M @ (plan.stiffness @ (q_plan - q[arm]) + plan.damping @ (v_plan - v[arm]))
        tau = data.gravity(q).copy()
        tau[arm] = np.clip(plan.torque + feedback, -torque, torque)
        state = simulator.step(tau)
        assert not state.clamped
        assert (np.abs(state.v[arm]) <= 1.02 * velocity).all()
        assert (state.q[arm] >= lower - 1e-3).all() and (state.q[arm] <= upper + 1e-3).all()
        fastest = max(fastest, float((np.abs(state.v[arm]) / velocity).max()))
    data.update(simulator.state.q)
    error = POSE.log(data.pose("left"), goal)
    assert np.linalg.norm(error[:3]) < 0.01 and np.linalg.norm(error[3:]) < 0.05
    assert fastest > 0.9  # a limit was met, or nothing would have been shown


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: PredictiveController([], limits(2)), "time_steps"),
        (lambda: PredictiveController([0.1, -0.1], limits(2)), "time step is positive"),
        (lambda: PredictiveController(STEPS, limits(2), control_cost=[1.0, 0.0]), "control_cost"),
        (lambda: limits(2, torque=0.0), "positive"),
        (lambda: solve(controller(limits(2)), np.zeros(3), np.zeros(2), np.zeros(2)), "shape"),
        (lambda: solve(controller(limits(2)), np.array([np.nan, 0.0]), np.zeros(2), np.zeros(2)), "finite"),
    ],
)
def test_bad_input_is_refused(make: object, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        make()  # type: ignore[operator]


def test_only_the_predictive_module_needs_its_solver() -> None:
    program = (
        "import sys; sys.modules['daqp'] = None\n"
        "import tpgmm_core.lqr.batch, tpgmm_core.lqr.finite_horizon\n"
        "try:\n    import tpgmm_core.control.predictive\n"
        "except ImportError as error:\n    print(error)"
    )
    result = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True)
    assert "pip install daqp" in result.stdout
