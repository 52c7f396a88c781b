# SPDX-License-Identifier: Apache-2.0
"""How good a demonstration is, at once after it was recorded: its streams, its doubts, and how it differs."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from tpgmm_workbench.project.project import Project


@dataclass(frozen=True, slots=True)
class StreamQuality:
    """A topic of a demonstration: messages per s, and its longest pause that is out of proportion, s (0: none)."""

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
        how new its situation is to the model, or to the demonstrations before where there is none: 1 is as new as the
        newest so far; None where nothing is known
    level
        "good", "look" (something is to be looked at) or "bad" (nothing can be learned from it)
    words
        the verdict, most important first
    """

    duration_s: float = 0.0
    samples: int = 0
    streams: tuple[StreamQuality, ...] = ()
    missing: Mapping[str, float] | None = None
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
    raise NotImplementedError
