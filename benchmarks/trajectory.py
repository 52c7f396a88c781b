# SPDX-License-Identifier: Apache-2.0
"""A smooth trajectory found anew, since a frame has moved: positions (d = 3), poses (d = 6), two hands (d = 12).

One `SmoothTrajectory.situate`: six components of two or three frames adapted, and one Gauss-Newton solution. Share of
adapting is what Eqs. (5, 6) take of it. `half_alone` says how far off, in m or rad, the middle of the movement is where
the middle half of the steps is solved without the rest.
"""

from __future__ import annotations

import itertools
import os

os.environ.update(OMP_NUM_THREADS="1", OPENBLAS_NUM_THREADS="1")  # before numpy is imported

import numpy as np  # noqa: E402

from benchmarks.report import durations, without_options, write_report  # noqa: E402
from tpgmm_core import TPGMM, Demonstration, Frame  # noqa: E402
from tpgmm_core.common.report import Row  # noqa: E402
from tpgmm_core.geometry import quaternion  # noqa: E402
from tpgmm_core.retrieval.dynamic_features import manifold_with_derivatives, with_derivatives  # noqa: E402
from tpgmm_core.retrieval.smooth_trajectory import SmoothTrajectory  # noqa: E402
from tpgmm_core.retrieval.trajectory import TrajectoryModel  # noqa: E402
from workloads import W1, demonstrations, pose_demonstrations  # noqa: E402

SITUATIONS = 200
POSES = "R1 x R3 x S3"


def two_hands(demonstration: Demonstration) -> Demonstration:
    """The second hand goes along, as the first one sees it, 0.3 m aside and turned."""
    frames = {
        name: Frame.stacked([Frame(frame.A[1:, 1:], frame.b[1:])] * 2).with_time()
        for name, frame in demonstration.frames.items()
    }
    hand = Frame.from_pose(demonstration.data[:, 1:4], demonstration.data[:, 4:])
    held = np.concatenate([[0.0, 0.3, 0.0], quaternion.exp([0.0, 0.0, 1.0])])
    data = np.column_stack([demonstration.data, hand.A @ held + hand.b])
    return Demonstration(demonstration.times, data, frames)


def shaken(frames: dict[str, Frame], hands: int, rng: np.random.Generator) -> dict[str, Frame]:
    """The frames, each a little aside and, of poses, turned."""
    result = {}
    for name, frame in frames.items():
        if hands == 0:
            result[name] = Frame(frame.A, frame.b + 0.01 * np.append(0.0, rng.normal(size=3)))
            continue
        turn = Frame.from_pose(0.01 * rng.normal(size=3), quaternion.exp(0.05 * rng.normal(size=3)))
        move = Frame.stacked([turn] * hands).with_time()
        result[name] = Frame(move.A @ frame.A, move.A @ frame.b + move.b)
    return result


def measure(text: str, demos: list[Demonstration], hands: int, steps: int) -> Row:
    """Time of one plan of `steps` steps on a manifold, and how far it is from the whole solution."""
    rng = np.random.default_rng(0)
    manifold = manifold_with_derivatives(text)
    model = TPGMM(6, reg_covar=1e-5, manifold=manifold).fit([with_derivatives(d, text) for d in demos])
    model.metadata_ = {"duration_s": float(np.mean([d.times[-1] for d in demos]))}
    course, whole = SmoothTrajectory(model, steps=steps), TrajectoryModel(model)
    situations = [shaken(dict(demos[0].frames), hands, rng) for _ in range(SITUATIONS)]
    following, adapted = (itertools.cycle(situations) for _ in range(2))
    solved = 1e3 * durations(lambda: course.situate(next(following)), SITUATIONS)
    adapting = 1e3 * durations(lambda: whole.adapt(next(adapted)), SITUATIONS)
    near = course.duration / 2.0 + np.array([0.0, 0.005, 0.01])
    grid, q = np.linspace(0.0, course.duration, steps), steps // 4
    half, full = (whole.retrieve(situations[0], times).positions for times in (grid[q : 3 * q], grid))
    steps_taken = [whole.retrieve(s, np.linspace(0.0, course.duration, steps)).iterations for s in situations]
    return {
        "space": text,
        "steps": steps,
        "p50_ms": float(np.median(solved)),
        "p99_ms": float(np.quantile(solved, 0.99)),
        "adapting": float(np.median(adapting) / np.median(solved)),
        "iterations": float(np.median(steps_taken)),
        "most_iterations": float(np.max(steps_taken)),
        "half_alone": float(np.abs(whole.manifold.log(full[2 * q], half[q])).max()),
        "at_p50_ms": float(np.median(1e3 * durations(lambda: course.at(near), SITUATIONS))),
    }


def main() -> None:
    """Print the table."""
    poses = pose_demonstrations(8)
    work = (
        ("R1 x R3", demonstrations(W1), 0),
        (POSES, poses, 1),
        ("R1 x R3 x S3 x R3 x S3", [two_hands(d) for d in poses], 2),
    )
    write_report("trajectory", [measure(*w, steps) for w in work for steps in (100, 200)])


if __name__ == "__main__":
    without_options(__doc__)
    main()
