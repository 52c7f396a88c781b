# SPDX-License-Identifier: Apache-2.0
"""How new the situation is to the model while it runs: judged in the background, where the frames have moved."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from concurrent.futures import Future
from dataclasses import dataclass

import numpy as np

from tpgmm_core.common.text import one_line
from tpgmm_core.common.types import Array
from tpgmm_core.geometry.pose import pose_error
from tpgmm_ros.runtime.background import Background
from tpgmm_workbench.project.preview import NEW
from tpgmm_workbench.project.project import Project
from tpgmm_workbench.project.situations import Newness, how_new
from tpgmm_workbench.session.view import GraphView

#: It is judged anew at most this often, s, and only where a frame has moved by so much, m and rad.
PERIOD, MOVED_M, MOVED_RAD = 0.5, 0.005, 0.05


@dataclass(frozen=True, slots=True)
class NoveltyView:
    """How new the situation is.

    Parameters
    ----------
    score
        1: as new as the newest of the demonstrations was to a model of the others; None where that is not known
    words
        what that means, or why it is not known
    limit
        of the score: above it, no movement would begin
    """

    score: float | None
    words: str
    limit: float = NEW


class RunNovelty:
    """Judges the situation of a movement.

    Parameters
    ----------
    project
        whose present model runs
    background
        judges

    Attributes
    ----------
    view
        the last answer; None while nothing runs
    """

    def __init__(self, project: Project, background: Background) -> None:
        self.view: NoveltyView | None = None
        self._project, self._background = project, background
        self._known: tuple[int, Newness, int] | None = None  # the model's number, and by how many it was judged
        self._hand: Array | None = None  # where it was as the movement began
        self._judged: dict[str, Array] | None = None
        self._due, self._is_judging = 0.0, False

    def watch(self, runs: int | None, graph: GraphView) -> None:
        """Take in one moment.

        Parameters
        ----------
        runs
            number of the model that runs; None: nothing runs
        graph
            where frames and hand are
        """
        if runs is None:
            self.view = self._judged = self._hand = None
            return
        now = time.monotonic()
        if self._is_judging or now < self._due or graph.hand is None:
            return
        frames = {frame.name: np.array(frame.pose) for frame in graph.frames if frame.pose is not None}
        self._hand = np.array(graph.hand) if self._hand is None else self._hand
        if self._judged is not None and not has_moved(self._judged, frames):
            return
        self._due, self._is_judging, self._judged = now + PERIOD, True, frames
        self._background.run(self._work(runs, frames, self._hand), self._take)

    def _work(self, number: int, frames: Mapping[str, Array], hand: Array) -> Callable[[], NoveltyView]:
        def work() -> NoveltyView:
            if self._known is None or self._known[0] != number:
                newness = Newness.of(self._project, ())
                judged_by = 0 if newness.scale is None else len(newness.scale.distances)
                self._known = number, newness, judged_by
            _, newness, judged_by = self._known
            score = newness.of_situation(frames, hand)
            if score is None:
                return NoveltyView(None, "not known: train with three demonstrations")
            return NoveltyView(score, how_new(score, judged_by))

        return work

    def _take(self, job: Future[NoveltyView]) -> None:
        self._is_judging = False
        if self._judged is None:  # the movement is over
            return
        try:
            self.view = job.result()
        except (OSError, ValueError) as error:
            self.view = NoveltyView(None, f"not known: {one_line(error, 200)}")


def has_moved(before: Mapping[str, Array], now: Mapping[str, Array]) -> bool:
    """Whether frames (7,) by name came, went, or moved by MOVED_M or MOVED_RAD."""
    if before.keys() != now.keys():
        return True
    apart = (pose_error(before[name], pose) for name, pose in now.items())
    return any(way > MOVED_M or turn > MOVED_RAD for way, turn in apart)
