# SPDX-License-Identifier: Apache-2.0
"""Pictures of the scene: a browser draws one, the project keeps it, and whoever asked gets it."""

from __future__ import annotations

import io
from collections.abc import Callable
from concurrent.futures import Future
from pathlib import Path

import numpy as np
from matplotlib.image import imsave
from numpy.typing import NDArray

from tpgmm_core.common.atomic_file import write_atomically
from tpgmm_core.common.text import one_line
from tpgmm_ros.runtime.background import Background
from tpgmm_workbench.desk.sharing import Deliver
from tpgmm_workbench.project.folder import free_number, named
from tpgmm_workbench.project.project import Project

FOLDER = "pictures"
"""Of a project; an export leaves it out."""


class Pictures:
    """Takes pictures, one after the other, in the background.

    Parameters
    ----------
    project
        in whose folder they are kept
    background
        waits for browsers: it has nothing else to do
    say
        gets what came of it, in words

    Attributes
    ----------
    words
        what came of the last one
    """

    def __init__(self, project: Project, background: Background, say: Callable[[str], object]) -> None:
        self.words = ""
        self._project, self._background, self._say = project, background, say
        self._is_waiting = False

    def take(self, draw: Callable[[], NDArray[np.uint8]], deliver: Deliver) -> None:
        """Take a picture.

        Parameters
        ----------
        draw
            waits for a browser: (H, W, 3); raises OSError or RuntimeError where there is no answer
        deliver
            gets the file, in the background's thread
        """
        if self._is_waiting:
            self._say("a picture is being taken: wait for it")
            return

        def work() -> str:
            image = draw()
            content = io.BytesIO()
            imsave(content, image, format="png")
            path = _keep(self._project.folder / FOLDER, content.getvalue())
            deliver(path.name, content.getvalue())
            height, width = image.shape[:2]
            return f"{FOLDER}/{path.name} in the project's folder: {width} x {height} pixels"

        self._is_waiting, self.words = True, "waiting for the browser to draw a picture…"
        self._background.run(work, self._taken)

    def _taken(self, job: Future[str]) -> None:
        self._is_waiting = False
        try:
            self.words = job.result()
        except (OSError, RuntimeError, ValueError) as error:
            self.words = f"no picture: {one_line(error, 200)}"
        self._say(self.words)


def _keep(folder: Path, content: bytes) -> Path:
    folder.mkdir(exist_ok=True)
    path = folder / f"{named(free_number(folder))}.png"
    write_atomically(path, lambda draft: draft.write_bytes(content))
    return path
