# SPDX-License-Identifier: Apache-2.0
"""One step of a model of kinematic frames: frames about the configuration, adapting, regression at one time.

Six frames on Baxter's two arms, 14 joints, over time with 5 components: joint space, poses of both hands relative to
objects, the null space of one, and positions of the other hand below it, in the world and relative to an object.
"""

from __future__ import annotations

import os

os.environ.update(OMP_NUM_THREADS="1", OPENBLAS_NUM_THREADS="1")  # before numpy is imported

import gc  # noqa: E402
import sys  # noqa: E402
from pathlib import Path  # noqa: E402

import numpy as np  # noqa: E402

from benchmarks.report import durations, without_options, write_report  # noqa: E402
from tpgmm_core import TPGMM, Adapter, Frame  # noqa: E402
from tpgmm_core.common.report import Row  # noqa: E402
from tpgmm_core.common.types import Array  # noqa: E402
from tpgmm_core.kinematics.frames import (  # noqa: E402
    JointSpace,
    KinematicFrame,
    NullSpace,
    SecondaryTaskSpace,
    TaskSpace,
)
from tpgmm_core.kinematics.moving import ConfigurationProduct, MovingFrames  # noqa: E402
from tpgmm_core.kinematics.tasks import KinematicTask  # noqa: E402
from tpgmm_core.kinematics.urdf import UrdfKinematics  # noqa: E402
from tpgmm_core.robot.model import RobotModel  # noqa: E402

LEFT, RIGHT = KinematicTask("left", "pose", "cup"), KinematicTask("right", "pose", "table")
CANDIDATES: dict[str, KinematicFrame] = {
    "joints": JointSpace(),
    "left": TaskSpace((LEFT,)),
    "right": TaskSpace((RIGHT,)),
    "free of left": NullSpace((LEFT,)),
    "right below left": SecondaryTaskSpace((KinematicTask("right"),), (LEFT,)),
    "left below right": SecondaryTaskSpace((KinematicTask("left", "position", "cup"),), (RIGHT,), least_error=True),
}
OBJECTS = {
    "cup": Frame.from_pose([0.6, 0.3, 0.2], [0.0, 1.0, 0.0, 0.0]),
    "table": Frame.from_pose([0.6, -0.3, 0.1], [0.0, 1.0, 0.0, 0.0]),
}
DURATION = 4.0  # s


def movement(home: Array, rng: np.random.Generator) -> Array:
    """Smooth joint paths (100, n) about the home posture, rad."""
    u = np.linspace(0.0, 1.0, 100)
    waves = np.stack([np.sin(np.pi * k * u) / k for k in (1, 2, 3)], axis=1)
    return home + 0.2 * waves @ rng.normal(size=(3, len(home)))


def main() -> int:
    """Measure and write the report; returns the exit status."""
    robot = RobotModel.from_file(Path(__file__).resolve().parents[1] / "config" / "baxter.yaml")
    joints = [*robot.joint_groups["left_arm"], *robot.joint_groups["right_arm"]]
    frames = MovingFrames(UrdfKinematics(robot, joints), CANDIDATES)
    home = robot.home[robot.indices(joints)]
    rng = np.random.default_rng(0)
    times = np.linspace(0.0, DURATION, 100)
    shown = [frames.demonstration(times, movement(home, rng), OBJECTS, with_time=True) for _ in range(5)]
    model = TPGMM(5, reg_covar=1e-4).fit(shown)
    product, adapter = ConfigurationProduct(model, frames), Adapter(model)
    gc.freeze()
    now = {name: frame.with_time() for name, frame in frames.at(home, OBJECTS).items()}
    state = np.concatenate([[1.0], home])
    rows: list[Row] = []
    for what, step in (
        ("frames", lambda: frames.at(home, OBJECTS)),
        ("adapt and regress", lambda: adapter.adapt_and_condition(now, [1.0], None, state)),
        ("whole step", lambda: product.step(home, OBJECTS, 1.0)),
    ):
        seconds = durations(step, 3000)
        p50, p99 = (1e6 * float(np.percentile(seconds, p)) for p in (50, 99))
        rows.append({"work": what, "p50_us": p50, "p99_us": p99, "passed": p99 < 1000.0})
    return write_report("kinematic_frames", rows)


if __name__ == "__main__":
    without_options(__doc__)
    sys.exit(main())
