# SPDX-License-Identifier: Apache-2.0
"""One step of every retrieval method: time, frames and the robot's pose in; a reference, two Gaussians ahead, out.

Models of the pick-and-place recordings, with the settings of their task file; the steps go through a whole movement, as
a loop would. Frames stand still, or move before each step.
"""

from __future__ import annotations

import argparse
import os
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path

os.environ.update(OMP_NUM_THREADS="1", OPENBLAS_NUM_THREADS="1")  # before numpy is imported

import gc  # noqa: E402
import time  # noqa: E402

import numpy as np  # noqa: E402

from benchmarks.report import write_report  # noqa: E402
from benchmarks.reproduction_step import percentiles  # noqa: E402
from tpgmm_core import Frame  # noqa: E402
from tpgmm_core.common.report import Row  # noqa: E402
from tpgmm_core.common.types import Array  # noqa: E402
from tpgmm_core.geometry.quaternion import exp, multiply  # noqa: E402
from tpgmm_core.retrieval.methods import METHODS, make_retrieval  # noqa: E402
from tpgmm_core.retrieval.recipe import Recipe  # noqa: E402
from tpgmm_ros.recordings.bags import align, find_bags, read_recordings  # noqa: E402
from tpgmm_ros.task.state_space import MANIFOLD  # noqa: E402
from tpgmm_ros.task.task_file import Task  # noqa: E402

STEPS = 1000


def situations(poses: Mapping[str, Array], moving: bool) -> list[dict[str, Frame]]:
    """The frames of each step: one mapping; or all but the robot's go round in circles of 2 cm and turn by 0.1 rad."""
    standing = {name: Frame.from_pose(pose[:3], pose[3:]).with_time() for name, pose in poses.items()}
    if not moving:
        return [standing] * STEPS
    result = []
    for angle in np.linspace(0.0, 4.0 * np.pi, STEPS):
        shift, turn = 0.02 * np.array([np.cos(angle) - 1.0, np.sin(angle), 0.0]), exp([0.0, 0.0, 0.1 * np.sin(angle)])
        moved = {
            name: Frame.from_pose(pose[:3] + shift, multiply(turn, pose[3:])).with_time()
            for name, pose in poses.items()
            if name != "robot"
        }
        result.append({**standing, **moved})
    return result


def measure(method: str, recipe: Recipe, demonstrations: Sequence, poses: Mapping[str, Array]) -> list[Row]:
    """Two rows of the table: frames that stand still, frames that move."""
    model = recipe.learn(demonstrations, MANIFOLD)
    rows: list[Row] = []
    for moving in (False, True):
        retrieval = make_retrieval(model, method)
        frames = situations(poses, moving)
        pose = demonstrations[0].data[0, 1:]
        taken = np.empty(STEPS)
        for _ in range(2):  # the first movement is not counted
            retrieval.start(0, pose)
            robot = pose
            for i in range(STEPS):
                time_ns = round(1e9 * retrieval.duration * i / STEPS)
                start = time.perf_counter()
                reference = retrieval.step(time_ns, frames[i], robot)
                taken[i] = time.perf_counter() - start
                robot = reference.gaussian.mean
        rows.append({"method": method, "frames": "moving" if moving else "standing", **percentiles(taken[1:]),
                     "first_us": 1e6 * float(taken[0])})  # fmt: skip
    return rows


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the program; returns its exit status."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--task", type=Path, default=Path("config/pick_place.yaml"))
    parser.add_argument("--bags", type=Path, default=Path("bags/pick_place"))
    parser.add_argument("--every", type=int, default=4, metavar="N", help="learn from every N-th sample")
    parser.add_argument("--methods", nargs="+", choices=METHODS, default=list(METHODS))
    options = parser.parse_args(arguments)
    task = Task.load(options.task)
    recordings, bad = read_recordings(find_bags([options.bags]), task, options.every)
    if bad:
        raise bad[0]
    demonstrations, duration = align(recordings)
    poses = {name: frame[0] for name, frame in recordings[0].frames.items()}
    gc.freeze()
    rows = [
        row
        for method in options.methods
        for row in measure(method, Recipe.of(task.model, method), demonstrations, poses)
    ]
    print(f"{len(recordings)} demonstrations of {duration:.1f} s, K = {task.model['n_components']}, {STEPS} steps")
    write_report("retrieval_step", rows)
    return 0


if __name__ == "__main__":
    sys.exit(main())
