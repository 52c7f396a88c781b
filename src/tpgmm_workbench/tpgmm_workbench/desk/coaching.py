# SPDX-License-Identifier: Apache-2.0
"""Corrections: every run is watched; where the user leads the hand in one, a new model follows when it is over."""

from __future__ import annotations

import time
from collections.abc import Callable
from concurrent.futures import Future

import numpy as np

from tpgmm_core.common.text import one_line
from tpgmm_core.common.types import Array
from tpgmm_ros.runtime.background import Background
from tpgmm_workbench.graph.movement import RunView
from tpgmm_workbench.project.coach import Run, correct
from tpgmm_workbench.project.project import Project, TrainedModel
from tpgmm_workbench.session.view import GraphView


class Coaching:
    """Watches movements, and learns from what was corrected in them. Nothing of it moves the robot.

    Parameters
    ----------
    project
        whose present model runs
    background
        learns
    say
        gets what came of it, in words
    changed
        called when there is a correction more, and a model that follows it
    feels
        whether it is known when the arm is led; else that is found from where the hand left its reference

    Attributes
    ----------
    is_on
        whether what the hand does now is a correction
    words
        what goes on, or is waited for
    """

    def __init__(
        self,
        project: Project,
        background: Background,
        say: Callable[[str], object],
        changed: Callable[[], object],
        feels: bool,
    ) -> None:
        self.is_on, self.words = False, ""
        self._project, self._background, self._say, self._changed = project, background, say, changed
        self._feels = feels
        self._is_wanted = False
        self._goes_on = False
        self._forget()

    def _forget(self) -> None:
        self._times: list[float] = []
        self._hand: list[Array] = []
        self._phases: list[float] = []
        self._led: list[bool] = []
        self._frames: list[dict[str, Array]] = []

    def begin(self) -> None:
        """Take what the hand does from now on as a correction."""
        self.is_on = self._is_wanted = True
        self.words = "lead the hand to where it should be, as long as it matters; then let go"

    def end(self) -> None:
        """Take the rest of the movement as it is."""
        self.is_on = False
        self.words = "the correction is learned when the movement is over"

    def watch(self, run: RunView, graph: GraphView, is_led: bool) -> None:
        """Take in one moment; to be called several times per second.

        Parameters
        ----------
        run
            how far the movement is
        graph
            where hand and frames are
        is_led
            whether somebody leads the hand
        """
        if run.goes_on and not self._goes_on:
            self._forget()
            self.is_on, self._is_wanted, self.words = False, False, ""
        if graph.hand is not None and run.stage in ("running", "done") and (run.goes_on or self._goes_on):
            self._take(run.phase, graph, is_led)
        if self._goes_on and not run.goes_on:
            self._over(run)
        self._goes_on = run.goes_on

    def _take(self, phase: float, graph: GraphView, is_led: bool) -> None:
        if graph.hand is None or (self._phases and phase <= self._phases[-1]):
            return  # paused, or on its way back
        known = dict(self._frames[-1]) if self._frames else {}
        known |= {frame.name: frame.pose for frame in graph.frames if frame.pose is not None}
        self._times.append(time.monotonic())
        self._hand.append(np.array(graph.hand))
        self._phases.append(phase)
        self._led.append(self.is_on and is_led)
        self._frames.append(known)

    def _over(self, run: RunView) -> None:
        wanted, self._is_wanted, self.is_on = self._is_wanted, False, False
        if not wanted:
            return
        if run.stage == "stopped":
            self.words = "nothing is corrected: the movement was stopped before its end"
            self._say(self.words)
            return
        names = set.intersection(*map(set, self._frames)) if self._frames else set()
        seen = Run(
            np.array(self._times),
            np.array(self._hand).reshape(-1, 7),
            {name: np.array([known[name] for known in self._frames]) for name in sorted(names)},
            np.array(self._phases),
            np.array(self._led, dtype=bool) if self._feels else None,
        )
        self.words = "the correction is being learned…"
        self._background.run(lambda: correct(self._project, seen), self._learned)

    def _learned(self, job: Future[TrainedModel]) -> None:
        try:
            model = job.result()
            self.words = f"model {model.number}: {'; '.join(model.notes.words)}. Undo takes both back"
        except (OSError, ValueError) as error:
            self.words = f"nothing is corrected: {one_line(error)}"
        self._say(self.words)
        self._changed()
