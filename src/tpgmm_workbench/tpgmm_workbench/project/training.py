# SPDX-License-Identifier: Apache-2.0
"""`Training`: a model is learned in a process of its own, which tells how far it is, and may be cancelled."""

from __future__ import annotations

from dataclasses import dataclass

from tpgmm_workbench.project.project import Project, TrainedModel


@dataclass(frozen=True, slots=True)
class TrainingOptions:
    """How a model is learned.

    Parameters
    ----------
    is_automatic
        choose frames, method and settings as `train --auto` does; from three demonstrations on
    budget_s
        time for choosing
    method, n_components
        in place of those of the task file; None: as it says, or as chosen
    """

    is_automatic: bool = True
    budget_s: float = 60.0
    method: str | None = None
    n_components: int | None = None


@dataclass(frozen=True, slots=True)
class Progress:
    """How far a training is: a share from 0 to 1, in words, and whether it has ended."""

    share: float
    words: str
    is_over: bool = False


class Training:
    """A training that goes on; make one with `start`."""

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
            for too few demonstrations, with how many more are needed
        """
        raise NotImplementedError

    def progress(self) -> Progress:
        """How far it is; never waits."""
        raise NotImplementedError

    def cancel(self) -> None:
        """End it; nothing is kept. Nothing happens where it has ended."""
        raise NotImplementedError

    def wait(self, timeout_s: float) -> bool:
        """Wait for its end, at most this time; returns whether it has ended."""
        raise NotImplementedError

    def result(self) -> TrainedModel:
        """The model that was kept in the project; its `notes.words` are for people.

        Raises
        ------
        ProjectError
            with why there is none: cancelled, going on, or what could not be learned
        """
        raise NotImplementedError
