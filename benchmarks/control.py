# SPDX-License-Identifier: Apache-2.0
"""One control step of each law of minimal intervention control, in joint space: 7 joints (an arm) and 14 (both)."""

from __future__ import annotations

import os

os.environ.update(OMP_NUM_THREADS="1", OPENBLAS_NUM_THREADS="1")  # before numpy is imported

import sys  # noqa: E402
import time  # noqa: E402
from collections import Counter  # noqa: E402
from collections.abc import Callable, Sequence  # noqa: E402
from functools import partial  # noqa: E402
from pathlib import Path  # noqa: E402

import numpy as np  # noqa: E402

from benchmarks.report import without_options, write_report  # noqa: E402
from tpgmm_core.common.report import Row  # noqa: E402
from tpgmm_core.common.types import Array  # noqa: E402
from tpgmm_core.control.control_law import DynamicState  # noqa: E402
from tpgmm_core.control.laws import LAWS, ReferenceLaw  # noqa: E402
from tpgmm_core.control.predictive import JointLimits, JointReference, PredictiveController, PredictivePlan  # noqa: E402
from tpgmm_core.geometry.gaussian import Gaussian  # noqa: E402
from tpgmm_core.geometry.manifold import POSE  # noqa: E402
from tpgmm_core.kinematics.joint_space import to_joint_space  # noqa: E402
from tpgmm_core.lqr.batch import batch_gains  # noqa: E402
from tpgmm_core.lqr.double_integrator import double_integrator, double_integrator_gains, riccati_gains  # noqa: E402
from tpgmm_core.lqr.finite_horizon import finite_horizon_gains  # noqa: E402
from tpgmm_core.model.reference import Reference  # noqa: E402
from tpgmm_core.robot.model import RobotModel  # noqa: E402

BAXTER = Path(__file__).resolve().parents[1] / "config" / "baxter.yaml"
STEPS, TIME_STEP, CONTROL_COST = 10, 0.05, 1e-2  # a horizon of 0.5 s
HANDS = ("left", "right")
POSE_PRECISION = np.diag([1e4] * 3 + [1e3] * 3)
TO_REACH_MS = 10.0  # predictive control of one arm at 100 Hz
TICKS = 500


class HandsAndGoals:
    """Both hands of Baxter, or one, and where they are to be: goals leap every 50 ticks of 10 ms."""

    def __init__(self, hands: Sequence[str]) -> None:
        self.robot = RobotModel.from_file(BAXTER)
        self.hands = hands
        self.joints = np.concatenate([self.robot.indices(self.robot.endpoints[hand].joints) for hand in hands])
        self.data = self.robot.create_data()
        self.q, self.v = self.robot.home.copy(), np.zeros(self.robot.nv)
        self.data.update(self.q, self.v)
        self.home = {hand: self.data.pose(hand) for hand in hands}
        self.goals = dict(self.home)
        self.ticks = 0
        self._rng = np.random.default_rng(0)

    def limits(self) -> JointLimits:
        """The robot's own."""
        r, i = self.robot, self.joints
        return JointLimits(
            torque=r.effort_limits[i], velocity=r.velocity_limits[i], lower=r.lower_limits[i], upper=r.upper_limits[i]
        )

    def objective(self) -> tuple[Array, Array]:
        """Precision and reference in joint space, of the hands' poses and a weak hold on the posture."""
        n = len(self.joints)
        if self.ticks % 50 == 0:
            for hand, home in self.home.items():
                self.goals[hand] = POSE.exp(home, 0.3 * self._rng.normal(size=6))
        self.ticks += 1
        self.data.update(self.q, self.v)
        q = self.q[self.joints]
        errors = [POSE.log(self.data.pose(hand), self.goals[hand]) for hand in self.hands]
        jacobians = [self.data.jacobian(hand)[:, self.joints] for hand in self.hands]
        precisions = [POSE_PRECISION] * len(self.hands)
        return to_joint_space(
            [*precisions, np.eye(n)], [*jacobians, np.eye(n)], [*errors, self.robot.home[self.joints] - q], q
        )

    def follow(self, plan: PredictivePlan, dt: float = 0.01) -> None:
        """Go on as planned, by the first acceleration."""
        a = plan.accelerations[0]
        self.q[self.joints] += dt * self.v[self.joints] + 0.5 * dt**2 * a
        self.v[self.joints] += dt * a


def laws(situation: HandsAndGoals) -> dict[str, Callable[[], object]]:
    """What is timed, each with a step from an objective to gains."""
    precision, reference = situation.objective()
    n = len(reference)
    A, B = double_integrator(n, TIME_STEP)
    Q, r = np.zeros((STEPS + 1, 2 * n, 2 * n)), np.zeros((STEPS + 1, 2 * n))
    Q[:, :n, :n], r[:, :n] = TIME_STEP * precision, reference
    R, noise = TIME_STEP * CONTROL_COST, 1e-6 * np.eye(2 * n)
    velocity_cost = 0.1 * np.eye(n)
    return {
        "task to joint space": situation.objective,
        "LQR, closed form": lambda: double_integrator_gains(precision, CONTROL_COST),
        "LQR, Riccati, with velocities": lambda: riccati_gains(precision, velocity_cost, CONTROL_COST),
        "LQR, Riccati, discrete": lambda: riccati_gains(precision, velocity_cost, CONTROL_COST, TIME_STEP),
        f"finite horizon, {STEPS} steps": lambda: finite_horizon_gains(A, B, Q, R, r),
        f"risk-sensitive, {STEPS} steps": lambda: finite_horizon_gains(A, B, Q, R, r, noise=noise, risk=1.0),
        f"batch, {STEPS} steps": lambda: batch_gains(A, B, Q, R, r),
    }


