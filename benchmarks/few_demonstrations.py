# SPDX-License-Identifier: Apache-2.0
"""Errors of the retrieval methods with 1, 2, 3 ... demonstrations, as a table and a picture.

Each demonstration is left out in turn, and reproduced from so many of the others, drawn at random, with the settings of
the task file. `--auto` among the methods chooses frames, method and settings among those, from three on.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from tqdm import tqdm

from tpgmm_core.choice.automatic import choose
from tpgmm_core.choice.reproducing import reproduce
from tpgmm_core.common.report import format_table
from tpgmm_core.retrieval.methods import METHODS
from tpgmm_ros.models.validation import path_errors
from tpgmm_ros.programs.reporting import write_report
from tpgmm_ros.recordings.bags import Recording, align, find_bags, read_recordings
from tpgmm_ros.task.task_file import Task

AUTO = "auto"
"""Stands for `train --auto` among the methods."""
FEWEST = 3
"""Demonstrations that choices can be made among."""


def main() -> int:
    """Print the table, and write report.json and curves.png; 1 when a bag is bad."""
    options = _parser().parse_args()
    task = Task.load(options.task)
    recordings, bad = read_recordings(find_bags([options.bags]), task, options.every)
    if bad:
        print(f"bad bag: {bad[0]}", file=sys.stderr)
        return 1
    counts = [n for n in options.counts if n < len(recordings)]
    left_out = recordings[:: options.stride]
    rows: list[dict[str, Any]] = []
    with tqdm(total=len(options.methods) * len(counts) * len(left_out), disable=None, file=sys.stderr) as bar:
        for method in options.methods:
            for n in counts:
                errors = []
                for i, recording in enumerate(left_out if n >= FEWEST or method != AUTO else ()):
                    others = [other for other in recordings if other is not recording]
                    chosen = np.random.default_rng([options.seed, i]).permutation(len(others))[:n]
                    errors.append(_error(task, options, method, [others[k] for k in chosen], recording))
                    bar.update()
                known = [error for error in errors if error is not None]
                rows.append(
                    {
                        "method": method,
                        "demonstrations": n,
                        "rmse_m": float(np.mean(known)) if known else None,
                        "refused": len(errors) - len(known),
                    }
                )
    table = [(method, *(_cell(row) for row in rows if row["method"] == method)) for method in options.methods]
    print("RMSE of positions at the same share of the time, m, and how many were refused; mean over what was left out")
    print(format_table(("demonstrations", *map(str, counts)), table))
    _plot(rows, counts, options)
    passed = all(more_is_better([row for row in rows if row["method"] == method]) for method in options.methods)
    print(f"report: {write_report(options.output, {'passed': passed, 'rows': rows})}")
    return 0 if passed else 1


def more_is_better(rows: Sequence[Mapping[str, Any]]) -> bool:
    """Whether the error of a method with the most demonstrations is less than with the fewest, and nothing is refused.

    Parameters
    ----------
    rows
        of the method, in the order of the number of demonstrations
    """
    known = [row["rmse_m"] for row in rows if row["rmse_m"] is not None]
    return not rows[-1]["refused"] and (len(known) == 1 or known[-1] < known[0])


def _error(
    task: Task, options: argparse.Namespace, method: str, shown: list[Recording], left_out: Recording
) -> float | None:
    settings = task.model if options.prior is None else {**task.model, "prior_strength": options.prior}
    demonstrations, duration = align(shown)
    space = str(task.space.manifold())
    try:
        if method == AUTO:
            choice = choose(demonstrations, space, settings, task.derived, trials=options.trials, workers=1)
            model = choice.learn(demonstrations, space)
        else:
            model = task.space.recipe(settings, method).learn(demonstrations, space)
        path = reproduce(model, left_out.to_demonstration(duration))
    except ValueError:  # frames that contradict each other so much that there is no product, or a singular covariance
        return None
    return path_errors(path, left_out.movement).position_rmse_m


def _cell(row: dict[str, Any]) -> str:
    refused = f" ({row['refused']} refused)" if row["refused"] else ""
    return "-" if row["rmse_m"] is None else f"{row['rmse_m']:.4f}{refused}"


def _plot(rows: list[dict[str, Any]], counts: list[int], options: argparse.Namespace) -> None:
    import matplotlib.pyplot as plt

    figure, axes = plt.subplots(figsize=(7.0, 4.5), layout="constrained")
    for method in options.methods:
        axes.plot(counts, [row["rmse_m"] for row in rows if row["method"] == method], "o-", label=method)
    axes.set(xlabel="demonstrations", ylabel="RMSE of positions, m", title=options.task.stem, yscale="log")
    axes.legend()
    options.output.mkdir(parents=True, exist_ok=True)
    figure.savefig(options.output / "curves.png", dpi=120)


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(prog="few_demonstrations", description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--task", type=Path, default=Path("config/pick_place.yaml"), help="task file")
    parser.add_argument("--bags", type=Path, default=Path("bags/pick_place"), help="directory of the bags")
    parser.add_argument(
        "--methods", nargs="+", choices=[*METHODS, AUTO], default=["adapt_regress", "trajectory", "time_steps"]
    )
    parser.add_argument("--counts", type=int, nargs="+", metavar="N", default=list(range(1, 9)))
    parser.add_argument("--prior", type=float, metavar="STRENGTH", help="prior_strength in place of the defaults")
    parser.add_argument("--trials", type=int, default=14, metavar="N", help="of auto (default: 14)")
    parser.add_argument("--every", type=int, metavar="N", default=8, help="use every N-th sample (default: 8)")
    parser.add_argument("--stride", type=int, metavar="N", default=1, help="leave out every N-th alone (default: 1)")
    parser.add_argument("--seed", type=int, default=0, help="of the choice of demonstrations")
    parser.add_argument("--output", type=Path, default=Path("out/few_demonstrations"), help="of the report")
    return parser


if __name__ == "__main__":
    sys.exit(main())
