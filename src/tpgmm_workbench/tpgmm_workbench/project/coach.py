# SPDX-License-Identifier: Apache-2.0
"""Corrections: where the arm was led during a run, and how a model follows that at once."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from tpgmm_core.common.types import Array
from tpgmm_workbench.project.project import Project, TrainedModel


@dataclass(frozen=True, slots=True, eq=False)
class Run:
    """What the hand did while a model ran, and where the frames were.

    Parameters
    ----------
    times
        (T,) s, increasing
    hand
        (T, 7) poses in the base frame
    frames
        name -> (7,) or (T, 7) poses in the base frame, of all observed frames
    phases
        (T,) shares of the movement, 0 to 1, as the feedback of the action tells; None: in proportion to the time
    is_led
        (T,) where the arm was led; None: found from where the hand left the reference
    """

    times: Array
    hand: Array
    frames: Mapping[str, Array]
    phases: Array | None = None
    is_led: Array | None = None


def correct(project: Project, run: Run, comment: str = "") -> TrainedModel:
    """Make a demonstration of a correction, and a model that follows it; both are kept, and `Project.undo` undoes both.

    It takes less than 5 s, so call it from a thread.

    Parameters
    ----------
    project
        whose present model ran
    run
        what happened
    comment
        of the user

    Returns
    -------
    TrainedModel
        the new one, which is the present one from now on

    Raises
    ------
    ProjectError
        where there is no model, or the hand was nowhere else than the model wanted it
    """
    raise NotImplementedError
