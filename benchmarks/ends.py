# SPDX-License-Identifier: Apache-2.0
"""Whether movements end where demonstrations that were left out ended: every retrieval method, few components or more.

Each demonstration in turn is reproduced in its situation by models of the others, with the frames and settings of the
task file. Methods with a state of their own may take twice the time to their end.
"""

from __future__ import annotations

import argparse
import os
import sys
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

os.environ.update(OMP_NUM_THREADS="1", OPENBLAS_NUM_THREADS="1")  # before numpy is imported

import numpy as np  # noqa: E402
from tqdm import tqdm  # noqa: E402

from benchmarks.irrelevant_frames import SETS  # noqa: E402
from tpgmm_core.choice.automatic import POSITIONS, has_orientations, positions_alone  # noqa: E402
from tpgmm_core.choice.reproducing import reproduce  # noqa: E402
from tpgmm_core.choice.trial import SAMPLES, Trial, thinned  # noqa: E402
from tpgmm_core.common.report import format_table  # noqa: E402
from tpgmm_core.geometry import quaternion  # noqa: E402
from tpgmm_core.retrieval.methods import METHODS  # noqa: E402
from tpgmm_ros.programs.reporting import write_report  # noqa: E402
from tpgmm_ros.recordings.bags import align, find_bags, read_recordings  # noqa: E402
from tpgmm_ros.task.task_file import Task  # noqa: E402


def measure(task: Task, bags: Path, options: argparse.Namespace) -> Iterator[dict[str, Any]]:
    """A row for each method, number of components and demonstration left out."""
    recordings, bad = read_recordings(find_bags([bags]), task)
    if bad:
        raise bad[0]
    settings = {**task.model, **{key: True for key in ("own_end", "time_warping") if getattr(options, key)}}
    for left_out in tqdm(recordings, desc=task.name, disable=None, file=sys.stderr):
        others = [recording for recording in recordings if recording is not left_out]
        shown, duration = align(others)
        training, situation = [thinned(item, SAMPLES) for item in shown], left_out.to_demonstration(duration)
        space = str(task.space.manifold())
        if not any(has_orientations(item) for item in training):
            training, situation = [positions_alone(item) for item in training], positions_alone(situation)
            space = POSITIONS
        situation, done = thinned(situation, SAMPLES), set()
        for method in options.methods:
            for components in options.components:
                trial = Trial.of(method, tuple(training[0].frames), settings | {"n_components": components})
                if trial.key in done:  # a method without components
                    continue
                done.add(trial.key)
                path = reproduce(trial.recipe.learn(training, space), situation, settle=1.0)
                points, T = situation.data[:, 1:], len(situation.times)
                row = {
                    "left_out": left_out.name,
                    "method": method,
                    "n_components": components if "n_components" in trial.settings else None,
                    "end_m": float(np.linalg.norm(path[-1, :3] - points[-1, :3])),
                    "rmse_m": float(np.sqrt(np.mean(np.sum((path[:T, :3] - points[:, :3]) ** 2, axis=1)))),
                }
                if points.shape[1] == 7:
                    row["end_deg"] = float(np.degrees(quaternion.angle_between(path[-1, 3:], points[-1, 3:])))
                yield row


def summary(rows: Sequence[dict[str, Any]]) -> list[dict[str, Any]]:
    """Means over the demonstrations."""
    found = []
    keys = list(dict.fromkeys((row["method"], row["n_components"]) for row in rows))
    for method, components in keys:
        mine = [row for row in rows if (row["method"], row["n_components"]) == (method, components)]
        means = {key: float(np.mean([row[key] for row in mine])) for key in mine[0] if key.startswith(("end", "rmse"))}
        found.append({"method": method, "n_components": components, **means})
    return found


def _show(name: str, rows: Sequence[dict[str, Any]]) -> None:
    print(f"\n{name}: means over the demonstrations, each reproduced by a model of the others")
    lines = [
        (
            row["method"],
            row["n_components"] or "",
            f"{row['end_m']:.4f}",
            f"{row['end_deg']:.1f}" if "end_deg" in row else "",
            f"{row['rmse_m']:.4f}",
        )
        for row in rows
    ]
    print(format_table(("method", "K", "end m", "end deg", "RMSE m"), lines))


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the program; returns its exit status."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument(
        "--set", nargs=2, action="append", metavar=("TASK", "BAGS"), help="task file, directory of bags"
    )
    parser.add_argument("--methods", nargs="+", choices=list(METHODS), default=list(METHODS), help="default: all")
    parser.add_argument("--components", type=int, nargs="+", default=[3, 5, 10], metavar="K", help="default: 3 5 10")
    parser.add_argument("--time-warping", action="store_true", help="learn with `time_warping`")
    parser.add_argument("--own-end", action="store_true", help="learn with `own_end`, those methods that have it")
    parser.add_argument("--output", type=Path, default=Path("out/results/ends"), help="of report.json")
    options = parser.parse_args(arguments)
    report = {}
    for task_file, directory in options.set or SETS:
        if not Path(directory).is_dir():
            print(f"ends: {directory} left out, it is no directory")
            continue
        task = Task.load(task_file)
        rows = list(measure(task, Path(directory), options))
        report[task.name] = {"means": summary(rows), "rows": rows}
        _show(task.name, report[task.name]["means"])
    print(f"report: {write_report(options.output, report)}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
