# SPDX-License-Identifier: Apache-2.0
"""How good a demonstration is, at once after it was recorded: its streams, its doubts, and how it differs."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from tpgmm_core.common.text import listed
from tpgmm_core.doubt.agreement import distances_from_others
from tpgmm_ros.recordings.bags import BagError
from tpgmm_ros.recordings.judging import doubts_about, shown_in
from tpgmm_ros.recordings.overview import BagOverview, overview_of
from tpgmm_workbench.project.errors import ProjectError
from tpgmm_workbench.project.held_out import millimetres, thin
from tpgmm_workbench.project.project import Project
from tpgmm_workbench.project.situations import Newness
from tpgmm_workbench.project.taught import TaughtDemonstration

MISSING = 0.05
"""A frame that is missing for more than this share of the movement is to be looked at."""
NEW = 1.5
"""A situation that is so much newer than the newest so far is said."""


@dataclass(frozen=True, slots=True)
class StreamQuality:
    """A topic of a demonstration: messages per s, and its longest pause that is out of proportion, s (0: none).

    Both are by the recorder's clock: a pause of the recorder is none of the movement. Pauses that matter are doubts.
    """

    topic: str
    rate_hz: float
    gap_s: float


@dataclass(frozen=True, slots=True)
class Quality:
    """What is known of a demonstration as soon as it was recorded.

    Parameters
    ----------
    duration_s
        of what is used
    samples
        of the movement
    streams
        the topics of the bag that hold poses
    missing
        frame -> share of the movement during which it had not been seen, 0 to 1; only frames with more than 0
    outliers
        what was put right or left out while reading, in words: poses that leap, stamps that repeat
    doubts
        what makes no sense, in words, with what to do
    difference_m
        how far the hand is from the others, in the frame that sees it nearest to them, at most; None for the only one
    novelty
        how new its situation is to the model, or to the other demonstrations where there is none: 1 is as new as the
        newest so far; None where nothing is known
    level
        "good", "look" (something is to be looked at) or "bad" (nothing can be learned from it)
    words
        the verdict, most important first
    """

    duration_s: float = 0.0
    samples: int = 0
    streams: tuple[StreamQuality, ...] = ()
    missing: Mapping[str, float] = field(default_factory=dict)
    outliers: tuple[str, ...] = ()
    doubts: tuple[str, ...] = ()
    difference_m: float | None = None
    novelty: float | None = None
    level: str = "good"
    words: tuple[str, ...] = ()


def quality_of(project: Project, number: int) -> Quality:
    """Judge a demonstration beside the others that are used.

    Parameters
    ----------
    project
        that it is of
    number
        of the demonstration

    Returns
    -------
    Quality
        of level "bad" where the bag cannot be read
    """
    shown = project.demonstration(number)
    if shown.whole is None:
        return Quality(level="bad", words=(shown.problem,))
    recording = shown.recording
    others = [one for one in project.shown() if one.number != number]
    missing = {name: float(np.mean(~seen)) for name, seen in recording.visible.items() if not seen.all()}
    doubts = _doubts(project, shown, others)
    streams = _streams(shown, project)
    difference = _difference(project, shown, others)
    novelty = Newness.of(project, others, number).of_situation(shown.situation, recording.movement[0])
    refused = [text for text, refuses in doubts if refuses]
    looked = [
        *(text for text, refuses in doubts if not refuses),
        *(f"{name} was not seen in {share:.0%} of the movement" for name, share in missing.items() if share > MISSING),
    ]
    facts = [f"{recording.duration:.1f} s, {len(recording.times)} samples"]
    if difference is not None:
        facts.append(f"at most {millimetres(difference)} from the others, where a frame sees them alike")
    if novelty is not None:
        how = "newer than all before: it adds much" if novelty > NEW else "as new as others before"
        facts.append(f"its situation is {how}" if novelty > 0.5 else "its situation is like one before: it adds little")
    return Quality(
        duration_s=recording.duration,
        samples=len(recording.times),
        streams=streams,
        missing=missing,
        outliers=recording.notes,
        doubts=tuple(text for text, _ in doubts),
        difference_m=difference,
        novelty=novelty,
        level="bad" if refused else "look" if looked else "good",
        words=(*refused, *looked, *facts),
    )


def _doubts(
    project: Project, shown: TaughtDemonstration, others: Sequence[TaughtDemonstration]
) -> list[tuple[str, bool]]:
    """Those that are about this one, and those about all: text, and whether it forbids to learn."""
    recordings = [one.recording for one in (*others, shown)]
    name = str(recordings[-1].path)
    by_path = {str(one.path): one.number for one in (*others, shown)}
    found = []
    for doubt in doubts_about(recordings, project.task):
        if not doubt.about or name in doubt.about:
            beside = [by_path[path] for path in doubt.about if path != name]
            text = f"{doubt.text} (with demonstration {listed(beside)})" if beside else doubt.text
            found.append((text, doubt.refuses))
    return found


def _streams(shown: TaughtDemonstration, project: Project) -> tuple[StreamQuality, ...]:
    try:
        found: BagOverview = overview_of(shown.path)
    except BagError as error:
        raise ProjectError(str(error)) from error
    wanted = {project.task.movement, *project.task.topics.values()}
    return tuple(
        StreamQuality(topic.name, topic.rate_hz, topic.gap_s)
        for topic in found.topics
        if topic.name.strip("/") in wanted
    )


def _difference(project: Project, shown: TaughtDemonstration, others: Sequence[TaughtDemonstration]) -> float | None:
    if not others:
        return None
    recordings = [shown_in(thin(one.recording), project.task) for one in (*others, shown)]
    return float(distances_from_others(recordings)[0][-1].max())
