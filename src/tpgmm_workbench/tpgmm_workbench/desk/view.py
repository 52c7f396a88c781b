# SPDX-License-Identifier: Apache-2.0
"""`DeskView`: all that a page shows of one moment."""

from __future__ import annotations

from dataclasses import dataclass, field

from tpgmm_core.common.types import Array
from tpgmm_workbench.desk.learning import ModelView
from tpgmm_workbench.desk.novelty import NoveltyView
from tpgmm_workbench.desk.teaching import TaughtView
from tpgmm_workbench.graph.movement import RunView
from tpgmm_workbench.project.activities import Action, Activity
from tpgmm_workbench.project.preview import Preview
from tpgmm_workbench.project.suggestion import Suggestion
from tpgmm_workbench.project.training import Progress
from tpgmm_workbench.session.view import GraphView


@dataclass(frozen=True, slots=True)
class DeskView:
    """All that a page shows of one moment.

    Parameters
    ----------
    graph
        what the nodes say
    run
        how far the movement is
    activity
        what is going on
    taught
        the demonstrations that were not undone
    suggested
        where the objects should be for the next one
    lasted
        how long the present recording has been going on, s
    progress
        of a training
    model
        the present one
    preview
        of the present model, where one was made
    novelty
        of the situation while a model runs; None before it is judged
    reasons
        action -> why it may not be done now, or nothing
    words
        what was said last, newest first
    coached
        what goes on of a correction, or came of the last one
    is_paused
        whether the movement stands still, as the user said
    waits
        that the movement waits for an arm that was let go of, or did
    coach_force
        force on the hand from which on a correction begins by itself, N; 0: never
    may_grab
        whether the hand was free since the skill runs, so that taking hold of it is noticed
    shared
        what came of the last export or import
    pictured
        what came of the last picture
    places
        where a simulation's objects are, (7,) by name
    hidden
        those of them that nobody sees
    aim
        (7,) to which the hand is led
    to_go
        how far it still is from there, m; None while nobody leads it
    speed
        of the movement; 1: as learned
    duration
        of the next movement, s; 0: as taught
    """

    graph: GraphView = field(default_factory=GraphView)
    run: RunView = field(default_factory=RunView)
    activity: Activity = Activity.IDLE
    taught: tuple[TaughtView, ...] = ()
    suggested: Suggestion | None = None
    lasted: float = 0.0
    progress: Progress | None = None
    model: ModelView | None = None
    preview: Preview | None = None
    novelty: NoveltyView | None = None
    reasons: dict[Action, str] = field(default_factory=dict)
    words: tuple[str, ...] = ()
    coached: str = ""
    is_paused: bool = False
    waits: str = ""
    coach_force: float = 0.0
    may_grab: bool = False
    shared: str = ""
    pictured: str = ""
    places: dict[str, Array] = field(default_factory=dict)
    hidden: frozenset[str] = frozenset()
    aim: Array | None = None
    to_go: float | None = None
    speed: float = 1.0
    duration: float = 0.0
