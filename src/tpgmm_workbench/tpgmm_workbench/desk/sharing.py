# SPDX-License-Identifier: Apache-2.0
"""Projects as files: the present one for whoever asks, and others' into folders beside it."""

from __future__ import annotations

import re
from collections.abc import Callable
from concurrent.futures import Future
from pathlib import Path, PurePath
from tempfile import TemporaryDirectory

from tpgmm_core.common.text import one_line
from tpgmm_ros.runtime.background import Background
from tpgmm_workbench.project.activities import Action
from tpgmm_workbench.project.project import Project
from tpgmm_workbench.project.share import export, import_archive

#: Letters of the name of an imported project's folder.
LONGEST_NAME = 60

type Deliver = Callable[[str, bytes], object]
"""Gives a file to whoever asked: its name, and what it holds."""


class Sharing:
    """Exports and imports, in the background.

    Parameters
    ----------
    project
        the present one; those of others come into folders beside its folder
    background
        packs and unpacks
    refused
        whether something may not be done now; it tells the user why
    say
        gets what came of it, in words

    Attributes
    ----------
    words
        what came of the last one
    """

    def __init__(
        self,
        project: Project,
        background: Background,
        refused: Callable[[Action], bool],
        say: Callable[[str], object],
    ) -> None:
        self.words = ""
        self._project, self._background, self._refused, self._say = project, background, refused, say

    def give(self, deliver: Deliver) -> None:
        """Pack the project; `deliver` gets the file, in the background's thread."""
        if self._refused(Action.EXPORT):
            return
        name = f"{self._project.folder.name}.zip"

        def work() -> str:
            with TemporaryDirectory() as place:
                content = export(self._project, Path(place) / name).read_bytes()
            deliver(name, content)
            return f"exported as {name}: {_held(self._project)}, {1e-6 * len(content):.1f} MB"

        self.words = "packing the project…"
        self._background.run(work, lambda job: self._tell(job, "not exported"))

    def take(self, name: str, content: bytes) -> None:
        """Unpack a project that anybody may have written into a new folder, where it is sound.

        Parameters
        ----------
        name
            of its file; the folder is called after it
        content
            of the file
        """
        if self._refused(Action.IMPORT):
            return

        def work() -> str:
            folder = _free_folder(self._project.folder.parent, name)
            with TemporaryDirectory() as place:
                archive = Path(place) / "archive.zip"
                archive.write_bytes(content)
                found = import_archive(archive, folder)
            return (
                f"imported into the folder {one_line(found.folder.name)}, beside this project's: {_held(found)}; "
                "start the workbench with that folder to work with it"
            )

        self.words = f"looking at {one_line(name, LONGEST_NAME)}…"
        self._background.run(work, lambda job: self._tell(job, f"{one_line(name, LONGEST_NAME)} is not imported"))

    def _tell(self, job: Future[str], failed: str) -> None:
        try:
            self.words = job.result()
        except (OSError, ValueError) as error:
            self.words = f"{failed}: {one_line(error)}"
        self._say(self.words)


def _held(project: Project) -> str:
    counts = {"demonstration": len(project.demonstrations()), "model": len(project.models())}
    return ", ".join(f"{count} {what}{'' if count == 1 else 's'}" for what, count in counts.items())


def _free_folder(parent: Path, name: str) -> Path:
    """A folder that is not there yet, called after a file of anybody's: only letters that are plain in any path."""
    plain = re.sub(r"[^A-Za-z0-9]+", "_", PurePath(name).stem)[:LONGEST_NAME].strip("_") or "imported"
    number = 1
    while (folder := parent / (plain if number == 1 else f"{plain}_{number}")).exists():
        number += 1
    return folder
