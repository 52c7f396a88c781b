# SPDX-License-Identifier: Apache-2.0
"""Where to demonstrate next: the placing of the frames that is newest to what is known."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from tpgmm_core.common.types import Array
from tpgmm_workbench.project.project import Project


@dataclass(frozen=True, slots=True)
class Region:
    """Where a frame may be put: corners of a box in the base frame, m, and how it may be turned about z, rad."""

    low: tuple[float, float, float]
    high: tuple[float, float, float]
    yaw: tuple[float, float] = (0.0, 0.0)


@dataclass(frozen=True, slots=True)
class Suggestion:
    """A placing of the observed frames.

    Parameters
    ----------
    frames
        name -> pose (7,) in the base frame
    novelty
        1 is as new as the newest so far
    words
        why there
    """

    frames: Mapping[str, Array]
    novelty: float
    words: str


def suggest(project: Project, regions: Mapping[str, Region] | None = None, random_state: int = 0) -> Suggestion:
    """Suggest where the frames should be for the next demonstration.

    Parameters
    ----------
    project
        with one demonstration at least, or with regions for all observed frames
    regions
        where frames may be; those that are not named: where they were seen, a little widened where that is one place
    random_state
        seed of the placings that are compared

    Returns
    -------
    Suggestion
        the newest of them

    Raises
    ------
    ProjectError
        where nothing says where the frames may be
    """
    raise NotImplementedError
