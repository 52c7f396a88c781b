# SPDX-License-Identifier: Apache-2.0
"""Every retrieval method on recordings of real robots, by leave-one-out; beside it, no frames, a replay, and baselines.

Each demonstration in turn is reproduced in its situation by models of the others. Covariance structure and number of
components are chosen anew each time, by leave-one-out among those others (held-out log-likelihood), for all methods
alike. A movement with a state of its own starts where the demonstration did; it may take twice the time to its end.
"""

from __future__ import annotations

import argparse
import os
import sys
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import product
from pathlib import Path
from typing import Any

os.environ.update(OMP_NUM_THREADS="1", OPENBLAS_NUM_THREADS="1")  # before numpy is imported

import numpy as np  # noqa: E402
from tqdm import tqdm  # noqa: E402

from tpgmm_core import Demonstration, Frame, LearnedMixture  # noqa: E402
from tpgmm_core.choice.baselines import BASELINES, Learner  # noqa: E402
from tpgmm_core.choice.reproducing import reproduce, without_frames  # noqa: E402
from tpgmm_core.common.report import format_table  # noqa: E402
from tpgmm_core.common.types import Array  # noqa: E402
from tpgmm_core.geometry import quaternion  # noqa: E402
from tpgmm_core.geometry.manifold import Manifold  # noqa: E402
from tpgmm_core.learning.held_out import SelectableEstimator  # noqa: E402
from tpgmm_core.learning.selection import select_model  # noqa: E402
from tpgmm_core.retrieval.methods import DEFAULT, METHODS  # noqa: E402
from tpgmm_core.retrieval.recipe import Recipe  # noqa: E402
from tpgmm_ros.models.validation import path_errors, replay_nearest  # noqa: E402
from tpgmm_ros.programs.reporting import write_report  # noqa: E402
from tpgmm_ros.recordings.bags import Recording, find_bags, read_recordings  # noqa: E402
from tpgmm_ros.task.task_file import Task  # noqa: E402

WITHOUT_FRAMES = "no frames"
REPLAY = "nearest, replayed"
SHARES = np.linspace(0.0, 1.0, 200)


@dataclass(frozen=True, slots=True)
class DataSet:
    """Recordings, and what is learned of them.

    Parameters
    ----------
    recordings, task
        as `train` takes them
    anchor
        the frame that a replay moves with
    with_orientation
        False where none was recorded; positions alone are learned then
    """

    recordings: Sequence[Recording]
    task: Task
    anchor: str
    with_orientation: bool

    @property
    def space(self) -> str:
        """Of [time, point]."""
        return "R1 x R3 x S3" if self.with_orientation else "R1 x R3"

    def demonstration(self, recording: Recording, duration: float) -> Demonstration:
        """In `space`, with time stretched to a duration, s."""
        whole = recording.to_demonstration(duration)
        if self.with_orientation:
            return whole
        frames = {name: Frame(f.A[..., :4, :4], f.b[..., :4]) for name, f in whole.frames.items()}
        return Demonstration(whole.times, whole.data[:, :4], frames, whole.visible)


def data_sets(directory: Path) -> Iterator[tuple[str, DataSet]]:
    """Those that are there, by name.

    Raises
    ------
    ValueError
        for recordings that cannot be read
    """
    for name, anchor, with_orientation in (("baxter_valve", "valve", True), ("franka_bolts", "goal", False)):
        if not (directory / name).is_dir():
            print(f"retrieval_table: {name} left out, {directory / name} is no directory; it is no part of the project")
            continue
        task = Task.load(f"config/{name}.yaml")
        recordings, bad = read_recordings(find_bags([directory / name]), task)
        if bad:
            raise bad[0]
        yield name, DataSet(recordings, task, anchor, with_orientation)


def candidates(task: Task) -> dict[str, dict[str, Any]]:
    """What is chosen from, by name: settings of a model; those that are not named are the task file's."""
    base = {key: value for key, value in task.model.items() if key not in ("init", "covariance", "n_components")}
    return {
        f"{covariance} {K}": {**base, "covariance": covariance, "n_components": K}
        for covariance, K in product(("full", "diag"), (3, 5, 7, 10))
    }


