# SPDX-License-Identifier: Apache-2.0
"""Corrections: every run is watched; where the user leads the hand in one, a new model follows when it is over."""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from concurrent.futures import Future

from tpgmm_core.common.text import one_line
from tpgmm_core.control.yielding import HELD
from tpgmm_core.observation.touch import Touch
from tpgmm_ros.runtime.background import Background
from tpgmm_workbench.graph.movement import RunView
from tpgmm_workbench.project.coach import correct
from tpgmm_workbench.project.errors import ProjectError
from tpgmm_workbench.project.project import Project, TrainedModel
from tpgmm_workbench.session.view import GraphView
from tpgmm_workbench.session.watched_run import WatchedRun


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
    threshold
        force on the hand from which on a correction begins by itself, N; 0: only where it is asked for

    Attributes
    ----------
    is_on
        whether what the hand does now is a correction
    words
        what goes on, or is waited for
    model
        number of the one that runs
    touch
        whether somebody holds the hand, where the robot measures that
    """

    def __init__(
        self,
        project: Project,
        background: Background,
        say: Callable[[str], object],
        changed: Callable[[], object],
        feels: bool,
        threshold: float = 0.0,
    ) -> None:
        self.is_on, self.words, self.model = False, "", 0
        self.touch = Touch(threshold)
        self._is_of_touch = self._was_touched = False
        self._project, self._background, self._say, self._changed = project, background, say, changed
        self._feels = feels
        self._is_wanted = False
        self._goes_on = False
        self._watched = WatchedRun()

    def begin(self) -> None:
        """Take what the hand does from now on as a correction."""
        self.is_on = self._is_wanted = True
        self._is_of_touch = False
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
            self._watched = WatchedRun()
            self.is_on, self._is_wanted, self.words = False, False, ""
            self._was_touched = False
        is_led |= self._feel(run, graph, is_led)
        if run.stage in ("asked", "running") or (run.stage == "done" and self._goes_on):
            self._watched.take(time.monotonic(), run.phase, graph, self.is_on and is_led)
        if self._goes_on and not run.goes_on:
            self._over(run)
        self._goes_on = run.goes_on

    def _feel(self, run: RunView, graph: GraphView, is_led: bool) -> bool:
        """Begin a correction where the hand is taken hold of, and end it where it is let go of; whether it is held."""
        before, force, controller = self.touch.is_held, graph.force, graph.controller
        newtons = None if force is None or run.stage != "running" else force.newtons
        # an arm that yields at once is held with less force from then on than it took
        is_told = controller is not None and controller.reason.startswith(HELD)
        self.touch.take(time.monotonic(), math.inf if is_told and newtons is not None else newtons)
        is_held = self.touch.is_held
        if is_held and not before and not self.is_on:
            self.begin()
            self._is_of_touch = self._was_touched = True
            self.words = (
                f"the hand is held (more than {self.touch.threshold:.0f} N): lead it to where it should be, as long as "
                "it matters; then let go"
            )
            self._say(self.words)
        elif self.is_on and self._is_of_touch and run.goes_on and not (is_held or is_led):
            self.end()
            self._say(f"the hand was let go of: {self.words}")
        return is_held and self.touch.is_felt

    def _over(self, run: RunView) -> None:
        wanted, self._is_wanted, self.is_on = self._is_wanted, False, False
        if not wanted:
            return
        if run.stage == "stopped":
            self.words = "nothing is corrected: the movement was stopped before its end"
            self._say(self.words)
            return
        seen, ran = self._watched.run(self._feels or self._was_touched), self.model

        def work() -> TrainedModel:
            present = self._project.model
            if present is not None and present.number != ran:
                raise ProjectError(f"model {ran} ran, and model {present.number} was trained since: run and correct it")
            return correct(self._project, seen)

        self.words = "the correction is being learned…"
        self._background.run(work, self._learned)

    def _learned(self, job: Future[TrainedModel]) -> None:
        try:
            model = job.result()
            self.words = f"model {model.number}: {'; '.join(model.notes.words)}. Undo takes both back"
        except (OSError, ValueError) as error:
            self.words = f"nothing is corrected: {one_line(error)}"
        self._say(self.words)
        self._changed()
