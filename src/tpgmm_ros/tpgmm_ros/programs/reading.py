# SPDX-License-Identifier: Apache-2.0
"""Bags that programs learn from or judge by: read with progress, and refused with all reasons at once."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Callable, Sequence
from dataclasses import asdict
from typing import Any

from tqdm import tqdm

from tpgmm_core.common.text import counted, one_line
from tpgmm_core.doubt.doubts import Doubt, RawDemonstration
from tpgmm_core.doubt.judging import judged_alone
from tpgmm_ros.recordings.bags import Recording, find_bags, join_parts, read_recordings
from tpgmm_ros.recordings.judging import doubts_about
from tpgmm_ros.recordings.one_by_one import OneByOne
from tpgmm_ros.task.task_file import Task


class TrainingError(Exception):
    """Why no model was trained, in words for the user."""


def read_bags(
    options: argparse.Namespace, task: Task, report: dict[str, Any], kept: OneByOne | None = None
) -> list[Recording]:
    """Read bags, and say what is wrong with them, and what makes no sense.

    Parameters
    ----------
    options
        bags, separate, every, verbose, skip_bad, strict
    task
        that they are of
    report
        what was found is written there: bags, bad_bags, doubts
    kept
        where the recordings are kept, of which outlines are returned; None: they all stay in the memory

    Returns
    -------
    list[Recording]
        one or more

    Raises
    ------
    TrainingError
        there is none, or some are bad, or doubts forbid to learn from them.
    BagError
        a path is no bag and holds none.
    """
    found = find_bags(options.bags)
    bags = found if options.separate else join_parts(found, task.movement)
    with progress_bar(total=len(bags), desc="reading bags", unit="bag") as bar:
        keep = {} if kept is None else {"keep": kept.keep}
        good, bad = read_recordings(bags, task, options.every, progress=lambda _: bar.update(), **keep)
    report["bags"] = [
        {"bag": r.place, "samples": r.n_samples, "duration_s": r.duration, "notes": list(r.notes)} for r in good
    ]
    report["bad_bags"] = [{"bag": str(error.path), "error": str(error)} for error in bad]
    for recording in good:
        for note in recording.notes:
            print(one_line(f"{recording.place}: {note}"), file=sys.stderr)
        if options.verbose:
            print(
                f"{recording.place}: {recording.n_samples} samples, {recording.duration:.2f} s",
                file=sys.stderr,
            )
    for error in bad:
        print(f"bad bag: {error}", file=sys.stderr)
    if bad and not options.skip_bad:
        count = len({error.path for error in bad})
        raise TrainingError(
            f"{count} of {counted(len(bags), 'bag')} {'is' if count == 1 else 'are'} bad, nothing was trained; repair "
            "or leave out what is named above, or train on the others with --skip-bad"
        )
    if good:
        good = _without_doubt(good, task, options, report, judged_alone if kept is None else kept.alone)
    if not good:
        raise TrainingError(f"none of {counted(len(bags), 'bag')} could be used")
    return good


def _without_doubt(
    recordings: list[Recording],
    task: Task,
    options: argparse.Namespace,
    report: dict[str, Any],
    alone: Callable[[RawDemonstration], Sequence[Doubt]],
) -> list[Recording]:
    """Say what makes no sense; those recordings with which nothing can be learned are refused, or left out."""
    doubts = doubts_about(recordings, task, alone)
    refusing = [doubt for doubt in doubts if doubt.refuses]
    named = {name for doubt in refusing for name in doubt.about}
    left = [recording for recording in recordings if recording.place not in named]
    if options.skip_bad and named and all(doubt.about for doubt in refusing):
        for doubt in refusing:
            print(f"left out: {doubt}", file=sys.stderr)
        report["bad_bags"] += [{"bag": name, "error": d.text} for d in refusing for name in d.about]
        return _without_doubt(left, task, options, report, alone) if left else []
    report["doubts"] = [asdict(doubt) for doubt in doubts]
    for doubt in doubts:
        print(f"doubt: {doubt}", file=sys.stderr)
    if refusing:
        raise TrainingError(
            f"these bags cannot be learned from together ({counted(len(refusing), 'doubt')} above), nothing was "
            "trained; correct them, or leave out the bags that are named" + (", or use --skip-bad" if named else "")
        )
    if doubts and options.strict:
        raise TrainingError(f"{counted(len(doubts), 'doubt')} above, and --strict refuses all; nothing was trained")
    return recordings


def progress_bar(**settings: Any) -> tqdm[Any]:
    """Progress bar on stderr; silent when that is no terminal."""
    return tqdm(disable=None, file=sys.stderr, leave=True, **settings)
