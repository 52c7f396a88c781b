# SPDX-License-Identifier: Apache-2.0
"""`evaluate`: how far off each retrieval method is where it has not learned. Needs no running ROS, saves no model."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Callable, Sequence
from dataclasses import asdict
from typing import Any

import numpy as np

from tpgmm_core import Demonstration, LearnedMixture
from tpgmm_core.choice.calibration import coverage
from tpgmm_core.common.old_names import current_name
from tpgmm_core.common.report import format_table
from tpgmm_core.common.text import listed, one_line, shown
from tpgmm_core.geometry.manifold import POSE
from tpgmm_core.retrieval.methods import ALL_METHODS, DEFAULT, KEY, like
from tpgmm_ros.models.task_model import load_task_model
from tpgmm_ros.models.training_record import learned_from
from tpgmm_ros.models.validation import Tried, mean_errors, tried, tried_by_others
from tpgmm_ros.programs.leave_one_out import cells_of
from tpgmm_ros.programs.reading import TrainingError, progress_bar, read_bags
from tpgmm_ros.programs.reporting import json_text
from tpgmm_ros.programs.train_options import add_jobs, add_reading_options
from tpgmm_ros.recordings.bags import Recording, align
from tpgmm_ros.runtime.entry import a_path
from tpgmm_ros.task.task_file import Task

EXAMPLES = """\
examples:
  evaluate --task config/pick_place.yaml bags/pick_place                      (leave one out, every method)
  evaluate --task config/pick_place.yaml --methods promp dmp bags/pick_place
  evaluate --task config/pick_place.yaml --held-out bags/new -- bags/pick_place
  evaluate --task config/pick_place.yaml --model a.tpgmm --model b.tpgmm bags/new

exit status: 0 everything was evaluated; 1 something could not be evaluated, the reason is printed; 2 wrong arguments
"""
LEVEL = 0.9


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the program; returns its exit status."""
    parser = _parser()
    options = parser.parse_args(arguments)
    if not options.bags:
        greedy = "--held-out" if options.held_out else "--methods" if options.methods else ""
        hint = f": what stands behind {greedy} belongs to it. Write the bags before it, or -- before them"
        parser.error(f"no BAG is given{hint if greedy else ''}")
    report: dict[str, Any] = {"passed": False}
    try:
        _evaluate(options, report)
        report["passed"] = not any("error" in row for row in report["results"])
    except (TrainingError, OSError, ValueError) as error:
        report["error"] = one_line(error)
        print(f"error: {report['error']}", file=sys.stderr)
    if options.json:
        print(json_text(report))
    elif "results" in report:
        print(_table(report))
    return 0 if report["passed"] else 1


def _evaluate(options: argparse.Namespace, report: dict[str, Any]) -> None:
    task = Task.load(options.task)
    if task.space.joints():
        raise TrainingError(f"paths of poses are compared; task {task.name!r} is over joints")
    if options.model and (options.held_out or options.methods):
        raise TrainingError("--model evaluates models as they are: leave out --held-out and --methods")
    recordings = read_bags(options, task, report)
    held_out: list[Recording] = []
    if options.held_out:
        report["held_out"] = {}
        held_out = read_bags(
            argparse.Namespace(**{**vars(options), "bags": options.held_out}), task, report["held_out"]
        )
    report["on"] = "held-out bags" if held_out else "these bags" if options.model else "each bag left out"
    report["results"] = []
    names = list(map(str, options.model or options.methods or like(str(task.model.get(KEY, DEFAULT)))))
    with progress_bar(total=len(names), desc="evaluating", unit="method") as bar:
        for name in names:
            bar.set_postfix_str(name)
            try:
                found = _tried(name, bool(options.model), task, recordings, held_out, options.jobs)
                report["results"].append({"name": name, **_of(found)})
            except (ValueError, np.linalg.LinAlgError) as error:
                report["results"].append({"name": name, "error": one_line(error)})
            bar.update()


def _tried(
    name: str, is_model: bool, task: Task, recordings: list[Recording], held_out: list[Recording], jobs: int
) -> list[Tried]:
    if is_model:
        model = load_task_model(name, task)
        if known := sorted(set(learned_from(model)) & {recording.name for recording in recordings}):
            print(
                f"warning: {name} has learned from recordings with the names {listed(known)}; errors are smaller there "
                "than on what is new",
                file=sys.stderr,
            )
        return [tried(model, recording, float(model.metadata_["duration_s"])) for recording in recordings]
    space, recipe = task.space.manifold(), task.space.recipe(task.model, name)
    learn: Callable[[list[Demonstration]], LearnedMixture] = lambda shown: recipe.learn(shown, space)  # noqa: E731
    if held_out:
        demonstrations, duration = align(recordings)
        model = learn(demonstrations)
        return [tried(model, recording, duration) for recording in held_out]
    return list(tried_by_others(recordings, learn, jobs))


def _of(found: Sequence[Tried]) -> dict[str, Any]:
    distances = [item.squared_distances[np.isfinite(item.squared_distances)] for item in found]
    known = [values for values in distances if len(values)]
    return {
        **asdict(mean_errors([item.errors for item in found])),
        "coverage": coverage(known, POSE.tangent_dim)[LEVEL] if known else None,
        "demonstrations": {item.recording.place: asdict(item.errors) for item in found},
    }


def _table(report: dict[str, Any]) -> str:
    good = sorted((row for row in report["results"] if "error" not in row), key=lambda row: row["position_rmse_m"])
    rows = []
    for row in good:
        covered = "-" if row["coverage"] is None else f"{row['coverage']:.2f}"
        rows.append((row["name"], *cells_of(row), covered, len(row["demonstrations"])))
    header = ("", "RMSE m", "end m", "mean deg", "end deg", f"in {LEVEL:.0%} region", "demonstrations")
    lines = [f"errors on {report['on']}, best first", format_table(header, rows)] if rows else []
    lines += [f"{row['name']} could not be evaluated: {row['error']}" for row in report["results"] if "error" in row]
    return "\n".join(lines)


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="evaluate",
        description="Evaluate retrieval methods, or model files, on demonstrations that they have not learned from.",
        epilog=EXAMPLES,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument(
        "--methods",
        nargs="+",
        type=_method,
        metavar="METHOD",
        help=f"retrieval methods, of {', '.join(ALL_METHODS)} (default: all, but periodic where the task file says so)",
    )
    parser.add_argument(
        "--held-out", nargs="+", type=a_path, metavar="BAG", help="learn from the other bags, evaluate on these"
    )
    parser.add_argument(
        "--model", action="append", type=a_path, metavar="FILE", help="evaluate this model on the bags; may be repeated"
    )
    parser.add_argument("--json", action="store_true", help="print everything as JSON, with each demonstration")
    add_jobs(parser)
    add_reading_options(parser, nargs="*")  # options of several values take what follows them, bags too
    return parser


def _method(text: str) -> str:
    name = current_name(text)
    if name not in ALL_METHODS:
        raise argparse.ArgumentTypeError(
            f"{shown(text)} is no retrieval method; there are {listed(ALL_METHODS)}. Write bags before --methods, "
            "or -- before them"
        )
    return name


if __name__ == "__main__":
    sys.exit(main())