def measure(data: DataSet) -> Iterator[dict[str, Any]]:
    """A row for each demonstration left out, each method, and each of the candidates that could be learned.

    `chosen` marks the candidate that leave-one-out among the others takes.
    """
    settings = candidates(data.task)
    learners: dict[Any, list[str]] = {}
    for name, learner in METHODS.items():
        learners.setdefault((learner.encoding, learner.estimator), []).append(name)
    for left_out in tqdm(data.recordings, desc="left out", disable=None, file=sys.stderr):
        others = [recording for recording in data.recordings if recording is not left_out]
        duration = float(np.mean([recording.duration for recording in others]))
        training = [data.demonstration(recording, duration) for recording in others]
        situation = data.demonstration(left_out, duration)
        row = {"left_out": left_out.name}
        for methods in learners.values():
            for candidate, chosen, model in learned(settings, methods[0], training, data.space):
                for method in methods:
                    path = reproduce(model, situation, method, settle=1.0)
                    yield {**row, "method": method, "candidate": candidate, "chosen": chosen, **errors(path, left_out)}
        plain = [without_frames(demonstration) for demonstration in training]
        for candidate, chosen, model in learned(settings, DEFAULT, plain, data.space):
            path = reproduce(model, without_frames(situation))
            yield {**row, "method": WITHOUT_FRAMES, "candidate": candidate, "chosen": chosen, **errors(path, left_out)}
        settings_of_task = Learner.of(Manifold.parse(data.space), data.task.model)
        for name, learn in BASELINES.items():
            path = learn(training, settings_of_task)(situation)
            yield {**row, "method": name, "candidate": "", "chosen": True, **errors(path, left_out)}
        replay = replay_nearest(others, left_out, data.anchor)
        yield {**row, "method": REPLAY, "candidate": "", "chosen": True, **errors(replay, left_out)}


def learned(
    settings: Mapping[str, Mapping[str, Any]], method: str, training: Sequence[Demonstration], space: str
) -> Iterator[tuple[str, bool, LearnedMixture]]:
    """Name of the candidate, whether leave-one-out takes it, and its model of all that it was given."""
    recipes = {name: Recipe.of(values, method) for name, values in settings.items()}
    manifold = Manifold.parse(space)
    encoding = next(iter(recipes.values())).encoding
    estimators: dict[str, SelectableEstimator] = {
        name: recipe.method.estimator(**recipe.arguments, manifold=encoding.manifold(manifold))
        for name, recipe in recipes.items()
    }
    table = select_model(estimators, [encoding.encode(demonstration, manifold) for demonstration in training])
    for row in table.rows:
        if row.error is None:
            yield row.name, row is table.best, recipes[row.name].learn(training, manifold)


def errors(path: Array, recording: Recording) -> dict[str, float]:
    """Errors of a path (T or more, 3 or 7) against the one that was shown.

    At the same times, at the same shares of the way, and at the end; of orientations too where the path has them.
    """
    shown = recording.movement
    if path.shape[1] == 3:
        path = np.hstack([path, np.tile(quaternion.IDENTITY, (len(path), 1))])
        shown = np.hstack([shown[:, :3], np.tile(quaternion.IDENTITY, (len(shown), 1))])
    in_time = path_errors(path[: len(shown)], shown)
    by_share = path_errors(at_shares(path), at_shares(shown))
    return {
        "position_rmse_m": in_time.position_rmse_m,
        "position_rmse_by_share_m": by_share.position_rmse_m,
        "position_end_m": by_share.position_end_m,
        "orientation_mean_deg": in_time.orientation_mean_deg,
        "orientation_mean_by_share_deg": by_share.orientation_mean_deg,
        "orientation_end_deg": by_share.orientation_end_deg,
    }


