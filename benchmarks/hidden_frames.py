# SPDX-License-Identifier: Apache-2.0
"""What hidden frames cost: observations hidden in blocks, in the demonstrations and in reproducing, leave-one-out.

Of each observed frame a share of the movement is hidden, in blocks of a tenth. Ways to go on:

- left out: a frame that is not seen says nothing, in EM and in the product (masks)
- stays: it is where it was last seen, and unknown before that: what task files and the frame_tracker do
- imputed: it is where it was last seen, be that in the movement before
- dropped: as many demonstrations fewer as observations are hidden; those that are left were seen as a whole. What is
  reproduced is seen as in "stays"
"""

from __future__ import annotations

import argparse
import os
import sys
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

os.environ.update(OMP_NUM_THREADS="1", OPENBLAS_NUM_THREADS="1")  # before numpy is imported

import numpy as np  # noqa: E402
from numpy.typing import NDArray  # noqa: E402
from tqdm import tqdm  # noqa: E402

from benchmarks.irrelevant_frames import SETS, demonstrations_of  # noqa: E402
from tpgmm_core import Demonstration, Frame  # noqa: E402
from tpgmm_core.choice.reproducing import reproduce  # noqa: E402
from tpgmm_core.common.report import format_table  # noqa: E402
from tpgmm_core.retrieval.methods import METHODS  # noqa: E402
from tpgmm_core.retrieval.recipe import Recipe  # noqa: E402
from tpgmm_ros.programs.reporting import write_report  # noqa: E402
from tpgmm_ros.recordings.bags import find_bags, read_recordings  # noqa: E402
from tpgmm_ros.task.task_file import Task  # noqa: E402

BLOCKS = 10
"""Each movement has so many; each is hidden or not."""
BORNE = 1.05
"""Largest error where frames stay where they were last seen, over that where these are imputed."""

type Masks = dict[str, NDArray[np.bool_]]


def seen_in_blocks(
    demonstration: Demonstration, names: Sequence[str], share: float, rng: np.random.Generator, first: int = 0
) -> Masks:
    """Masks (T,) of what is seen of each frame when a share of its blocks is hidden, none of the `first` ones."""
    T = len(demonstration.times)
    block = np.arange(T) * BLOCKS // T
    hidden = min(round(share * BLOCKS), BLOCKS - 1)
    return {
        name: ~np.isin(block, rng.permutation(np.arange(first, BLOCKS))[:hidden]) & demonstration.is_visible(name)
        for name in names
    }


def left_out(shown: Demonstration, seen: Masks) -> Demonstration:
    """A frame says nothing where it was not seen."""
    return replace(shown, visible={**(shown.visible or {}), **seen})


def stays(shown: Demonstration, seen: Masks) -> Demonstration:
    """A frame is where it was last seen, and says nothing before it was seen at all."""
    last = {name: np.maximum.accumulate(np.where(mask, np.arange(len(mask)), -1)) for name, mask in seen.items()}
    frames = {name: shown.frames[name].at(np.maximum(at, 0)) for name, at in last.items()}
    visible = {name: at >= 0 for name, at in last.items()}
    return replace(shown, frames={**shown.frames, **frames}, visible={**(shown.visible or {}), **visible})


def imputed(shown: Demonstration, seen: Masks, before: Demonstration | None) -> Demonstration:
    """A frame is where it was last seen, at first in the movement before; in the first one where it will be seen."""
    held = stays(shown, seen)
    frames = {}
    for name in seen:
        unknown, frame = ~held.is_visible(name), held.frames[name]
        first = int(np.argmin(unknown))
        other = frame.at(first) if before is None else before.frames[name].at(-1)
        A, b = _over_time(frame, len(unknown))
        A[unknown], b[unknown] = other.A, other.b
        frames[name] = Frame(A, b)
    visible = {name: mask for name, mask in (shown.visible or {}).items() if name not in seen}
    return replace(shown, frames={**shown.frames, **frames}, visible=visible)


def _over_time(frame: Frame, T: int) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """A and b of each of T samples, to be written to."""
    A, b = (frame.A, frame.b) if frame.is_time_varying else (frame.A[None], frame.b[None])
    return np.broadcast_to(A, (T, *A.shape[1:])).copy(), np.broadcast_to(b, (T, *b.shape[1:])).copy()


def _imputed_in_turn(shown: Sequence[Demonstration], seen: Sequence[Masks]) -> list[Demonstration]:
    result: list[Demonstration] = []
    for demonstration, masks in zip(shown, seen, strict=True):
        result.append(imputed(demonstration, masks, result[-1] if result else None))
    return result


def _dropped(shown: Sequence[Demonstration], seen: Sequence[Masks], share: float) -> list[Demonstration]:
    """The first ones of those that are learned from, seen as a whole, and the situation, seen as it was."""
    left = max(1, round((1.0 - share) * (len(shown) - 1)))
    return [*shown[:left], stays(shown[-1], seen[-1])]


WAYS: dict[str, Callable[[Sequence[Demonstration], Sequence[Masks], float], list[Demonstration]]] = {
    "left out": lambda shown, seen, _: [left_out(*item) for item in zip(shown, seen, strict=True)],
    "stays": lambda shown, seen, _: [stays(*item) for item in zip(shown, seen, strict=True)],
    "imputed": lambda shown, seen, _: _imputed_in_turn(shown, seen),
    "dropped": _dropped,
}
"""What is learned from, and at last what is reproduced: of demonstrations, of what was seen of each, of the share."""