class Stopwatch:
    """Wall-clock and processor time of each of some calls, s: apart, since other programs stretch the former only."""

    def __init__(self) -> None:
        self.wall: list[float] = []
        self.processor: list[float] = []

    def time[T](self, step: Callable[[], T]) -> T:
        """Call it, and take its times."""
        wall, processor = time.perf_counter(), time.thread_time()
        result = step()
        self.processor.append(time.thread_time() - processor)
        self.wall.append(time.perf_counter() - wall)
        return result


def predictive(situation: HandsAndGoals) -> tuple[Stopwatch, dict[str, int]]:
    """Times of the solutions in a loop whose goals leap; how often each status came."""
    controller = PredictiveController(np.full(STEPS, TIME_STEP), situation.limits(), control_cost=CONTROL_COST)
    stopwatch, statuses, i = Stopwatch(), Counter[str](), situation.joints
    for _ in range(TICKS):
        precision, reference = situation.objective()
        wanted = JointReference(positions=np.tile(reference, (STEPS, 1)), precisions=np.tile(precision, (STEPS, 1, 1)))
        M = situation.data.mass_matrix(situation.q)[np.ix_(i, i)]
        h = situation.data.nonlinear_effects(situation.q, situation.v)[i]
        solve = partial(controller.solve, situation.q[i], situation.v[i], wanted, M, h)
        plan = stopwatch.time(solve)
        statuses[plan.status] += 1
        situation.follow(plan)
    return stopwatch, statuses


def reference_of(robot: RobotModel, joints: tuple[str, ...]) -> Reference:
    """A Gaussian and ten ahead of it: over joints, or of the left hand's pose where none are named."""
    data = robot.create_data()
    data.update(robot.home)
    if joints:
        here, n = robot.home[robot.indices(joints)], len(joints)
        course = [Gaussian(here + 0.01 * k, 1e-3 * np.eye(n)) for k in range(STEPS + 1)]
    else:
        here = data.pose("left")
        course = [Gaussian(POSE.exp(here, np.full(6, 0.01 * k)), 1e-3 * np.eye(6), POSE) for k in range(STEPS + 1)]
    return Reference(0.0, course[0], TIME_STEP, tuple(course[1:]), np.ones(1), (), joints)


def node_step(name: str, robot: RobotModel, joints: tuple[str, ...]) -> Stopwatch:
    """Times of the law's part of a control step, from reference and state to torques; plans are made within it."""
    law, stopwatch, reference = ReferenceLaw(name, robot), Stopwatch(), reference_of(robot, joints)
    moment = DynamicState.at(robot.create_data(), robot.home, np.zeros(robot.nv))
    law.step(moment, law.target(reference, True), 0.001)
    for _ in range(TICKS):
        stopwatch.time(lambda: law.step(moment, law.target(reference, True), 0.001))
    return stopwatch


def row(work: str, joints: int, stopwatch: Stopwatch, to_reach_ms: float | None = None) -> Row:
    """Percentiles, and whether the slow end reaches what is asked for."""
    p50, p99 = (1e3 * float(np.percentile(stopwatch.wall, percent)) for percent in (50, 99))
    return {
        "work": work,
        "joints": joints,
        "p50_ms": p50,
        "p99_ms": p99,
        "processor_p50_ms": 1e3 * float(np.percentile(stopwatch.processor, 50)),
        "processor_p99_ms": 1e3 * float(np.percentile(stopwatch.processor, 99)),
        "to_reach_ms": to_reach_ms,
        "passed": None if to_reach_ms is None else p99 <= to_reach_ms,
    }


def main() -> int:
    """Measure and report; returns the exit status."""
    rows: list[Row] = []
    for hands in (HANDS[:1], HANDS):
        situation = HandsAndGoals(hands)
        joints = len(situation.joints)
        for name, step in laws(situation).items():
            stopwatch = Stopwatch()
            step()
            for _ in range(TICKS):
                stopwatch.time(step)
            rows.append(row(name, joints, stopwatch))
        solved, statuses = predictive(HandsAndGoals(hands))
        kinds = ", ".join(f"{count} {status}" for status, count in sorted(statuses.items()))
        rows.append(
            row(f"predictive, {STEPS} steps ({kinds})", joints, solved, TO_REACH_MS if len(hands) == 1 else None)
        )
    robot = RobotModel.from_file(BAXTER)
    arms = [tuple(robot.joint_names[i] for i in robot.indices(f"{hand}_arm")) for hand in HANDS]
    for name in LAWS:
        for of, names in (("a pose", ()), ("joints", arms[0]), ("joints", arms[0] + arms[1])):
            rows.append(row(f"node: {name}, of {of}", len(names) or len(arms[0]), node_step(name, robot, names)))
    return write_report("control", rows)


if __name__ == "__main__":
    without_options(__doc__)
    sys.exit(main())