def at_shares(path: Array) -> Array:
    """Poses of a path (T, 7) at equal shares of its length, (200, 7)."""
    length = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(path[:, :3], axis=0), axis=1))])
    smooth = np.hstack([path[:, :3], quaternion.continuous(path[:, 3:])])
    found = np.column_stack([np.interp(SHARES * length[-1], length, column) for column in smooth.T])
    found[:, 3:] = quaternion.normalize(found[:, 3:])
    found[-1] = path[-1]  # which may have gone on turning
    return found


def summary(rows: Sequence[Mapping[str, Any]]) -> list[dict[str, Any]]:
    """Means over the demonstrations, for each method: of what was chosen, and the least of one candidate for all."""
    keys = [key for key, value in rows[0].items() if isinstance(value, float)]
    result = []
    for method in dict.fromkeys(row["method"] for row in rows):
        mine = [row for row in rows if row["method"] == method]
        chosen = [row for row in mine if row["chosen"]]
        n_folds = len(chosen)
        means = {}
        for candidate in dict.fromkeys(row["candidate"] for row in mine):
            values = [row["position_rmse_by_share_m"] for row in mine if row["candidate"] == candidate]
            if len(values) == n_folds:
                means[candidate] = float(np.mean(values))
        best = min(means, key=means.__getitem__)
        result.append(
            {
                "method": method,
                **{key: float(np.mean([row[key] for row in chosen])) for key in keys},
                "position_rmse_by_share_median_m": float(np.median([r["position_rmse_by_share_m"] for r in chosen])),
                "chosen": ", ".join(
                    f"{n} × {name}" for name, n in Counter(r["candidate"] for r in chosen).most_common()
                ),
                "best_candidate": best,
                "best_position_rmse_by_share_m": means[best],
            }
        )
    return result


def show(name: str, data: DataSet, means: Sequence[Mapping[str, Any]]) -> None:
    """One table."""
    columns = {
        "position_rmse_m": ("RMSE, same time (m)", 3),
        "position_rmse_by_share_m": ("RMSE, same share (m)", 3),
        "position_end_m": ("end (m)", 3),
        "orientation_mean_by_share_deg": ("mean (deg)", 1),
        "orientation_end_deg": ("end (deg)", 1),
        "best_position_rmse_by_share_m": ("RMSE, best candidate (m)", 3),
    }
    if not data.with_orientation:
        columns = {key: value for key, value in columns.items() if not key.endswith("_deg")}
    print(f"\n{name}: means over {len(data.recordings)} demonstrations, each reproduced by models of the others")
    header = ["method", *(title for title, _ in columns.values()), "best", "chosen"]
    print(
        format_table(
            header,
            [
                [row["method"], *(f"{row[key]:.{digits}f}" for key, (_, digits) in columns.items())]
                + [row["best_candidate"], row["chosen"]]
                for row in means
            ],
        )
    )


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the program; returns its exit status."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument(
        "--data", type=Path, default=Path("../shared/data"), help="the data sets (default: %(default)s)"
    )
    parser.add_argument("--output", type=Path, default=Path("out/results/retrieval"), help="of report.json")
    options = parser.parse_args(arguments)
    report: dict[str, Any] = {}
    for name, data in data_sets(options.data):
        rows = list(measure(data))
        means = summary(rows)
        show(name, data, means)
        report[name] = {"passed": frames_help(means), "means": means, "rows": rows}
    if not report:
        print("retrieval_table: skipped, there is no data set")
        return 0
    passed = all(item["passed"] for item in report.values())
    print(f"report: {write_report(options.output, {'passed': passed, **report})}")
    return 0 if passed else 1


def frames_help(means: Sequence[Mapping[str, Any]]) -> bool:
    """Whether the best method is nearer to what was shown, at the same shares, than the model without frames."""
    found = {row["method"]: row["position_rmse_by_share_m"] for row in means}
    return bool(min(found[name] for name in METHODS) < found[WITHOUT_FRAMES])


if __name__ == "__main__":
    sys.exit(main())