def errors(
    shown: Sequence[Demonstration],
    space: str,
    recipe: Recipe,
    observed: Sequence[str],
    share: float,
    seed: int,
    first: int = 0,
) -> dict[str, float]:
    """RMSE of positions of what was left out, m, mean over the demonstrations, by the way to go on.

    Where frames contradict each other so much that there is no product, the hand stays where it began.
    """
    found: dict[str, list[float]] = {way: [] for way in WAYS}
    for i, asked in enumerate(shown):
        rng = np.random.default_rng([seed, i])
        others = [shown[k] for k in rng.permutation(len(shown)) if k != i]
        movements = [*others, asked]
        seen = [seen_in_blocks(movement, observed, share, rng, first) for movement in movements]
        for way, go_on in WAYS.items():
            *training, situation = go_on(movements, seen, share)
            try:
                path = reproduce(recipe.learn(training, space), situation)
            except ValueError:
                path = np.tile(situation.data[:1, 1:], (len(situation.times), 1))
            distances = np.sum((path[:, :3] - asked.data[:, 1:4]) ** 2, axis=1)
            found[way].append(float(np.sqrt(np.mean(distances))))
    return {way: float(np.mean(values)) for way, values in found.items()}


def is_borne(rows: Sequence[Mapping[str, Any]]) -> bool:
    """Whether frames that stay where they were last seen are better than left out, and as good as imputed.

    Parameters
    ----------
    rows
        of one data set, with the errors by way
    """
    hidden = [row for row in rows if row["share"] > 0.0]
    return all(row["stays"] < row["left out"] and row["stays"] <= BORNE * row["imputed"] for row in hidden)


def measure(task: Task, directory: Path, options: argparse.Namespace) -> list[dict[str, Any]]:
    """Errors of one data set, m: a row for each share, that of nothing hidden first; mean over the seeds."""
    recordings, bad = read_recordings(find_bags([directory]), task)
    if bad:
        raise bad[0]
    shown, space = demonstrations_of(recordings)
    recipe, rows = Recipe.of(task.model, options.method), []
    for share in tqdm((0.0, *options.shares), desc=task.name, disable=None, file=sys.stderr):
        of_seeds = [
            errors(shown, space, recipe, list(task.sources), share, seed, options.first)
            for seed in range(options.seeds)
        ]
        means = {way: float(np.mean([found[way] for found in of_seeds])) for way in WAYS}
        rows.append({"data": task.name, "share": share, **means})
    return rows


def draw(rows: Sequence[Mapping[str, Any]], picture: Path) -> None:
    """Error against the share hidden, one panel for each data set."""
    import matplotlib.pyplot as plt

    names = list(dict.fromkeys(row["data"] for row in rows))
    figure, panels = plt.subplots(1, len(names), figsize=(3.6 * len(names), 3.4), layout="constrained", squeeze=False)
    for axes, name in zip(panels[0], names, strict=True):
        own = [row for row in rows if row["data"] == name]
        for way in WAYS:
            axes.plot([100.0 * row["share"] for row in own], [row[way] for row in own], "o-", label=way)
        axes.set(title=name, xlabel="hidden observations, %", ylim=(0.0, None))
    panels[0][0].set_ylabel("RMSE of positions, m")
    panels[0][0].legend()
    picture.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(picture, dpi=110)
    plt.close(figure)


def main(arguments: Sequence[str] | None = None) -> int:
    """Print the table, and write report.json and hidden_frames.png; 1 where hidden frames cost too much."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument(
        "--set", nargs=2, action="append", metavar=("TASK", "BAGS"), help="task file, directory of bags"
    )
    parser.add_argument("--shares", nargs="+", type=float, default=[0.2, 0.4, 0.6], help="hidden (default: .2 .4 .6)")
    parser.add_argument("--method", choices=METHODS, default="adapt_regress", help="of retrieval")
    parser.add_argument("--first", type=int, default=0, metavar="N", help="the first N tenths are always seen (0)")
    parser.add_argument("--seeds", type=int, default=5, help="so many times (default: 5)")
    parser.add_argument("--output", type=Path, default=Path("out/results/hidden_frames"), help="of report and picture")
    options = parser.parse_args(arguments)
    sets = []
    for task_file, directory in options.set or SETS:
        if not Path(directory).is_dir():
            print(f"hidden_frames: {directory} left out, it is no directory")
            continue
        sets.append(measure(Task.load(task_file), Path(directory), options))
    if not sets:
        print("hidden_frames: skipped, there is no data set")
        return 0
    rows = [row for of_set in sets for row in of_set]
    print("\nobservations hidden in blocks, in training and in reproduction; RMSE of positions, m, leave-one-out")
    lines = [(row["data"], f"{row['share']:.0%}", *(f"{row[way]:.4f}" for way in WAYS)) for row in rows]
    print(format_table(("data", "hidden", *WAYS), lines))
    draw(rows, options.output / "hidden_frames.png")
    passed = all(is_borne(of_set) for of_set in sets)
    print(f"report: {write_report(options.output, {'passed': passed, 'rows': rows})}")
    return 0 if passed else 1


if __name__ == "__main__":
    sys.exit(main())
