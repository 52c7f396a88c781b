# SPDX-License-Identifier: Apache-2.0
"""`train`: recorded demonstrations in, a model file and its figures out. Needs no running ROS."""

import argparse
import re
import sys
import time
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
from scipy.stats import spearmanr
from tqdm import tqdm

from tpgmm_core import Demonstration, LearnedMixture
from tpgmm_core.choice.baselines import Learner
from tpgmm_core.choice.calibration import Calibration
from tpgmm_core.choice.novelty import range_of
from tpgmm_core.common.old_names import current_name
from tpgmm_core.common.report import format_table
from tpgmm_core.common.text import listed, one_line
from tpgmm_core.geometry.manifold import POSE
from tpgmm_core.learning.situations import demonstrated_situations
from tpgmm_core.learning.time_steps import TimeStepTPGMM
from tpgmm_core.retrieval.calibrated import scale_key
from tpgmm_core.retrieval.methods import METHODS
from tpgmm_core.retrieval.novelty import NoveltyScale
from tpgmm_core.retrieval.recipe import Recipe
from tpgmm_ros.models.validation import Fold, PathErrors, cross_validate, mean_baselines, mean_errors
from tpgmm_ros.programs.reporting import write_report
from tpgmm_ros.programs.train_auto import choose_for, words
from tpgmm_ros.recordings.bags import Recording, align, find_bags, join_parts, read_recordings
from tpgmm_ros.recordings.judging import doubts_about
from tpgmm_ros.runtime.entry import INTERRUPTED
from tpgmm_ros.task.task_file import Task

EXAMPLES = """\
examples:
  train --task config/pick_place.yaml --output pick_place.tpgmm bags/
  train --task config/pick_place.yaml --output pick_place.tpgmm --report out/train demo_1 demo_2 demo_3
  train --task config/pick_place.yaml --leave-one-out bags/          (only measures, saves no model)
  train --task config/pick_place.yaml --output best.tpgmm --auto --budget 60s bags/pick_place
  train --task config/pick_place.yaml --output dmp.tpgmm --retrieval dmp bags/
  train --task config/pick_place.yaml --output few.tpgmm --components 4 --every 5 --skip-bad bags/

exit status: 0 the model was trained and saved; 1 it was not, the reason is on stderr; 2 wrong arguments;
130 interrupted (with --auto, the best so far is saved then, and the status is 0)
"""


type Learn = Callable[..., LearnedMixture]
"""Takes what `Recipe.learn` takes."""


class TrainingError(Exception):
    """Why no model was trained, in words for the user."""


