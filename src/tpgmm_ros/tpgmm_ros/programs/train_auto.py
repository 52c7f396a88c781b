# SPDX-License-Identifier: Apache-2.0
"""`train --auto`: frames, method and settings are chosen, and it is said what was tried, what was taken, and why."""

from __future__ import annotations

import math
import os
import sys
from collections.abc import Sequence

from tqdm import tqdm

from tpgmm_core.choice.automatic import MISFIT, Choice, choose
from tpgmm_core.choice.trial import HeldOutError, TrialResult
from tpgmm_core.common.report import format_table
from tpgmm_core.common.text import listed
from tpgmm_core.learning.time_warping import KEY as WARP_KEY
from tpgmm_core.retrieval.methods import ALL_METHODS
from tpgmm_core.retrieval.own_end import KEY as END_KEY
from tpgmm_core.retrieval.segment_frames import KEY as PRUNE_KEY
from tpgmm_ros.recordings.bags import Recording, align
from tpgmm_ros.task.task_file import Task

ENDED = {
    "complete": "everything was tried",
    "trials": "the requested number of trials was reached",
    "time": "the time was up",
    "interrupted": "interrupted: the best so far is used",
}


def choose_for(
    task: Task,
    recordings: Sequence[Recording],
    method: str | None = None,
    trials: int | None = None,
    seconds: float | None = None,
    workers: int | None = None,
) -> Choice:
    """Choose what a model of recordings is learned with; the task file says where to begin.

    Returns
    -------
    Choice
        what was chosen, and all that was tried

    Raises
    ------
    ValueError
        for a task over joints, too few recordings, and where nothing could be learned
    """
    if task.space.joints():
        raise ValueError(f"--auto works only for tasks of poses; task {task.name!r} is over joints: leave --auto out")
    demonstrations, _ = align(recordings)
    settings = dict(task.model) if method is None else {**task.model, "retrieval": method}
    with tqdm(total=trials, desc="trying", unit="trial", disable=None, file=sys.stderr) as bar:

        def progress(result: TrialResult, best: TrialResult) -> None:
            bar.set_postfix_str(f"{best.trial.method}, error {best.cost:.4f} m", refresh=False)
            bar.update()

        return choose(
            demonstrations,
            task.space.manifold(),
            settings,
            task.derived,
            methods=None if method is None else (method,),
            trials=trials,
            seconds=seconds,
            workers=workers or os.cpu_count() or 1,
            progress=progress,
        )


def words(choice: Choice, names: Sequence[str]) -> str:
    """All that was found, in tables; names are those of the demonstrations."""
    parts = [_tried(choice), _frames(choice), _expected(choice, names)]
    return "\n\n".join(part for part in parts if part)


def _tried(choice: Choice) -> str:
    """The task file's row, and the best of each method, of each set of frames with the method that was taken."""
    search, best = choice.search, choice.best
    rows = [("task file", choice.given)] if choice.given is not best else []
    shown: set[object] = {best.trial.key, choice.given.trial.key}
    for result in search.leaders:
        keys = (("method", result.trial.method), ("frames", frozenset(result.trial.frames)))
        if result.trial.key not in shown and not shown.issuperset(keys):
            rows.append(("", result))
        shown.update(keys)
    lost = [method for method in ALL_METHODS if ("method", method) not in shown and _was_tried(choice, method)]
    rows = [("chosen", best), *rows[:12]]
    head = (
        "",
        "method",
        "frames",
        "structure",
        "K",
        "prior",
        PRUNE_KEY,
        END_KEY,
        WARP_KEY,
        "error m",
        "RMSE m",
        "deg",
        "at objects m",
        "end m",
    )
    text = [
        f"{len(search.results)} configurations were tried ({ENDED[search.ended]}); each was tested on demonstrations "
        "that it had not learned from:",
        format_table(head, [(name, *_row(result)) for name, result in rows]),
    ]
    if lost:
        text.append(f"stopped early, since they were worse than others: {listed(lost)}")
    given, cost = choice.given.cost, best.cost
    if best is choice.given:
        text.append("why: no other configuration has a smaller error than the settings of the task file")
    elif math.isfinite(given):
        text.append(
            f"why: its error is the smallest; with the settings of the task file it is {given / cost - 1.0:.0%} larger"
        )
    else:
        text.append(f"why: its error is the smallest; the settings of the task file failed: {_reason(choice.given)}")
    return "\n".join(text)


