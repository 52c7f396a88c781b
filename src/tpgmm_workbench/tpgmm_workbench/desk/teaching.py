# SPDX-License-Identifier: Apache-2.0
"""Demonstrations: recorded into the project, judged in the background, noted about, taken back."""

from __future__ import annotations

import time
from collections.abc import Callable
from concurrent.futures import Future
from dataclasses import dataclass
from pathlib import Path

from rclpy.node import Node

from tpgmm_core.common.text import one_line
from tpgmm_ros.runtime.background import Background
from tpgmm_workbench.graph.demonstration_recorder import DemonstrationRecorder
from tpgmm_workbench.project.notes import MAX_COMMENT
from tpgmm_workbench.project.project import Project
from tpgmm_workbench.project.quality import Quality, quality_of
from tpgmm_workbench.project.suggestion import Suggestion, suggest
from tpgmm_workbench.project.taught import TaughtDemonstration

#: A shorter recording is a click by mistake and is not kept, s.
SHORTEST = 0.5
#: A part that ends so near to the end of the recording is not trimmed there, s: sliders have steps.
END_STEP = 0.1


type _Part = tuple[int, tuple[float, float] | None]
"""What was judged: a demonstration's number, and which part of it."""


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
    comment
        of the user
    length
        of all that was recorded, s; 0 where it cannot be read
    part
        begin and end of what is used of it, s
    corrects
        number of the model that it corrects; 0 for what was shown from the beginning
    """

    number: int
    is_used: bool
    level: str
    words: str
    comment: str = ""
    length: float = 0.0
    part: tuple[float, float] = (0.0, 0.0)
    corrects: int = 0


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
        called when they were read again: there is one more, one less, or another note

    Attributes
    ----------
    shown
        those that were not undone
    suggested
        where the objects should be for the next one; None where nobody asked, or one was shown since
    is_read
        whether it is known what was taught before
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
        self._recording: DemonstrationRecorder | None = None
        self._began = 0.0
        self._pending = 0
        self._qualities: dict[_Part, Quality] = {}
        self.shown: tuple[TaughtView, ...] = ()
        self.suggested: Suggestion | None = None
        self.is_read = False
        self._all: tuple[TaughtDemonstration, ...] = ()

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
        """Number of demonstrations that a model learns from; corrections are none."""
        return sum(one.is_used and one.notes.correction is None for one in self._all)

    @property
    def can_undo(self) -> bool:
        """Whether there is one that was not undone yet."""
        return any(not one.notes.is_undone for one in self._all)

    @property
    def can_redo(self) -> bool:
        """Whether there is one that was undone."""
        return any(one.notes.is_undone for one in self._all)

    def begin(self) -> None:
        """Record from now on."""
        try:
            self._recording = DemonstrationRecorder(self._node, self._project.new_demonstration(), self._project.task)
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
                    f"not kept: no message arrived on {self._project.task.movement}, where poses of the hand are "
                    "expected"
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
        self.suggested = None
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
        self._background.run(self._project.undo, self._marked)

    def redo(self) -> None:
        """Bring back the one that was undone last."""
        self._background.run(self._project.redo, self._marked)

    def _marked(self, job: Future[str]) -> None:
        try:
            self._say(job.result() or "nothing was changed")
        except (OSError, ValueError) as error:
            self._say(f"nothing was changed: {one_line(error)}")
        self.refresh()
        self._changed()

    def refresh(self) -> None:
        """Read all of them again, in the background, and judge those that are not judged yet."""
        self._background.run(self._read, self._take)

    def note(self, number: int, comment: str, part: tuple[float, float], is_used: bool) -> None:
        """Note something about a demonstration, in the background.

        Parameters
        ----------
        number
            of the demonstration
        comment
            of the user
        part
            begin and end of what is used of it, s; all of it where it is as long
        is_used
            whether models learn from it
        """

        def work() -> TaughtDemonstration:
            one = self._project.demonstration(number)
            whole = one.whole is None or (part[0] <= 0.0 and part[1] >= one.whole.duration - END_STEP)
            text = one_line(comment, MAX_COMMENT)
            return self._project.note(number, comment=text, trim=None if whole else part, is_used=is_used)

        self._background.run(work, self._noted)

    def _noted(self, job: Future[TaughtDemonstration]) -> None:
        try:
            one = job.result()
        except (OSError, ValueError) as error:
            self._say(f"not noted: {one_line(error)}")
            return
        trim = "all of it" if one.notes.trim is None else "{:.1f} to {:.1f} s".format(*one.notes.trim)
        self._say(f"demonstration {one.number}: {trim if one.is_used else 'left out'}; the next training sees it")
        self.refresh()

    def suggest(self) -> None:
        """Find out where the objects should be for the next demonstration, in the background."""
        self._background.run(lambda: suggest(self._project), self._found)

    def _found(self, job: Future[Suggestion]) -> None:
        try:
            self.suggested = job.result()
            self._say(f"where next: {self.suggested.words}")
        except (OSError, ValueError) as error:
            self._say(f"no suggestion: {one_line(error)}")

    def _read(self) -> tuple[tuple[TaughtDemonstration, ...], dict[_Part, Quality]]:
        taught = self._project.demonstrations()
        known = self._qualities
        return taught, known | {
            _part_of(one): quality_of(self._project, one.number)
            for one in taught
            if _part_of(one) not in known and not one.notes.is_undone
        }

    def _take(self, job: Future[tuple[tuple[TaughtDemonstration, ...], dict[_Part, Quality]]]) -> None:
        self.is_read = True
        try:
            self._all, self._qualities = job.result()
        except (OSError, ValueError) as error:
            self._say(f"the demonstrations cannot be read: {one_line(error)}")
            return
        self.shown = tuple(self._view(one) for one in self._all if not one.notes.is_undone)
        self._changed()

    def _view(self, one: TaughtDemonstration) -> TaughtView:
        quality = self._qualities.get(_part_of(one))
        level, words = "bad" if one.problem else "", one.problem
        if quality is not None and not one.problem:
            level, words = quality.level, "; ".join(quality.words)
        length = 0.0 if one.whole is None else one.whole.duration
        correction = one.notes.correction
        return TaughtView(
            one.number,
            one.is_used,
            level,
            words,
            one.notes.comment,
            length,
            one.notes.trim or (0.0, length),
            0 if correction is None else correction.model,
        )


def _part_of(one: TaughtDemonstration) -> _Part:
    return one.number, one.notes.trim
