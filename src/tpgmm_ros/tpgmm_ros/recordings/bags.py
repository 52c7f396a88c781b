# SPDX-License-Identifier: Apache-2.0
"""Bags to demonstrations: read, cut into takes where they hold several, stretched to one common duration."""

from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from tpgmm_core import Demonstration
from tpgmm_core.common.text import listed
from tpgmm_ros.recordings.bag_messages import BagError
from tpgmm_ros.recordings.cutting import cuts_of
from tpgmm_ros.recordings.edits import SUFFIX, Edits, edits_files
from tpgmm_ros.recordings.finding import find_bags, join_parts
from tpgmm_ros.recordings.recorded_bag import RecordedBag
from tpgmm_ros.recordings.recording import Recording, align
from tpgmm_ros.recordings.storage.bag_reader import parts_of
from tpgmm_ros.task.task_file import Task

__all__ = [
    "BagError",
    "Recording",
    "align",
    "find_bags",
    "join_parts",
    "read_demonstration",
    "read_demonstrations",
    "read_recording",
    "read_recordings",
    "read_takes",
]

MIN_SAMPLES = 10
"""Fewer samples of a movement are no demonstration of one."""


def read_recording(path: str | Path, task: Task, every: int = 1) -> Recording:
    """Read one bag that holds one demonstration; see `read_takes`.

    Parameters
    ----------
    path
        a bag
    task
        names the topics, the frames and the base frame
    every
        keep every n-th sample of the movement, and the last one

    Returns
    -------
    Recording
        the recording

    Raises
    ------
    BagError
        anything that is wrong with the bag, and where it holds several takes.
    """
    takes, bad = read_takes(path, task, every)
    if bad:
        raise bad[0]
    if len(takes) != 1:
        raise BagError(Path(path), f"holds {len(takes)} takes, expected one; leave out the others by its edits")
    return takes[0]


def read_takes(path: str | Path, task: Task, every: int = 1) -> tuple[list[Recording], list[BagError]]:
    """Read the demonstrations that one bag holds: streams of poses, or one PoseArray, as the task says.

    Poses that are none, or that leap, are left out and counted in a note. Of streams, times are the header stamps when
    those of all topics are sane (not zero, never backwards), else the times of the recorder for all topics; a note
    says when, and doubts say what was put right (see `tpgmm_core.doubt.clocks`). Messages that repeat a stamp are
    dropped, and counted in a note. Of a PoseArray, times are the numbers of the poses times `period`, and frames stand
    still. The bag is one demonstration, unless edits beside it cut it (see `edits`), or the task file does (see
    `cutting`); all that is judged is judged after that, the clocks too where those of the whole bag do not hold
    together (see `RecordedBag`). How frames are seen: see `BagStreams`.

    Parameters
    ----------
    path
        a bag
    task
        names the topics, the frames and the base frame
    every
        keep every n-th sample of the movement, and the last one

    Returns
    -------
    tuple[list[Recording], list[BagError]]
        the good ones, in the order of time, and what is wrong with other takes; what is said of the whole bag stands in
        the notes of the first

    Raises
    ------
    BagError
        the bag cannot be read, or no demonstration is found in it.
    """
    path = path if isinstance(path, Path) else Path(path)  # a BagPath stays one
    bag, edits = RecordedBag(path, task), Edits.of(path)
    cuts = cuts_of(bag.streams, task.takes, edits)
    if not cuts:
        raise BagError(path, "all of its takes are left out by its edits: keep one at least, or leave out the bag")
    notes = list(bag.notes)
    others = parts_of(path)[1:]
    if edited := [part.name for part in others if edits_files(part)]:
        raise BagError(
            path,
            f"goes on in {listed(edited)}, which has edits of its own: of a recording in parts, those of its first "
            f"part count, with times from its first sample. Put all into {path.name}{SUFFIX}, or take the parts for "
            "recordings of their own (--separate)",
        )
    if others:
        notes.insert(0, f"goes on in {listed([part.name for part in others])}: parts of one recording, read as one")
    good: list[Recording] = []
    bad: list[BagError] = []
    for cut in cuts:
        try:
            found = bag.recording(cut.begin_s, cut.end_s)
            if len(found.times) < MIN_SAMPLES:
                raise BagError(
                    path,
                    f"the movement has {len(found.times)} samples, expected at least {MIN_SAMPLES}; "
                    + ("leave more of it" if cut.note else "record the whole movement"),
                )
        except BagError as error:
            bad.append(BagError(path, f"{cut.note}: {error.text}") if cut.take else error)
            continue
        said = (*notes, *found.notes, *filter(None, [cut.note]))
        found = replace(found, notes=said, take=cut.take)
        good.append(found if every == 1 else _thinned(found, every))
        notes = []
    return good, bad


def _thinned(recording: Recording, every: int) -> Recording:
    """Every n-th sample, and the last one."""
    last = len(recording.times) - 1
    return recording.at(np.unique(np.append(np.arange(0, last + 1, every), last)))


def read_recordings(
    paths: Sequence[str | Path],
    task: Task,
    every: int = 1,
    progress: Callable[[Path], None] | None = None,
    keep: Callable[[Recording], Recording] = lambda recording: recording,
) -> tuple[list[Recording], list[BagError]]:
    """Read several bags.

    Parameters
    ----------
    paths
        of the bags
    task
        what they are for
    every
        keep every n-th sample of the movement, and the last one
    progress
        called after each bag
    keep
        what stays in the memory of a recording: by default, all

    Returns
    -------
    tuple[list[Recording], list[BagError]]
        the good ones, of a bag with several takes each of these, and what is wrong with the others
    """
    good: list[Recording] = []
    bad: list[BagError] = []
    for given in paths:
        path = given if isinstance(given, Path) else Path(given)  # a BagPath stays one
        try:
            takes, wrong = read_takes(path, task, every)
            good += map(keep, takes)
            bad += wrong
        except BagError as error:
            bad.append(error)
        if progress is not None:
            progress(path)
    return good, bad


def read_demonstration(path: str | Path, task: Task) -> Demonstration:
    """Read one bag as a demonstration with its own duration; see `read_recording`."""
    return read_recording(path, task).to_demonstration()


def read_demonstrations(
    paths: Sequence[str | Path], task: Task, progress: Callable[[Path], None] | None = None
) -> tuple[list[Demonstration], float]:
    """Read bags as demonstrations of one duration. See `read_recording`.

    Parameters
    ----------
    paths
        of the bags
    task
        what they are for
    progress
        called after each bag

    Returns
    -------
    tuple[list[Demonstration], float]
        demonstrations, and their mean duration, s

    Raises
    ------
    BagError
        the first bad bag; the others stand in its notes.
    """
    good, bad = read_recordings(paths, task, progress=progress)
    if bad:
        for other in bad[1:]:
            bad[0].add_note(str(other))
        raise bad[0]
    return align(good)
