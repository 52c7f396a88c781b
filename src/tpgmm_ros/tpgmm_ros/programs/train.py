# SPDX-License-Identifier: Apache-2.0
"""`train`: recorded demonstrations in, a model file and its figures out. Needs no running ROS."""

import argparse
import contextlib
import math
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import asdict, dataclass
from functools import partial
from typing import Any

import numpy as np

from tpgmm_core import LearnedMixture
from tpgmm_core.common.report import format_table
from tpgmm_core.common.text import listed, one_line
from tpgmm_core.geometry.manifold import Manifold
from tpgmm_core.learning.estimation.iteration import EmProgress
from tpgmm_core.learning.periodic import PeriodicTPGMM
from tpgmm_core.learning.situations import demonstrated_situations
from tpgmm_core.learning.time_steps import TimeStepTPGMM
from tpgmm_core.retrieval.interface import demonstrated_duration
from tpgmm_core.retrieval.methods import KEY
from tpgmm_core.retrieval.recipe import Recipe
from tpgmm_ros.models.training_record import keep_bases, keep_errors, keep_recordings
from tpgmm_ros.models.validation import Fold
from tpgmm_ros.programs.leave_one_out import validate
from tpgmm_ros.programs.reading import TrainingError, progress_bar, read_bags
from tpgmm_ros.programs.reporting import MODEL, refuse_foreign, write_report
from tpgmm_ros.programs.train_auto import choose_for, words
from tpgmm_ros.programs.train_bases import with_bases
from tpgmm_ros.programs.train_options import page_of, parser_of_train
from tpgmm_ros.programs.train_update import load_online, online, said_twice, update
from tpgmm_ros.programs.training_page import write_page
from tpgmm_ros.recordings.bags import Recording, align
from tpgmm_ros.recordings.one_by_one import OneByOne, Parts
from tpgmm_ros.runtime.entry import INTERRUPTED
from tpgmm_ros.task.task_file import Task

type Learn = Callable[[Manifold, Sequence[str] | None, EmProgress], LearnedMixture]
"""Takes what `Recipe.learn` takes after the demonstrations."""


