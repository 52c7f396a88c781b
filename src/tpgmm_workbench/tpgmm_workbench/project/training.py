# SPDX-License-Identifier: Apache-2.0
"""`Training`: a model is learned in a process of its own, which tells how far it is, and may be cancelled."""

from __future__ import annotations

import multiprocessing
import threading
from dataclasses import dataclass
from typing import Any

from tpgmm_core.retrieval.methods import METHODS
from tpgmm_workbench.project.activities import Action, Facts, may
from tpgmm_workbench.project.errors import ProjectError
from tpgmm_workbench.project.project import Project, TrainedModel
from tpgmm_workbench.project.training_process import TrainingOptions, work

__all__ = ["Progress", "Training", "TrainingOptions"]

END_S = 5.0
"""A process that is told to end has this time."""


@dataclass(frozen=True, slots=True)
class Progress:
    """How far a training is: a share from 0 to 1, in words, and whether it has ended."""

    share: float
    words: str
    is_over: bool = False


class Training:
    """A training that goes on; make one with `start`. Its methods may be called from several threads."""

    def __init__(self, project: Project, process: Any, pipe: Any) -> None:
        self._project, self._process, self._pipe = project, process, pipe
        self._lock = threading.RLock()
        self._progress = Progress(0.0, "starting")
        self._number: int | None = None
        self._reason = ""
        self._listener = threading.Thread(target=self._listen, name="training", daemon=True)
        self._listener.start()

    @classmethod
    def start(cls, project: Project, options: TrainingOptions | None = None) -> Training:
        """Begin to learn from the demonstrations of a project that are used.

        Parameters
        ----------
        project
            with two at least
        options
            None: the usual ones

        Returns
        -------
        Training
            which goes on

        Raises
        ------
        ProjectError
            for too few demonstrations, with how many more are needed, and a method that does not exist
        """
        chosen = options or TrainingOptions()
        if reason := may(Action.TRAIN, Facts(demonstrations=len(project.shown()))):
            raise ProjectError(reason)
        if chosen.method is not None and chosen.method not in METHODS:
            raise ProjectError(f"there is no method {chosen.method!r}; there are {', '.join(METHODS)}")
        # spawned, not forked: a fork of a process with threads (of ROS, of BLAS) may never come to its work
        context = multiprocessing.get_context("spawn")
        receiver, sender = context.Pipe(duplex=False)
        process = context.Process(target=work, args=(sender, str(project.folder), chosen), name="training")
        process.start()
        sender.close()
        return cls(project, process, receiver)

    def progress(self) -> Progress:
        """How far it is; never waits."""
        with self._lock:
            return self._progress

    def _listen(self) -> None:
        """Take what the process tells, as it comes: it would wait for a listener that is late."""
        try:
            while True:
                kind, *values = self._pipe.recv()
                with self._lock:
                    if self._progress.is_over:
                        if kind == "done":  # it was cancelled in its last moment
                            self._project.take_back(values[0])
                    elif kind == "progress":
                        self._progress = Progress(*values)
                    elif kind == "done":
                        self._number = values[0]
                        self._progress = Progress(1.0, "the model is ready", True)
                    else:
                        self._end(values[0])
        except (EOFError, OSError):
            self._process.join()
            with self._lock:
                if not self._progress.is_over:
                    self._end(f"the training ended without a model (status {self._process.exitcode})")

    def cancel(self) -> None:
        """End it; nothing is kept. Nothing happens where it has ended."""
        with self._lock:
            if self._progress.is_over:
                return
            self._end("cancelled: no model was made; the demonstrations are as they were")
            self._process.terminate()
        self._process.join(END_S)
        if self._process.is_alive():
            self._process.kill()
            self._process.join()

    def wait(self, timeout_s: float) -> bool:
        """Wait for its end, at most this time; returns whether it has ended."""
        self._listener.join(timeout_s)
        return self.progress().is_over

    def result(self) -> TrainedModel:
        """The model that was kept in the project.

        Returns
        -------
        TrainedModel
            whose `notes.words` are for people

        Raises
        ------
        ProjectError
            with why there is none: cancelled, going on, or what could not be learned
        """
        if not self.progress().is_over:
            raise ProjectError("the training goes on: wait for its end")
        if self._number is None:
            raise ProjectError(self._reason)
        return next(model for model in self._project.models() if model.number == self._number)

    def _end(self, reason: str) -> None:
        self._reason = reason
        self._progress = Progress(self._progress.share, reason, True)
