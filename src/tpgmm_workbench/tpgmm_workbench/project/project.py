# SPDX-License-Identifier: Apache-2.0
"""`Project`: one folder with a task, a robot, demonstrations and models; nothing in it is ever deleted.

    project/
      task.yaml  robot.yaml
      demonstrations/0001/   an ordinary bag, and notes.json
      models/0001.tpgmm  0001.json   a model, and what it was learned from

A demonstration is there when its folder is, a model when its notes are: each comes by one renaming, after all of it is
on the disk. So a folder whose program, or machine, died at any moment opens again with all that was finished.
"""

from __future__ import annotations

import shutil
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from tpgmm_core import LearnedMixture
from tpgmm_core.common.text import listed, one_line
from tpgmm_core.common.types import Array
from tpgmm_core.robot.model import RobotModel
from tpgmm_ros.messages.sources import TaskParametersSource
from tpgmm_ros.models.task_model import load_task_model
from tpgmm_ros.task.state_space import PoseSpace
from tpgmm_ros.task.task_file import Task, TaskError
from tpgmm_workbench.project import folder as files
from tpgmm_workbench.project.demonstration_store import DemonstrationStore
from tpgmm_workbench.project.errors import ProjectError
from tpgmm_workbench.project.notes import ModelNotes, read_notes, write_notes
from tpgmm_workbench.project.taught import TaughtDemonstration


@dataclass(frozen=True, slots=True)
class TrainedModel:
    """A model of a project: its number, its file, and what is known of it."""

    number: int
    path: Path
    notes: ModelNotes