@dataclass(frozen=True, slots=True)
class TrainingResult:
    """A fitted model, and what it was fitted to."""

    model: LearnedMixture
    method: str
    recordings: list[Recording]
    duration_s: float
    time_s: float


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the program; returns its exit status."""
    parser = parser_of_train()
    options = parser.parse_args(arguments)
    if options.output is None and not options.leave_one_out:
        parser.error("nothing to do: give --output to save a model, --leave-one-out to measure one, or both")
    report: dict[str, Any] = {"passed": False}
    learned: list[TrainingResult] = []
    folds: list[Fold] = []
    status = 1
    page = page_of(parser, options)
    try:
        _run(options, report, learned, folds)
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
            if page is not None:
                command = sys.argv[1:] if arguments is None else arguments
                model, recordings = (learned[0].model, learned[0].recordings) if learned else (None, [])
                write_page(page, command, report, model, recordings, folds)
                print(f"report: {options.report}")
            else:
                print(f"report: {write_report(options.report, report)}")
        except OSError as error:
            print(f"error: the report could not be written: {one_line(error)}", file=sys.stderr)
            return 1
    return status


def _run(options: argparse.Namespace, report: dict[str, Any], learned: list[TrainingResult], folds: list[Fold]) -> None:
    if options.output is not None and options.output.is_dir():
        raise TrainingError(f"{options.output} is a directory; give the name of a model file, such as model.tpgmm")
    refuse_foreign(options.output, MODEL, "model file")
    task = Task.load(options.task)
    recipe = _recipe(task, options)
    if options.one_by_one:
        with OneByOne(task) as kept:
            recordings = read_bags(options, task, report, kept)
            learn = partial(recipe.learn_parts, Parts(kept, recordings), jobs=options.jobs)
            training = _train(task, recipe, recordings, learn)
    else:
        recordings = read_bags(options, task, report)
        if options.update is not None:
            training = _update(task, options, recordings, report)
        elif options.auto:
            training = _choose_and_train(task, options, recordings, report)
        else:
            training = _train(task, recipe, recordings, partial(recipe.learn, align(recordings)[0]))
    if not options.auto and options.update is None:
        training.model.metadata_ |= task.derived.metadata()
    if options.bases is not None:
        keep_bases(training.model, options.bases, recipe.arguments["bases"])
    learned.append(training)
    _summarize(training, task, report)
    if options.leave_one_out:
        reproduced, report["leave_one_out"] = validate(task, recipe, recordings, training.model, options.jobs)
        folds += reproduced
    if options.output is not None:
        options.output.parent.mkdir(parents=True, exist_ok=True)
        training.model.save(options.output)
        report["model"] = str(options.output)
        print(f"model: {options.output}")


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
    if options.update is not None:
        fixed = (
            options.auto,
            options.leave_one_out,
            options.online,
            options.components,
            options.retrieval,
            options.bases,
        )
        if any(fixed) or options.seed is not None:
            raise TrainingError(
                "--update goes on with a model as it was learned: leave out --auto, --leave-one-out, --online, "
                "--components, --retrieval, --bases and --seed"
            )
    if options.online and options.auto:
        raise TrainingError("--auto chooses how the model is learned, and --online says it: leave one of them out")
    if options.auto and options.bases is not None:
        raise TrainingError("--auto chooses covariances by itself: leave out --bases")
    recipe = task.space.recipe(settings, options.retrieval)
    if options.bases is not None:
        recipe = with_bases(recipe, task, options.bases)
    if options.one_by_one:
        others = ("auto", "leave_one_out", "online", "update")
        named = [f"--{name.replace('_', '-')}" for name in others if getattr(options, name)]
        if named:
            raise TrainingError(f"--one-by-one learns one model of all recordings: leave out {listed(named)}")
        try:
            recipe.check_parts()
        except ValueError as error:
            raise TrainingError(f"--one-by-one: {one_line(error)}; change the task file, or leave it out") from None
    return online(recipe) if options.online else recipe


def _choose_and_train(
    task: Task, options: argparse.Namespace, recordings: list[Recording], report: dict[str, Any]
) -> TrainingResult:
    choice = choose_for(task, recordings, options.retrieval, options.trials, options.budget, options.workers)
    names = [recording.name for recording in recordings]
    print(f"{words(choice, names)}\n")
    report["auto"] = {"demonstrations": names, **choice.to_dict()}
    training = _train(task, choice.best.trial.recipe, recordings, partial(choice.learn, align(recordings)[0]))
    mean = choice.best.mean()
    keep_errors(training.model, "train --auto", mean.position, mean.end, math.degrees(mean.orientation))
    return training


def _update(
    task: Task, options: argparse.Namespace, recordings: list[Recording], report: dict[str, Any]
) -> TrainingResult:
    model = load_online(options.update, task)
    start = time.perf_counter()
    with _em_progress(model.max_iter) as progress:
        report["update"], twice = update(model, task, recordings, progress)
    if twice:
        print(f"warning: {said_twice(twice)}", file=sys.stderr)
    method = str(model.metadata_[KEY])
    return TrainingResult(model, method, recordings, demonstrated_duration(model), time.perf_counter() - start)


@contextlib.contextmanager
def _em_progress(max_iter: int) -> Iterator[EmProgress]:
    with progress_bar(total=max_iter, desc="EM", unit="iteration") as bar:

        def progress(iteration: int, log_likelihood: float) -> None:
            bar.set_postfix_str(f"log-likelihood {log_likelihood:.4f}", refresh=False)
            bar.update()

        yield progress


def _train(task: Task, recipe: Recipe, recordings: list[Recording], learn: Learn) -> TrainingResult:
    start = time.perf_counter()
    with _em_progress(recipe.max_iter) as progress:
        model = learn(task.space.manifold(), task.space.dimensions(), progress)
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
        "samples": sum(recording.n_samples for recording in recordings),
    }
    keep_recordings(model, [recording.name for recording in recordings])
    duration = float(np.mean([recording.duration for recording in recordings]))
    return TrainingResult(model, recipe.method.name, recordings, duration, elapsed)


def _summarize(training: TrainingResult, task: Task, report: dict[str, Any]) -> None:
    model, durations = training.model, [recording.duration for recording in training.recordings]
    report |= {
        "task": task.name,
        "frames": list(model.frame_names_),
        "retrieval": training.method,
        "demonstrations": len(durations),
        "samples": sum(recording.n_samples for recording in training.recordings),
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
    if isinstance(model, PeriodicTPGMM):
        report |= {"period_s": model.period_, "cycles": model.cycles_}
        print(f"the movement repeats: {model.cycles_} cycles were shown, of {model.period_:.2f} s on average")
    if isinstance(model, TimeStepTPGMM) and model.modes_.any():
        report["modes"] = model.modes_.tolist()
        print(_ways(model, training.recordings))
    if not task.space.joints():
        shown = (recording.to_demonstration(training.duration_s) for recording in training.recordings)
        situations = demonstrated_situations(shown, task.space.manifold())
        report["situations"], report["situations_text"] = asdict(situations), str(situations)
        print(f"situations: {situations}")


def _ways(model: TimeStepTPGMM, recordings: list[Recording]) -> str:
    """Which demonstrations do the same thing in which way."""
    names = [recording.name for recording in recordings]
    groups = [
        listed([n for n, way in zip(names, model.modes_, strict=True) if way == k]) for k in np.unique(model.modes_)
    ]
    lines = [f"  way {k}: {group}" for k, group in enumerate(groups, 1)]
    chosen = (
        f"way {model.mode} alone is learned" if model.mode else "the situation chooses; 'mode: K' takes way K alone"
    )
    return "\n".join([f"demonstrations go {len(lines)} ways, which are kept apart ({chosen}):", *lines])


if __name__ == "__main__":
    sys.exit(main())
