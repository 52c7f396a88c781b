# SPDX-License-Identifier: Apache-2.0
"""Doubts about the recordings of a task, those that each bag has and those that show only beside the others."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

from tpgmm_core.doubt.doubts import Doubt, RawDemonstration
from tpgmm_core.doubt.judging import judged, judged_alone
from tpgmm_core.model.derived_frames import HAND
from tpgmm_ros.recordings.recording import Recording
from tpgmm_ros.task.task_file import Task


def doubts_about(
    recordings: Sequence[Recording],
    task: Task,
    alone: Callable[[RawDemonstration], Sequence[Doubt]] = judged_alone,
) -> list[Doubt]:
    """What makes no sense in recordings of a task.

    Parameters
    ----------
    recordings
        one or more
    task
        that they are of
    alone
        see `judged`

    Returns
    -------
    list[Doubt]
        each with the places of the recordings that it is about
    """
    own = [replace(doubt, about=(one.place,)) for one in recordings for doubt in one.doubts]
    return _together([*own, *judged([shown_in(recording, task) for recording in recordings], alone)])


def _together(doubts: Sequence[Doubt]) -> list[Doubt]:
    """Doubts of the same words as one, about all that they are about; those that refuse first."""
    found: dict[tuple[str, str, bool], list[str]] = {}
    for doubt in doubts:
        found.setdefault((doubt.kind, doubt.text, doubt.refuses), []).extend(doubt.about)
    merged = [Doubt(kind, tuple(dict.fromkeys(about)), text, refuses) for (kind, text, refuses), about in found.items()]
    return sorted(merged, key=lambda doubt: not doubt.refuses)


def shown_in(recording: Recording, task: Task) -> RawDemonstration:
    """A recording as doubts are about it: with the frames that were observed."""
    frames = {name: poses for name, poses in recording.frames.items() if task.frames[name].pose is None}
    visible = {name: recording.visible[name] for name in frames}
    from_start = any(source.of == HAND for source in task.derived.sources.values())
    return RawDemonstration(recording.place, recording.times, recording.movement, frames, visible, from_start)
