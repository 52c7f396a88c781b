# SPDX-License-Identifier: Apache-2.0
"""How late joint states may be: a simulated step of the hand for ever later ones, for each robot and precision.

For each the computed delay margin of the gains, the delay from which on the arm swings where the controller is not told
of it, and what it does where it is: the table of docs/explanation/delays.md.
"""

from __future__ import annotations

import os

os.environ.update(OMP_NUM_THREADS="1", OPENBLAS_NUM_THREADS="1")  # before numpy is imported

import argparse  # noqa: E402
import sys  # noqa: E402
from pathlib import Path  # noqa: E402

import numpy as np  # noqa: E402

from benchmarks.report import write_report  # noqa: E402
from delayed_loop import DelayedLoop, LoopRecord, pose_reference  # noqa: E402
from tpgmm_core.common.report import Row  # noqa: E402
from tpgmm_core.control.supervision import ControllerMode  # noqa: E402
from tpgmm_core.robot.model import RobotModel  # noqa: E402

CONFIG = Path(__file__).resolve().parents[1] / "config"
ROBOTS = {"baxter": "left", "panda": "hand", "ur5": "tool", "xarm7": "tool"}
#: Standard deviations of references, m; ten times as many rad.
DEVIATIONS = (0.002, 0.01, 0.05)
DELAYS_MS = (10, 20, 30, 40, 60, 80)
AWAY = np.array([0.0, 0.06, 0.04, 0.0, 0.0, 0.0, 0.0])
TICKS = 2000
#: An arm that moves faster than this share of a speed limit in the last second does not settle.
SETTLED = 0.03


def step_of_the_hand(robot: RobotModel, endpoint: str, deviation: float, late: float, tells: bool) -> LoopRecord:
    """The hand is sent 7 cm away."""
    loop = DelayedLoop(robot, endpoint, lambda _: late, tells=tells)
    loop.run(50)
    return loop.run(TICKS, pose_reference(loop.pose() + AWAY, deviation))


def settles(robot: RobotModel, record: LoopRecord) -> bool:
    """Whether the arm came to rest, and nothing swung on the way."""
    swung = any("swings" in reason for reason in record.reasons)
    return not swung and record.fastest(slice(TICKS - 1000, None), robot.velocity_limits) < SETTLED


def first(values: list[int]) -> int | None:
    """The smallest one, if any."""
    return min(values, default=None)


def main() -> int:
    """Measure and report; returns the exit status."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("robots", nargs="*", default=list(ROBOTS), help=f"some of {', '.join(ROBOTS)}")
    rows: list[Row] = []
    for name in parser.parse_args().robots:
        robot = RobotModel.from_file(CONFIG / f"{name}.yaml")
        for deviation in DEVIATIONS:
            unaware = [
                ms
                for ms in DELAYS_MS
                if not settles(robot, step_of_the_hand(robot, ROBOTS[name], deviation, 1e-3 * ms, False))
            ]
            aware = {ms: step_of_the_hand(robot, ROBOTS[name], deviation, 1e-3 * ms, True) for ms in DELAYS_MS}
            damped = [ms for ms, record in aware.items() if record.modes[-1] == ControllerMode.DAMPING]
            softer = [ms for ms, record in aware.items() if record.shares[-1] < 0.95]
            rows.append(
                {
                    "robot": name,
                    "deviation_m": deviation,
                    "swings_unawares_from_ms": first(unaware),
                    "softer_from_ms": first(softer),
                    "damping_from_ms": first(damped),
                    "largest_speed_share": max(c.fastest(slice(None), robot.velocity_limits) for c in aware.values()),
                    "passed": all(settles(robot, record) for record in aware.values()),
                }
            )
    return write_report("delay", rows)


if __name__ == "__main__":
    sys.exit(main())