def _was_tried(choice: Choice, method: str) -> bool:
    return any(result.trial.method == method for result in choice.search.results)


def _reason(result: TrialResult) -> str:
    return result.refusals[0] if result.refusals else "it was stopped early"


def _row(result: TrialResult) -> tuple[object, ...]:
    trial = result.trial
    settings = trial.settings
    prior = f"{settings.get('regularization', 'add')} {settings.get('reg_covar', '')}".strip()
    row = (
        trial.method,
        " ".join(trial.frames),
        settings.get("covariance", "full"),
        settings.get("n_components"),
        prior,
        settings.get(PRUNE_KEY),
        *("yes" if settings.get(key) else "" for key in (END_KEY, WARP_KEY)),
    )
    if not result.is_complete:
        return (*row, *"-" * 5)
    mean = result.mean()
    return (*row, f"{result.cost:.4f}", *_cells(mean))


def _cells(error: HeldOutError) -> tuple[str, ...]:
    return (
        f"{error.position:.3f}",
        f"{math.degrees(error.orientation):.1f}",
        f"{error.objects:.3f}",
        f"{error.end:.3f}",
    )


def _frames(choice: Choice) -> str:
    relevance, shares = choice.relevance(), choice.screen.shares()
    rows = []
    for name in choice.best.trial.frames:
        tenths = relevance[name]
        most = max(range(10), key=tenths.__getitem__)
        source = choice.derived.sources.get(name)
        rows.append(
            (
                name,
                "of the task" if source is None else str(source),
                f"{shares.get(name, 0.0):.0%}",
                f"{10 * most} to {10 * (most + 1)} %",
                *(f"{share:.2f}" for share in tenths),
            )
        )
    head = ("frame", "what it is", "predicts best", "counts most at", *(f"{10 * (t + 1)} %" for t in range(10)))
    dropped = [name for name in choice.declared if name not in choice.best.trial.frames]
    text = [
        f"how much each frame determines the pose of the hand, in each tenth of the "
        f"{'movement' if choice.cycles == 1 else 'cycle'} (shares):",
        format_table(head, rows),
    ]
    if dropped:
        text.append(f"frames of the task that are not used, since others predict as well or better: {listed(dropped)}")
    if choice.still:
        text.append(
            f"hardly moved in these demonstrations: {listed(choice.still)}; so it is unknown whether the movement "
            "depends on this; if it does, record demonstrations with it in different places"
        )
    return "\n".join(text)


def _expected(choice: Choice, names: Sequence[str]) -> str:
    best = choice.best
    mean = best.mean()
    worst = max(best.errors, key=lambda i: best.errors[i].cost)
    rows = [("mean", *_cells(mean)), (f"worst: {names[worst]}", *_cells(best.errors[worst]))]
    text = [
        "expected errors in similar new situations (from demonstrations that were left out; slightly optimistic, "
        "since the best of several configurations was chosen):",
        format_table(("", "RMSE m", "deg", "at objects m", "end m"), rows),
    ]
    for i in choice.misfits:
        text.append(
            f"{names[i]} does not fit the others: its error is {best.errors[i].cost:.3f} m, more than {MISFIT:.0f} "
            "times the median; if it shows something else, leave it out; if its situation is unusual, record more "
            "like it"
        )
    for refusal in best.refusals:
        text.append(f"refused: {refusal}")
    return "\n".join(text)
