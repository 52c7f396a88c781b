# SPDX-License-Identifier: Apache-2.0
"""The full Baxter, headless and in lockstep: how much faster than real time, alone and under the controller."""

from __future__ import annotations

import os

os.environ.update(OMP_NUM_THREADS="1", OPENBLAS_NUM_THREADS="1")  # before numpy is imported

import sys  # noqa: E402
from collections.abc import Callable  # noqa: E402
from pathlib import Path  # noqa: E402

import numpy as np  # noqa: E402

from benchmarks.report import durations, without_options, write_report  # noqa: E402
from tpgmm_core.common.report import Row  # noqa: E402
from tpgmm_core.control.controller import Controller  # noqa: E402
from tpgmm_core.control.impedance import ImpedanceLaw  # noqa: E402
from tpgmm_core.control.pose_target import PoseReference  # noqa: E402
from tpgmm_core.robot.model import RobotModel  # noqa: E402
from tpgmm_core.robot.simulation import RobotSimulator  # noqa: E402

BAXTER = Path(__file__).resolve().parents[1] / "config" / "baxter.yaml"
STEPS, TIME_STEP = 5000, 0.001
COVARIANCE = np.diag([0.005**2] * 3 + [0.02**2] * 3)


def row(work: str, step: Callable[[], object], to_reach: float | None = None) -> Row:
    """Percentiles of a step, and the real-time factor of all steps together, pauses included."""
    seconds = durations(step, STEPS, warm_up=100)
    factor = float(TIME_STEP / seconds.mean())
    return {
        "work": work,
        "p50_us": 1e6 * float(np.median(seconds)),
        "p99_us": 1e6 * float(np.percentile(seconds, 99)),
        "times_real_time": factor,
        "passed": None if to_reach is None else factor >= to_reach,
    }


def main() -> int:
    """Measure and report; returns the exit status."""
    robot = RobotModel.from_file(BAXTER)
    data = robot.create_data()
    data.update(robot.home)
    pose = data.pose("left")
    falling, held, pushed = (RobotSimulator(robot, TIME_STEP) for _ in range(3))
    zero = np.zeros(robot.nv)
    wrench = {"left_gripper": np.array([1.0, 0.0, 0.0, 0.0, 0.0, 0.0])}
    controlled, law = RobotSimulator(robot, TIME_STEP), ImpedanceLaw(robot)
    controller = Controller(robot, law)
    reference = PoseReference(pose + np.r_[0.05, 0.05, 0.05, np.zeros(4)], COVARIANCE)

    def weight(simulator: RobotSimulator) -> np.ndarray:
        return data.nonlinear_effects(simulator.state.q, simulator.state.v)

    def control() -> np.ndarray:
        state = controlled.state
        command = controller.step(state.q, state.v, law.pose_target(reference), TIME_STEP)
        assert command is not None
        return command.tau

    return write_report(
        "simulator",
        [
            row("held by gravity compensation", lambda: held.step(weight(held)), to_reach=10.0),
            row("falling onto its stops", lambda: falling.step(zero), to_reach=10.0),
            row("led by a wrench", lambda: pushed.step(weight(pushed), wrench), to_reach=10.0),
            row("controller alone (constant state)", control),
            row("controller and simulator in a loop", lambda: controlled.step(control())),
        ],
    )


if __name__ == "__main__":
    without_options(__doc__)
    sys.exit(main())