class Project(DemonstrationStore):
    """A project's folder; make one with `create` or `open`. Its methods may be called from several threads.

    Attributes
    ----------
    folder
        where it lies
    task
        what its task file says
    """

    def __init__(self, folder: Path, task: Task) -> None:
        super().__init__(folder, task)
        self._loaded: dict[int, LearnedMixture] = {}
        self._robot: RobotModel | None = None

    @classmethod
    def create(cls, folder: str | Path, task_file: str | Path, robot_file: str | Path) -> Project:
        """Make a project of copies of a task file and a robot file.

        Parameters
        ----------
        folder
            must not exist, or be empty
        task_file, robot_file
            both are copied, with a URDF that lies beside the robot file

        Returns
        -------
        Project
            without demonstrations

        Raises
        ------
        ProjectError
            for a folder that is not empty, and files that cannot be used
        OSError
            where the folder cannot be written
        """

        def fill(draft: Path) -> None:
            _task(Path(task_file))
            shutil.copyfile(task_file, draft / files.TASK)
            files.copy_robot(Path(robot_file), draft)
            for name in (files.DEMONSTRATIONS, files.MODELS):
                (draft / name).mkdir()

        files.make_folder(Path(folder), fill)
        return cls.open(folder)

    @classmethod
    def open(cls, folder: str | Path) -> Project:
        """Open a project.

        Parameters
        ----------
        folder
            of the project

        Returns
        -------
        Project
            with all that was finished

        Raises
        ------
        ProjectError
            for a folder that is no project
        """
        place = Path(folder).resolve()
        missing = [name for name in (files.TASK, files.ROBOT) if not (place / name).is_file()]
        if missing:
            raise ProjectError(
                f"{one_line(place)} is not a project: it lacks {' and '.join(missing)}; choose a project's folder, or "
                "make a new one"
            )
        return cls(place, _task(place / files.TASK))

    @property
    def task_file(self) -> Path:
        """Its task file."""
        return self.folder / files.TASK

    @property
    def robot_file(self) -> Path:
        """Its robot file."""
        return self.folder / files.ROBOT

    def robot(self) -> RobotModel:
        """The robot, which is read once. Raises RobotFileError."""
        with self._lock:
            if self._robot is None:
                self._robot = RobotModel.from_file(self.robot_file)
            return self._robot

    def fixed_frames(self) -> dict[str, Array]:
        """Frames that the task file fixes: name -> pose (7,) in the base frame."""
        return {name: np.array(spec.pose) for name, spec in self.task.frames.items() if spec.pose is not None}

    # -- models

    def models(self) -> tuple[TrainedModel, ...]:
        """All models, in the order of training, those too that were undone."""
        with self._lock:
            folder = self.folder / files.MODELS
            found = []
            for number, path in files.numbered(folder, ".json").items():
                model = folder / f"{files.named(number)}.tpgmm"
                if model.is_file():
                    found.append(TrainedModel(number, model, read_notes(path, ModelNotes)))
            return tuple(found)

    @property
    def model(self) -> TrainedModel | None:
        """The last one that was not undone."""
        return next((model for model in reversed(self.models()) if not model.notes.is_undone), None)

    def load(self, model: TrainedModel) -> LearnedMixture:
        """A model from its file, which is read once.

        Parameters
        ----------
        model
            of this project

        Returns
        -------
        LearnedMixture
            a fitted model

        Raises
        ------
        ProjectError
            for a file that is no model of this task
        """
        with self._lock:
            if model.number not in self._loaded:
                try:
                    self._loaded[model.number] = load_task_model(model.path, self.task)
                except (OSError, ValueError) as error:
                    raise ProjectError(one_line(error)) from error
            return self._loaded[model.number]

    def keep(self, model: LearnedMixture, notes: ModelNotes) -> TrainedModel:
        """Keep a new model, which is the present one from now on. Raises OSError."""
        with self._lock:
            folder = self.folder / files.MODELS
            folder.mkdir(exist_ok=True)
            number, path = self._reserved(folder)
            model.save(path)
            write_notes(path.with_suffix(".json"), notes)
            files.sync(folder)
            self._loaded[number] = model
            return TrainedModel(number, path, notes)

    def take_back(self, number: int) -> None:
        """Mark a model as undone, by its number: the one before is the present one again."""
        with self._lock:
            for model in self.models():
                if model.number == number:
                    write_notes(model.path.with_suffix(".json"), replace(model.notes, is_undone=True))

    @staticmethod
    def _reserved(folder: Path) -> tuple[int, Path]:
        """A number that no other process takes: the empty file counts as no model as long as it has no notes."""
        while True:
            number = files.free_number(folder)
            path = folder / f"{files.named(number)}.tpgmm"
            try:
                path.touch(exist_ok=False)
            except FileExistsError:
                continue
            return number, path

    # -- undo

    def undo(self) -> str:
        """Take back the last demonstration or correction, with the model that a correction made.

        Returns
        -------
        str
            what was undone, in words; empty where there is nothing
        """
        return self._mark_last(True)

    def redo(self) -> str:
        """Bring back what was undone last; returns what that was, in words, or nothing."""
        return self._mark_last(False)

    def _mark_last(self, is_undone: bool) -> str:
        with self._lock:
            shown = [d for d in self.demonstrations() if d.notes.is_undone != is_undone]
            if not shown:
                return ""
            last = shown[-1] if is_undone else shown[0]
            self._write(last.number, replace(last.notes, is_undone=is_undone))
            word = "undone" if is_undone else "back again"
            if last.notes.correction is None:
                return f"demonstration {last.number} is {word}"
            undone = {d.number for d in self.demonstrations() if d.notes.is_undone}
            for model in self.models():
                if last.number in model.notes.learned_from:
                    now = not undone.isdisjoint(model.notes.learned_from)
                    write_notes(model.path.with_suffix(".json"), replace(model.notes, is_undone=now))
            return f"correction {last.number} is {word}, and so is the model that learned from it"


def _task(path: Path) -> Task:
    """A task of poses. Raises ProjectError."""
    try:
        task = Task.load(path)
    except TaskError as error:
        raise ProjectError(str(error)) from error
    if not isinstance(task.space, PoseSpace):
        raise ProjectError(f"{one_line(path)} is a task over joints; the workbench teaches movements of poses")
    if maps := [name for name, source in task.sources.items() if isinstance(source, TaskParametersSource)]:
        raise ProjectError(f"{one_line(path)} has the maps {listed(maps)}; the workbench knows frames of poses only")
    return task


def used_parts(shown: Sequence[TaughtDemonstration]) -> Mapping[int, tuple[float, float] | None]:
    """What is used of demonstrations, as the notes of a model have it."""
    return {one.number: one.notes.trim for one in shown}
