# SPDX-License-Identifier: Apache-2.0
"""Demonstrations: recorded into the project, judged in the background, taken back."""

from __future__ import annotations

import time
from collections.abc import Callable
from concurrent.futures import Future
from dataclasses import dataclass
from pathlib import Path

from rclpy.node import Node

from tpgmm_core.common.text import one_line
from tpgmm_ros.runtime.background import Background
from tpgmm_workbench.graph.recording import Recording
from tpgmm_workbench.project.project import Project
from tpgmm_workbench.project.quality import Quality, quality_of
from tpgmm_workbench.project.taught import TaughtDemonstration

#: A shorter recording is a click by mistake and is not kept, s.
SHORTEST = 0.5


@dataclass(frozen=True, slots=True)
class TaughtView:
    """A demonstration as the page lists it.

    Parameters
    ----------
    number
        in the order of teaching
    is_used
        whether a model learns from it
    level
        "good", "look", "bad", or "" as long as it is judged
    words
        what is to be known about it
    """

    number: int
    is_used: bool
    level: str
    words: str


class Teaching:
    """The demonstrations of a project.

    Parameters
    ----------
    node
        records
    project
        where they are kept
    background
        reads and judges them
    say
        gets what went wrong, or is to be known, in words
    changed
        called when there is one more, or one less
    """

    def __init__(
        self,
        node: Node,
        project: Project,
        background: Background,
        say: Callable[[str], object],
        changed: Callable[[], object],
    ) -> None:
        self._node, self._project, self._background = node, project, background
        self._say, self._changed = say, changed
        self._recording: Recording | None = None
        self._began = 0.0
        self._pending = 0
        self._qualities: dict[int, Quality] = {}
        self.shown: tuple[TaughtView, ...] = ()
        self._all: tuple[TaughtDemonstration, ...] = ()
        self.refresh()

    @property
    def is_recording(self) -> bool:
        """Whether a demonstration is being recorded."""
        return self._recording is not None

    @property
    def lasted(self) -> float:
        """For how long it has been recorded, s."""
        return time.monotonic() - self._began if self.is_recording else 0.0

    @property
    def is_keeping(self) -> bool:
        """Whether a demonstration that has ended is still being read."""
        return self._pending > 0

    @property
    def used(self) -> int:
        """Number of demonstrations that a model learns from."""
        return sum(one.is_used for one in self._all)

    @property
    def can_undo(self) -> bool:
        """Whether there is one that was not undone yet."""
        return any(not one.notes.is_undone for one in self._all)

    def begin(self) -> None:
        """Record from now on."""
        try:
            self._recording = Recording(self._node, self._project.new_demonstration(), self._project.task)
        except (OSError, ValueError) as error:
            self._say(f"nothing is recorded: {one_line(error)}")
            return
        self._began = time.monotonic()

    def end(self) -> None:
        """Keep what was recorded; too little is left where unfinished recordings lie."""
        recording, lasted = self._recording, self.lasted
        self._recording = None
        if recording is None:
            return
        if lasted < SHORTEST or not recording.poses:
            recording.leave()
            if recording.poses:
                self._say(f"not kept: {lasted:.1f} s are too short for a demonstration")
            else:
                self._say(
                    f"not kept: nothing came on {self._project.task.movement}, where the hand's poses are to come"
                )
            return
        try:
            recording.keep()
        except (OSError, ValueError) as error:
            self._say(f"the demonstration could not be kept: {one_line(error)}")
            return
        self._pending += 1
        self._background.run(lambda: self._keep(recording.path), self._kept)

    def _keep(self, path: Path) -> TaughtDemonstration:
        return self._project.recorded(path)

    def _kept(self, job: Future[TaughtDemonstration]) -> None:
        self._pending -= 1
        try:
            taught = job.result()
        except (OSError, ValueError) as error:
            self._say(f"the demonstration could not be kept: {one_line(error)}")
            return
        if taught.problem:
            self._say(f"demonstration {taught.number} cannot be used: {taught.problem}")
        self.refresh()
        self._changed()

    def close(self) -> None:
        """Keep what is being recorded: the workbench ends."""
        recording, self._recording = self._recording, None
        if recording is not None:
            try:
                recording.keep()
            except (OSError, ValueError) as error:
                self._say(f"the demonstration could not be kept: {one_line(error)}")

    def undo(self) -> None:
        """Take the last one back."""
        self._background.run(self._project.undo, self._undone)

    def _undone(self, job: Future[str]) -> None:
        try:
            self._say(job.result() or "there is nothing to undo")
        except (OSError, ValueError) as error:
            self._say(f"nothing was undone: {one_line(error)}")
        self.refresh()
        self._changed()

    def refresh(self) -> None:
        """Read all of them again, in the background, and judge those that are not judged yet."""
        self._background.run(self._read, self._take)

    def _read(self) -> tuple[tuple[TaughtDemonstration, ...], dict[int, Quality]]:
        taught = self._project.demonstrations()
        known = self._qualities
        return taught, known | {
            one.number: quality_of(self._project, one.number)
            for one in taught
            if one.number not in known and not one.notes.is_undone
        }

    def _take(self, job: Future[tuple[tuple[TaughtDemonstration, ...], dict[int, Quality]]]) -> None:
        try:
            self._all, self._qualities = job.result()
        except (OSError, ValueError) as error:
            self._say(f"the demonstrations cannot be read: {one_line(error)}")
            return
        self.shown = tuple(self._view(one) for one in self._all if not one.notes.is_undone)
        self._changed()

    def _view(self, one: TaughtDemonstration) -> TaughtView:
        quality = self._qualities.get(one.number)
        if one.problem or quality is None:
            return TaughtView(one.number, one.is_used, "bad" if one.problem else "", one.problem)
        return TaughtView(one.number, one.is_used, quality.level, "; ".join(quality.words))
