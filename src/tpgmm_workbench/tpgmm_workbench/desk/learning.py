# SPDX-License-Identifier: Apache-2.0
"""The skill: learned in a process of its own, previewed in the background, with a verdict before anything moves."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from concurrent.futures import Future
from dataclasses import dataclass

from tpgmm_core.common.text import one_line
from tpgmm_core.common.types import Array
from tpgmm_core.retrieval.relevance import Relevance, relevance
from tpgmm_ros.runtime.background import Background
from tpgmm_workbench.project.errors import ProjectError
from tpgmm_workbench.project.preview import Preview, preview
from tpgmm_workbench.project.project import Project
from tpgmm_workbench.project.self_collision import SelfCollision
from tpgmm_workbench.project.training import Progress, Training, TrainingOptions

#: Parts of a movement for which it is shown how much each frame says.
PARTS = 24


@dataclass(frozen=True, slots=True)
class ModelView:
    """The present model.

    Parameters
    ----------
    number, path
        its own, and its file
    words
        how well it does
    misfits
        number of each demonstration that does not fit the others -> why
    relevance
        how much each frame says in each of PARTS of the movement; None where that depends on the situation
    """

    number: int
    path: str
    words: tuple[str, ...]
    misfits: Mapping[int, str]
    relevance: Relevance | None = None


class Learning:
    """Training and previews of a project.

    Parameters
    ----------
    project
        what is learned from, and where models are kept
    background
        previews
    say
        gets what went wrong, or is to be known, in words

    Attributes
    ----------
    progress
        of the training that goes on, or was the last one; None before
    model
        the present one; None before
    shown
        the last preview; None where what it was of has changed
    is_read
        whether it is known which models there are
    """

    def __init__(self, project: Project, background: Background, say: Callable[[str], object]) -> None:
        self.progress: Progress | None = None
        self.model: ModelView | None = None
        self.shown: Preview | None = None
        self.is_read = False
        self._project, self._background, self._say = project, background, say
        self._training: Training | None = None
        self._is_previewing = False

    @property
    def is_training(self) -> bool:
        """Whether a training goes on."""
        return self._training is not None

    @property
    def is_previewing(self) -> bool:
        """Whether a preview is being made."""
        return self._is_previewing

    def refresh(self) -> None:
        """Find out which model is the present one."""
        self._background.run(self._find, self._take)

    def _find(self) -> ModelView | None:
        found, known = self._project.model, self.model
        if found is None or (known is not None and known.number == found.number):
            return known if found is not None else None
        try:
            shares = relevance(self._project.load(found), PARTS)
        except ProjectError:
            raise
        except ValueError:  # frames that see different spaces: what each says depends on the situation
            shares = None
        return ModelView(found.number, str(found.path), tuple(found.notes.words), found.notes.misfits, shares)

    def _take(self, job: Future[ModelView | None]) -> None:
        self.is_read = True
        try:
            found = job.result()
        except (OSError, ValueError) as error:
            self._say(f"the models cannot be read: {one_line(error)}")
            return
        if found is not self.model:
            self.model, self.shown = found, None

    def train(self, options: TrainingOptions) -> None:
        """Begin to train."""
        try:
            self._training = Training.start(self._project, options)
        except (OSError, ValueError) as error:
            self._say(f"not trained: {one_line(error)}")
            return
        self.progress = self._training.progress()

    def cancel(self) -> None:
        """End the training; nothing is kept of it."""
        if self._training is not None:
            self._training.cancel()

    def look(self) -> None:
        """Take in how far the training is; to be called several times per second."""
        if self._training is None:
            return
        self.progress = self._training.progress()
        if not self.progress.is_over:
            return
        training, self._training = self._training, None
        try:
            trained = training.result()
            self._say(f"model {trained.number}: {'; '.join(trained.notes.words[:1]) or 'trained'}")
        except (OSError, ValueError) as error:
            self._say(f"no model: {one_line(error)}")
        self.refresh()

    def preview(
        self,
        frames: Mapping[str, Array],
        joints: Array,
        duration: float | None,
        then: Callable[[Preview], object],
    ) -> None:
        """Make a preview.

        Parameters
        ----------
        frames
            name -> pose (7,) of those that are known
        joints
            (nv,) where the robot is
        duration
            s; None: as demonstrated
        then
            gets it, in the executor's thread
        """
        known = {**self._project.fixed_frames(), **frames}
        self._is_previewing = True

        def work() -> Preview:
            model = self._project.model
            if model is None:
                raise ValueError("there is no model yet: train one first")
            task, robot = self._project.task, self._project.robot()
            shapes = SelfCollision(robot, self._project.robot_file)
            return preview(self._project.load(model), known, joints, robot, task.endpoint, duration, shapes=shapes)

        def take(job: Future[Preview]) -> None:
            self._is_previewing = False
            try:
                self.shown = job.result()
            except (OSError, ValueError) as error:
                self._say(f"no preview: {one_line(error)}")
                return
            then(self.shown)

        self._background.run(work, take)

    def close(self) -> None:
        """End what goes on."""
        self.cancel()
