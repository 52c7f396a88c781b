# SPDX-License-Identifier: Apache-2.0
"""What `train --auto` reproduces of demonstrations that took no part in any of its choices, beside simpler ways.

Each demonstration in turn is left out; frames, method and settings are chosen among the others alone. Data sets are
given as a task file and a directory of bags. A run that was interrupted goes on where it was.
"""

from __future__ import annotations

import argparse
import json
import os
import sys
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

os.environ.update(OMP_NUM_THREADS="1", OPENBLAS_NUM_THREADS="1")  # before numpy is imported

import numpy as np  # noqa: E402
from tqdm import tqdm  # noqa: E402

from benchmarks.irrelevant_frames import SETS  # noqa: E402
from benchmarks.retrieval_table import errors  # noqa: E402
from tpgmm_core import Demonstration  # noqa: E402
from tpgmm_core.choice.automatic import choose, positions_alone  # noqa: E402
from tpgmm_core.choice.reproducing import reproduce, without_frames  # noqa: E402
from tpgmm_core.choice.trial import Trial  # noqa: E402
from tpgmm_core.common.atomic_file import write_atomically  # noqa: E402
from tpgmm_core.common.report import format_table  # noqa: E402
from tpgmm_core.common.types import Array  # noqa: E402
from tpgmm_core.geometry import quaternion  # noqa: E402
from tpgmm_core.retrieval.recipe import Recipe  # noqa: E402
from tpgmm_ros.models.validation import replay_nearest  # noqa: E402
from tpgmm_ros.recordings.bags import Recording, align, find_bags, read_recordings  # noqa: E402
from tpgmm_ros.task.task_file import Task  # noqa: E402

AUTO = "--auto"
PLAIN = ("promp", "gaussian_process", "time_steps", "dmp")
"""Methods beside it, with the frames and settings of the task file."""


def ways(
    task: Task, others: Sequence[Recording], left_out: Recording, options: argparse.Namespace
) -> Iterator[tuple[str, Array, dict[str, Any]]]:
    """Name, path in the situation of what was left out, and what was chosen."""
    training, duration = align(others)
    situation, space = left_out.to_demonstration(duration), str(task.space.manifold())
    if all((shown.data[:, 4:] == quaternion.IDENTITY).all() for shown in training):
        training, situation, space = [positions_alone(item) for item in training], positions_alone(situation), "R1 x R3"
    choice = choose(
        training,
        space,
        task.model,
        task.derived,
        trials=options.trials,
        seconds=options.seconds,
        workers=options.workers,
        methods=options.methods,
    )
    best = choice.best
    chosen = {"method": best.trial.method, "frames": list(best.trial.frames), "settings": dict(best.trial.settings)}
    yield (
        AUTO,
        reproduce(choice.learn(training, space), situation),
        {"chosen": chosen, "expected_m": best.mean().position},
    )
    recipe = Recipe.of(task.model)
    yield "task file", reproduce(recipe.learn(training, space), situation), {}
    for method in PLAIN:
        plain_recipe = Trial.of(method, tuple(training[0].frames), task.model).recipe
        try:
            yield f"{method}, as it comes", reproduce(plain_recipe.learn(training, space), situation), {}
        except ValueError:  # frames that contradict each other: the hand stays, as `train --auto` counts it
            yield f"{method}, as it comes", np.tile(situation.data[:1, 1:], (len(situation.times), 1)), {}
    plain = [without_frames(shown) for shown in training]
    yield "no frames", reproduce(recipe.learn(plain, space), without_frames(situation)), {}
    yield "mean demonstration", _mean(training, situation), {}
    path = replay_nearest(others, left_out, list(task.sources or task.frames)[-1])
    yield "nearest, replayed", path[:, : situation.data.shape[1] - 1], {}


def _mean(training: Sequence[Demonstration], situation: Demonstration) -> Array:
    """Of the poses that were shown at the same share of the time."""
    times, first = situation.times, training[0]
    paths = []
    for shown in training:
        points = shown.data[:, 1:].copy()
        if points.shape[1] == 7:
            points[:, 3:] = quaternion.continuous(points[:, 3:])
            points[:, 3:] *= np.sign(points[0, 3:] @ first.data[0, 4:]) or 1.0
        paths.append(np.column_stack([np.interp(times, shown.times, column) for column in points.T]))
    mean = np.mean(paths, axis=0)
    if mean.shape[1] == 7:
        mean[:, 3:] = quaternion.normalize(mean[:, 3:])
    return np.asarray(mean)


