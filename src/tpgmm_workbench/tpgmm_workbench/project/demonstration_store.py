# SPDX-License-Identifier: Apache-2.0
"""`DemonstrationStore`: the demonstrations of a project's folder, what is noted of them, and how they come there."""

from __future__ import annotations

import shutil
import threading
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

from tpgmm_core.common.text import one_line
from tpgmm_ros.recordings.bags import BagError, read_recording
from tpgmm_ros.recordings.recording import Recording
from tpgmm_ros.recordings.storage.metadata import NAME as METADATA
from tpgmm_ros.task.task_file import Task
from tpgmm_workbench.project import folder as files
from tpgmm_workbench.project.errors import ProjectError
from tpgmm_workbench.project.notes import Correction, Notes, read_notes, write_notes
from tpgmm_workbench.project.taught import NOTES, TaughtDemonstration, trimmed


class DemonstrationStore:
    """What was taught, in a folder. Its methods may be called from several threads.

    Parameters
    ----------
    folder
        of the project
    task
        what the bags are of
    """

    def __init__(self, folder: Path, task: Task) -> None:
        self.folder, self.task = folder, task
        self._lock = threading.RLock()
        self._read: dict[int, Recording | str] = {}

    def new_demonstration(self) -> Path:
        """Where the next bag goes: the path for a `BagRecorder`. What was begun there before stays where it is."""
        folder = self.folder / files.DEMONSTRATIONS
        with self._lock:
            folder.mkdir(exist_ok=True)
            return folder / files.named(files.free_number(folder))

    def recorded(self, path: Path, comment: str = "") -> TaughtDemonstration:
        """Take note of a bag that was recorded at the place that `new_demonstration` gave.

        When this returns, the demonstration survives the end of the machine.

        Parameters
        ----------
        path
            of the bag
        comment
            of the user

        Returns
        -------
        TaughtDemonstration
            with its problem in words where the bag cannot be used

        Raises
        ------
        ProjectError
            for another place
        """
        with self._lock:
            found = files.numbered(self.folder / files.DEMONSTRATIONS)
            number = next((n for n, place in found.items() if place == Path(path)), None)
            if number is None:
                raise ProjectError(
                    f"{one_line(path)} is not a demonstration of {self.folder.name}: record it there first"
                )
            files.sync_tree(Path(path))
            files.sync(Path(path).parent)
            if comment:
                self.note(number, comment=comment)
            return self.demonstration(number)

    def add(
        self, write: Callable[[Path], object], comment: str = "", correction: Correction | None = None
    ) -> TaughtDemonstration:
        """Add a demonstration that is not recorded in place.

        Parameters
        ----------
        write
            makes a bag at the path that it is given, which does not exist
        comment
            of the user
        correction
            what it corrects; None for an ordinary one

        Returns
        -------
        TaughtDemonstration
            with its problem in words where the bag cannot be used
        """
        with self._lock:
            path = self.new_demonstration()
            draft = path.parent / files.PARTIAL / path.name
            draft.parent.mkdir(exist_ok=True)
            write(draft)
            write_notes(draft / NOTES, Notes(comment=comment, correction=correction))
            files.place(draft, path)
            return self.demonstration(int(path.name))

    def add_bag(self, bag: str | Path, comment: str = "") -> TaughtDemonstration:
        """Add a copy of a bag that lies elsewhere.

        Parameters
        ----------
        bag
            a folder with metadata.yaml
        comment
            of the user

        Returns
        -------
        TaughtDemonstration
            as of `add`

        Raises
        ------
        ProjectError
            for what is no such folder
        """
        if not (Path(bag) / METADATA).is_file():
            raise ProjectError(f"{one_line(bag)} is not a bag: expected a folder with {METADATA}")
        return self.add(lambda draft: shutil.copytree(bag, draft), comment)

    def demonstrations(self) -> tuple[TaughtDemonstration, ...]:
        """All of them in the order of teaching, those too that were undone or cannot be read."""
        with self._lock:
            return tuple(self.demonstration(n) for n in files.numbered(self.folder / files.DEMONSTRATIONS))

    def used(self) -> tuple[TaughtDemonstration, ...]:
        """Those that models learn from, corrections too."""
        return tuple(shown for shown in self.demonstrations() if shown.is_used)

    def shown(self) -> tuple[TaughtDemonstration, ...]:
        """Those of them that are no corrections: so many a model is learned from."""
        return tuple(one for one in self.used() if one.notes.correction is None)

    def demonstration(self, number: int) -> TaughtDemonstration:
        """The demonstration of a number.

        Parameters
        ----------
        number
            from 1

        Returns
        -------
        TaughtDemonstration
            with its problem in words where the bag cannot be used

        Raises
        ------
        ProjectError
            where there is none
        """
        with self._lock:
            path = self.folder / files.DEMONSTRATIONS / files.named(number)
            if not path.is_dir():
                raise ProjectError(f"there is no demonstration {number}")
            if number not in self._read:
                try:
                    self._read[number] = read_recording(path, self.task)
                except BagError as error:
                    self._read[number] = one_line(error)
            found = self._read[number]
            problem = found if isinstance(found, str) else ""
            notes = Notes()
            try:
                notes = read_notes(path / NOTES, Notes) if (path / NOTES).exists() else notes
            except ProjectError as error:
                problem = problem or str(error)
            whole = None if problem or isinstance(found, str) else found
            return TaughtDemonstration(number, path, notes, whole, problem)

    def note(
        self,
        number: int,
        *,
        comment: str | None = None,
        trim: tuple[float, float] | None | str = "as it is",
        is_used: bool | None = None,
    ) -> TaughtDemonstration:
        """Change what is noted of a demonstration; what is not given stays.

        Parameters
        ----------
        number
            of the demonstration
        comment
            a new one
        trim
            begin and end in s from the first sample; None: all of it
        is_used
            whether models learn from it

        Returns
        -------
        TaughtDemonstration
            as it is now

        Raises
        ------
        ProjectError
            for a trim that leaves too little
        """
        with self._lock:
            shown = self.demonstration(number)
            notes = shown.notes
            if comment is not None:
                notes = replace(notes, comment=comment)
            if not isinstance(trim, str):
                if trim is not None:
                    trim = (float(trim[0]), float(trim[1]))
                    if shown.whole is not None:
                        trimmed(shown.whole, *trim)  # raises
                notes = replace(notes, trim=trim)
            if is_used is not None:
                notes = replace(notes, is_used=is_used)
            self._write(number, notes)
            return replace(shown, notes=notes)

    def _write(self, number: int, notes: Notes) -> None:
        write_notes(self.folder / files.DEMONSTRATIONS / files.named(number) / NOTES, notes)