@dataclass(frozen=True, slots=True)
class Training:
    """A fitted model, and what it was fitted to."""

    model: LearnedMixture
    method: str
    recordings: list[Recording]
    duration_s: float
    time_s: float


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the program; returns its exit status."""
    options = _parser().parse_args(arguments)
    if options.output is None and not options.leave_one_out:
        _parser().error("nothing to do: give --output to save a model, --leave-one-out to measure one, or both")
    report: dict[str, Any] = {"passed": False}
    status = 1
    try:
        _run(options, report)
        report["passed"], status = True, 0
    except (TrainingError, OSError, ValueError, np.linalg.LinAlgError) as error:
        report["error"] = one_line(error)
        print(f"error: {report['error']}", file=sys.stderr)
    except KeyboardInterrupt:
        report["error"], status = "interrupted", INTERRUPTED
        print("interrupted, nothing was saved", file=sys.stderr)
    if options.report is not None:
        # Written after a failure too: a report of an earlier success must not stand beside it.
        try:
            print(f"report: {write_report(options.report, report)}")
        except OSError as error:
            print(f"error: the report could not be written: {one_line(error)}", file=sys.stderr)
            return 1
    return status


def _run(options: argparse.Namespace, report: dict[str, Any]) -> None:
    if options.output is not None and options.output.is_dir():
        raise TrainingError(f"{options.output} is a directory; give the name of a model file, such as model.tpgmm")
    task = Task.load(options.task)
    recipe = _recipe(task, options)
    recordings = _read(options, task, report)
    if options.auto:
        training = _choose_and_train(task, options, recordings, report)
    else:
        training = _train(task, recipe, recordings)
    _summarize(training, task, report)
    if options.leave_one_out:
        report["leave_one_out"] = _validate(task, recipe, recordings, training.model)
    if options.output is not None:
        options.output.parent.mkdir(parents=True, exist_ok=True)
        training.model.save(options.output)
        report["model"] = str(options.output)
        print(f"model: {options.output}")


def _read(options: argparse.Namespace, task: Task, report: dict[str, Any]) -> list[Recording]:
    found = find_bags(options.bags)
    bags = found if options.separate else join_parts(found, task.movement)
    with _bar(total=len(bags), desc="reading bags", unit="bag") as bar:
        good, bad = read_recordings(bags, task, options.every, progress=lambda _: bar.update())
    report["bags"] = [
        {"bag": str(r.path), "samples": len(r.times), "duration_s": r.duration, "notes": list(r.notes)} for r in good
    ]
    report["bad_bags"] = [{"bag": str(error.path), "error": str(error)} for error in bad]
    for recording in good:
        for note in recording.notes:
            print(one_line(f"{recording.path}: {note}"), file=sys.stderr)
        if options.verbose:
            print(
                f"{recording.path}: {len(recording.times)} samples, {recording.duration:.2f} s",
                file=sys.stderr,
            )
    for error in bad:
        print(f"bad bag: {error}", file=sys.stderr)
    if bad and not options.skip_bad:
        raise TrainingError(
            f"{len(bad)} of {len(bags)} bags are bad, nothing was trained; repair or leave out the bags "
            "named above, or train on the others with --skip-bad"
        )
    if good:
        good = _without_doubt(good, task, options, report)
    if not good:
        raise TrainingError(f"none of the {len(bags)} bags could be used")
    return good


def _without_doubt(
    recordings: list[Recording], task: Task, options: argparse.Namespace, report: dict[str, Any]
) -> list[Recording]:
    """Say what makes no sense; those recordings with which nothing can be learned are refused, or left out."""
    doubts = doubts_about(recordings, task)
    refusing = [doubt for doubt in doubts if doubt.refuses]
    named = {name for doubt in refusing for name in doubt.about}
    left = [recording for recording in recordings if str(recording.path) not in named]
    if options.skip_bad and named and all(doubt.about for doubt in refusing):
        for doubt in refusing:
            print(f"left out: {doubt}", file=sys.stderr)
        report["bad_bags"] += [{"bag": name, "error": d.text} for d in refusing for name in d.about]
        return _without_doubt(left, task, options, report) if left else []
    report["doubts"] = [asdict(doubt) for doubt in doubts]
    for doubt in doubts:
        print(f"doubt: {doubt}", file=sys.stderr)
    if refusing:
        raise TrainingError(
            f"{len(refusing)} of the doubts above forbid to learn from these bags together, nothing was trained; put "
            "them right, or leave out the bags that are named" + (", or use --skip-bad" if named else "")
        )
    if doubts and options.strict:
        raise TrainingError(f"{len(doubts)} doubts, and --strict refuses all; nothing was trained")
    return recordings


def _recipe(task: Task, options: argparse.Namespace) -> Recipe:
    settings = dict(task.model)
    if options.components is not None:
        settings["n_components"] = options.components
    if options.seed is not None:
        settings["random_state"] = options.seed
    if options.leave_one_out and task.space.joints():
        raise TrainingError(f"--leave-one-out compares paths of poses; task {task.name!r} is over joints: leave it out")
    if options.auto and (options.components is not None or options.leave_one_out):
        what = "--leave-one-out" if options.components is None else "--components"
        raise TrainingError(f"--auto chooses that by itself, by reproducing what was left out: leave out {what}")
    if not options.auto and (options.budget, options.trials, options.workers) != (None, None, None):
        raise TrainingError("--budget, --trials and --workers are for --auto: add it, or leave them out")
    if options.auto and options.budget is None and options.trials is None:
        options.budget = 60.0
    return task.space.recipe(settings, options.retrieval)


def _choose_and_train(
    task: Task, options: argparse.Namespace, recordings: list[Recording], report: dict[str, Any]
) -> Training:
    choice = choose_for(task, recordings, options.retrieval, options.trials, options.budget, options.workers)
    names = [recording.path.name for recording in recordings]
    print(f"{words(choice, names)}\n")
    report["auto"] = {"demonstrations": names, **choice.to_dict()}
    return _train(task, choice.best.trial.recipe, recordings, choice.learn)


def _train(task: Task, recipe: Recipe, recordings: list[Recording], learn: Learn | None = None) -> Training:
    demonstrations, duration = align(recordings)
    start = time.perf_counter()
    with _bar(total=recipe.max_iter, desc="EM", unit="iteration") as bar:

        def progress(iteration: int, log_likelihood: float) -> None:
            bar.set_postfix_str(f"log-likelihood {log_likelihood:.4f}", refresh=False)
            bar.update()

        learned = recipe.learn if learn is None else learn
        model = learned(demonstrations, task.space.manifold(), task.space.dimensions(), progress)
    elapsed = time.perf_counter() - start
    if not np.isfinite(model.log_likelihood_):
        raise TrainingError(
            "the log-likelihood is not finite; raise reg_covar in the task file, or use fewer components"
        )
    model.metadata_ |= {
        "task": task.name,
        "base_frame": task.base_frame,
        "movement": task.movement,
        "endpoint": task.endpoint,
        "demonstrations": len(recordings),
        "samples": sum(len(recording.times) for recording in recordings),
    }
    if learn is None:
        model.metadata_ |= task.derived.metadata()
    return Training(model, recipe.method.name, recordings, duration, elapsed)


def _summarize(training: Training, task: Task, report: dict[str, Any]) -> None:
    model, durations = training.model, [recording.duration for recording in training.recordings]
    report |= {
        "task": task.name,
        "frames": list(model.frame_names_),
        "retrieval": training.method,
        "demonstrations": len(durations),
        "samples": sum(len(recording.times) for recording in training.recordings),
        "duration_s": training.duration_s,
        "duration_min_s": min(durations),
        "duration_max_s": max(durations),
        "components": len(model.priors_),
        "iterations": int(model.n_iter_),
        "converged": bool(model.converged_),
        "log_likelihood": float(model.log_likelihood_),
        "training_time_s": training.time_s,
    }
    hint = "" if report["converged"] else " (not converged: raise max_iter)"
    rows = {
        "task": f"{task.name} (frames: {', '.join(model.frame_names_)})",
        "retrieval": report["retrieval"],
        "demonstrations": report["demonstrations"],
        "samples": report["samples"],
        "duration": f"{training.duration_s:.2f} s (from {min(durations):.2f} to {max(durations):.2f} s)",
        "components": report["components"],
        "iterations": f"{report['iterations']}{hint}",
        "log-likelihood": f"{report['log_likelihood']:.4f} per sample",
        "training time": f"{training.time_s:.2f} s",
    }
    print(format_table(("what", "value"), rows.items()))
    if isinstance(model, TimeStepTPGMM) and model.modes_.any():
        report["modes"] = model.modes_.tolist()
        print(_ways(model, training.recordings))
    if not task.space.joints():
        situations = demonstrated_situations(align(training.recordings)[0], task.space.manifold())
        report["situations"] = asdict(situations)
        print(f"situations: {situations}")


def _ways(model: TimeStepTPGMM, recordings: list[Recording]) -> str:
    """Which demonstrations do the same thing in which way."""
    names = [recording.path.name for recording in recordings]
    groups = [
        listed([n for n, way in zip(names, model.modes_, strict=True) if way == k]) for k in np.unique(model.modes_)
    ]
    lines = [f"  way {k}: {group}" for k, group in enumerate(groups, 1)]
    chosen = (
        f"way {model.mode} alone is learned" if model.mode else "the situation chooses; 'mode: K' takes way K alone"
    )
    return "\n".join([f"demonstrations go {len(lines)} ways, which are kept apart ({chosen}):", *lines])


def _validate(task: Task, recipe: Recipe, recordings: list[Recording], trained: LearnedMixture) -> dict[str, Any]:
    anchor, space = list(task.sources or task.frames)[-1], task.space.manifold()
    folds: list[Fold] = []
    with _bar(total=len(recordings), desc="leave one out", unit="demonstration") as bar:
        learner = Learner.of(space, recipe.arguments)
        for fold in cross_validate(recordings, lambda shown: recipe.learn(shown, space), anchor, learner):
            folds.append(fold)
            bar.update()
    mean = mean_errors([fold.model for fold in folds])
    mean_nearest = mean_errors([fold.nearest for fold in folds])

    columns = ("RMSE m", "end m", "mean deg", "end deg")
    rows = [(fold.recording.path.name, *_cells(fold.model), *_cells(fold.nearest)) for fold in folds]
    rows.append(("mean", *_cells(mean), *_cells(mean_nearest)))
    print(f"\nleave one out: the model, and the nearest demonstration moved with the frame {anchor!r} (n.)")
    print(format_table(("left out", *columns, *(f"n. {column}" for column in columns)), rows))
    baselines = mean_baselines(folds)
    others = [(name, *_cells(errors), count) for name, (errors, count) in baselines.items()]
    print("\nother kinds of models, with as many components; means over those left out that they have an answer for")
    print(format_table(("", *columns, "left out"), [("this model", *_cells(mean), len(folds)), *others]))
    print("\nmean position error in each tenth of the movement, m")
    print(
        format_table(
            ("", *(f"{tenth}0 %" for tenth in range(1, 11))),
            [
                (name, *(f"{value:.3f}" for value in errors.position_by_tenth_m))
                for name, errors in (("model", mean), ("nearest", mean_nearest))
            ],
        )
    )
    calibration = _calibrate(folds, recipe, trained)
    novelty = _novelty(folds, align(recordings)[0], trained)
    return {
        "anchor": anchor,
        "calibration": asdict(calibration),
        "novelty_rank_correlation": novelty,
        "mean": asdict(mean),
        "mean_nearest": asdict(mean_nearest),
        "mean_baselines": {name: asdict(errors) for name, (errors, _) in baselines.items()},
        "folds": [
            {
                "bag": str(fold.recording.path),
                "iterations": fold.iterations,
                **asdict(fold.model),
                "nearest": asdict(fold.nearest),
                "baselines": {name: asdict(errors) for name, errors in fold.baselines.items()},
            }
            for fold in folds
        ],
    }


def _calibrate(folds: list[Fold], recipe: Recipe, trained: LearnedMixture) -> Calibration:
    """Say how exact the references are that the model calls exact, and write the scale that mends it into the model."""
    found = Calibration.of([fold.squared_distances for fold in folds], POSE.tangent_dim)
    trained.metadata_[scale_key(recipe.method.name)] = found.scale
    rows = [
        (f"{level:.0%}", f"{share:.2f}", f"{found.scaled_coverage[level]:.2f}")
        for level, share in found.coverage.items()
    ]
    print("\ncoverage: share of the poses left out that lie in the model's region of so many per cent")
    print(format_table(("region", "as learned", "scaled"), rows))
    print(f"covariances are scaled by {found.scale:.2f}, standard deviations by {found.scale**0.5:.2f}")
    return found


def _novelty(folds: list[Fold], demonstrations: list[Demonstration], trained: LearnedMixture) -> float | None:
    """Write what novelty was for what was left out into the model; returns its rank correlation with the error."""
    against, far = zip(*(fold.novelty for fold in folds), strict=True)
    if not np.isfinite(against).all():
        print("\nnovelty: not judged, since the frames of a demonstration left out contradict each other too much")
        return None
    scale = NoveltyScale(range_of(trained, demonstrations, POSE), against, far)
    trained.metadata_ |= scale.metadata()
    errors = [fold.model.position_rmse_m for fold in folds]
    print(
        f"\nnovelty: in what was left out, frames contradict each other by {min(against):.2g} to {max(against):.2g} "
        f"standard deviations, and are up to {max(far):.2g} from where they were otherwise"
    )
    if min(np.ptp(against), np.ptp(errors)) == 0.0:
        return None
    correlation = float(spearmanr(against, errors)[0])
    print(f"rank correlation of the contradiction with the error: {correlation:.2f}")
    return correlation


def _cells(errors: PathErrors) -> tuple[str, ...]:
    return (
        f"{errors.position_rmse_m:.3f}",
        f"{errors.position_end_m:.3f}",
        f"{errors.orientation_mean_deg:.1f}",
        f"{errors.orientation_end_deg:.1f}",
    )


def _bar(**settings: Any) -> "tqdm[Any]":
    """Progress bar on stderr; silent when that is no terminal."""
    return tqdm(disable=None, file=sys.stderr, leave=True, **settings)


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="train",
        description="Train a task-parameterized Gaussian mixture model from recorded demonstrations.",
        epilog=EXAMPLES,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument(
        "bags",
        metavar="BAG",
        nargs="+",
        type=Path,
        help="rosbag2 (MCAP, sqlite3) or ROS 1 bag, or one of its files, or a directory with several of them",
    )
    parser.add_argument("--task", required=True, type=Path, help="task file: topics, frames and settings of the model")
    parser.add_argument("--output", type=Path, metavar="FILE", help="where the model is saved, such as task.tpgmm")
    parser.add_argument(
        "--components",
        type=_positive,
        metavar="K",
        help="number of Gaussians, instead of n_components of the task file",
    )
    parser.add_argument(
        "--retrieval",
        type=current_name,
        choices=METHODS,
        metavar="METHOD",
        help=f"what the model is for, instead of retrieval of the task file: {', '.join(METHODS)}",
    )
    parser.add_argument("--seed", type=int, help="seed of random choices, instead of random_state of the task file")
    parser.add_argument(
        "--every",
        type=_positive,
        default=1,
        metavar="N",
        help="use every N-th sample of the movement (default: all)",
    )
    parser.add_argument(
        "--leave-one-out",
        action="store_true",
        help="reproduce each demonstration with a model of the others, and print the errors",
    )
    parser.add_argument(
        "--auto",
        action="store_true",
        help="choose frames, method and settings by reproducing demonstrations that were left out; --retrieval, where "
        "given, is not chosen",
    )
    parser.add_argument(
        "--budget", type=_seconds, metavar="TIME", help="for --auto: time to choose, such as 60s (the default) or 5min"
    )
    parser.add_argument("--trials", type=_positive, metavar="N", help="for --auto: try at most N ways of learning")
    parser.add_argument(
        "--workers", type=_positive, metavar="N", help="for --auto: processes (default: one for each core)"
    )
    parser.add_argument("--report", type=Path, metavar="DIR", help="write report.json into this directory")
    parser.add_argument(
        "--separate",
        action="store_true",
        help="bags that go on where another one ends are demonstrations of their own, not parts of one recording",
    )
    parser.add_argument(
        "--strict", action="store_true", help="refuse recordings about which there is any doubt, where it is only said"
    )
    parser.add_argument("--skip-bad", action="store_true", help="train on the good bags when some are bad")
    parser.add_argument("-v", "--verbose", action="store_true", help="say what each bag holds")
    return parser


def _seconds(text: str) -> float:
    found = re.fullmatch(r"(\d+(?:\.\d*)?)(s|min|)", text.strip())
    if found is None or float(found[1]) == 0.0:
        raise argparse.ArgumentTypeError(f"{text} is not a time such as 60s or 5min")
    return float(found[1]) * (60.0 if found[2] == "min" else 1.0)


def _positive(text: str) -> int:
    number = int(text)
    if number < 1:
        raise argparse.ArgumentTypeError(f"{text} is not a whole number of at least 1")
    return number


if __name__ == "__main__":
    sys.exit(main())