def show(name: str, rows: Sequence[Mapping[str, Any]]) -> None:
    """One table."""
    names = list(dict.fromkeys(row["way"] for row in rows))
    values = {way: np.array([row["position_rmse_m"] for row in rows if row["way"] == way]) for way in names}
    best = min(names, key=lambda way: values[way].mean())
    lines = []
    for way in names:
        mine = [row for row in rows if row["way"] == way]
        more = values[way] - values[best]
        error = f"{more.std(ddof=1) / np.sqrt(len(more)):.4f}" if len(more) > 1 and way != best else ""
        columns = [
            np.mean([row[key] for row in mine])
            for key in ("position_end_m", "orientation_mean_deg", "orientation_end_deg")
        ]
        lines.append(
            (way, f"{values[way].mean():.4f}", f"{np.median(values[way]):.4f}", f"{more.mean():+.4f}", error)
            + (f"{columns[0]:.3f}", f"{columns[1]:.1f}", f"{columns[2]:.1f}")
        )
    n = len(values[AUTO])
    print(f"\n{name}: {n} demonstrations, each by models of the others, with all choices made among those")
    head = ("", "RMSE m", "median m", "more than the best", "+-", "end m", "mean deg", "end deg")
    print(format_table(head, lines))
    for row in rows:
        if row["way"] == AUTO:
            chosen = row["chosen"]
            settings = {
                key: chosen["settings"].get(key)
                for key in ("covariance", "n_components", "regularization", "reg_covar", "prune")
            }
            said = " ".join(str(value) for value in settings.values() if value is not None)
            print(
                f"  without {row['left_out']}: {chosen['method']}, {' '.join(chosen['frames'])}, {said}; "
                f"expected {row['expected_m']:.3f} m, was {row['position_rmse_m']:.3f} m"
            )


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the program; returns its exit status."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument(
        "--set", nargs=2, action="append", metavar=("TASK", "BAGS"), help="task file, directory of bags"
    )
    parser.add_argument("--trials", type=int, default=60, help="ways of learning that are tried in each fold (60)")
    parser.add_argument("--stride", type=int, default=1, metavar="N", help="leave out every N-th alone (default: 1)")
    parser.add_argument("--methods", nargs="+", help="of retrieval that are tried (default: all)")
    parser.add_argument("--seconds", type=float, help="time for each fold; without, trials alone count")
    parser.add_argument("--workers", type=int, default=os.cpu_count() or 1, help="processes (default: one per core)")
    parser.add_argument(
        "--output", type=Path, default=Path("out/results/automatic"), help="of a JSON file for each set"
    )
    options = parser.parse_args(arguments)
    for task_file, directory in options.set or SETS:
        if not Path(directory).is_dir():
            print(f"automatic: {directory} left out, it is no directory")
            continue
        task = Task.load(task_file)
        recordings, bad = read_recordings(find_bags([directory]), task)
        if bad:
            raise bad[0]
        path = options.output / f"{task.name}.json"
        path.parent.mkdir(parents=True, exist_ok=True)
        rows: list[dict[str, Any]] = json.loads(path.read_text()) if path.exists() else []
        done = {row["left_out"] for row in rows}
        for left_out in tqdm(recordings[:: options.stride], desc=task.name, disable=None, file=sys.stderr):
            if left_out.name in done:
                continue
            others = [recording for recording in recordings if recording is not left_out]
            for way, poses, more in ways(task, others, left_out, options):
                rows.append({"left_out": left_out.name, "way": way, **errors(poses, left_out), **more})
            text = json.dumps(rows, indent=1)
            write_atomically(path, lambda draft, text=text: draft.write_text(text))  # type: ignore[misc]
        show(task.name, rows)
    return 0


if __name__ == "__main__":
    sys.exit(main())
