# SPDX-License-Identifier: Apache-2.0
"""How a project's model is learned, as numbers and texts that its notes keep: a correction learns in the same way."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Self

from tpgmm_core import Demonstration, LearnedMixture
from tpgmm_core.choice.automatic import Choice
from tpgmm_core.choice.trial import SAMPLES, Trial, thinned
from tpgmm_core.common.text import shown
from tpgmm_core.model.derived_frames import DerivedFrames, FrameSource, with_frames
from tpgmm_core.retrieval.methods import DEFAULT, KEY
from tpgmm_ros.recordings.recording import Recording, align
from tpgmm_ros.task.task_file import Task


@dataclass(frozen=True, slots=True)
class LearnedAs:
    """A method of retrieval, its frames and settings, and what derived frames are made of.

    Parameters
    ----------
    method
        by name
    frames
        names, in the order of the model
    settings
        of encoding and estimator, numbers and texts
    derived
        frame -> what it is derived from, and whether it turns with that
    """

    method: str
    frames: tuple[str, ...]
    settings: Mapping[str, Any] = field(default_factory=dict)
    derived: Mapping[str, tuple[str, bool]] = field(default_factory=dict)

    @classmethod
    def of_task(cls, task: Task, method: str | None = None, n_components: int | None = None) -> Self:
        """As the task file says, but for what is given.

        Parameters
        ----------
        task
            with the frames and the settings
        method, n_components
            in place of those of the task file

        Returns
        -------
        Self
            with all frames of the task
        """
        settings = {name: value for name, value in task.model.items() if name != KEY}
        if n_components is not None:
            settings["n_components"] = n_components
        trial = Trial.of(method or str(task.model.get(KEY, DEFAULT)), (*task.frames, *task.derived.sources), settings)
        return cls(trial.method, trial.frames, dict(trial.settings), _plain(task.derived))

    @classmethod
    def of_choice(cls, choice: Choice) -> Self:
        """As was chosen."""
        trial = choice.best.trial
        return cls(trial.method, trial.frames, dict(trial.settings), _plain(choice.derived.only(trial.frames)))

    @classmethod
    def of(cls, values: Mapping[str, Any]) -> Self:
        """From JSON.

        Parameters
        ----------
        values
            by the names of the fields

        Returns
        -------
        Self
            whose recipe can be made

        Raises
        ------
        ValueError
            for what was not written from such an object
        """
        try:
            method, frames, settings = values["method"], values["frames"], values["settings"]
            derived = {str(name): (str(of), bool(turned)) for name, (of, turned) in values["derived"].items()}
            if not isinstance(settings, dict) or not all(isinstance(v, int | float | str) for v in settings.values()):
                raise ValueError
            found = cls(str(method), tuple(map(str, frames)), settings, derived)
            _ = found.trial.recipe, found.sources  # raises
        except (KeyError, TypeError, ValueError, AttributeError) as error:
            raise ValueError(f"expected a method, frames and settings, got {shown(error)}") from None
        return found

    @property
    def trial(self) -> Trial:
        """As the search has it."""
        return Trial(self.method, self.frames, self.settings)

    @property
    def sources(self) -> DerivedFrames:
        """What derived frames are made of."""
        return DerivedFrames({name: FrameSource(of, turned) for name, (of, turned) in self.derived.items()})

    def learn(self, demonstrations: Sequence[Demonstration], task: Task) -> LearnedMixture:
        """A model of demonstrations of one duration, as `train --auto` learns the one that it chose.

        Parameters
        ----------
        demonstrations
            over [time, pose]
        task
            of these

        Returns
        -------
        LearnedMixture
            with metadata of its method and its derived frames

        Raises
        ------
        ValueError
            for demonstrations that cannot be learned from in this way
        """
        seen = []
        for demonstration in demonstrations:
            missing = [name for name in self.derived if name not in demonstration.frames]
            extended = self.sources.only(missing).extended(demonstration)
            seen.append(thinned(with_frames(extended, self.frames), SAMPLES))
        model = self.trial.recipe.learn(seen, task.space.manifold(), task.space.dimensions())
        model.metadata_ |= self.sources.metadata()
        return model

    def learn_recordings(self, recordings: Sequence[Recording], task: Task) -> LearnedMixture:
        """A model of recordings, with the metadata that `train` writes; raises as `learn` does."""
        demonstrations, _ = align(recordings)
        model = self.learn(demonstrations, task)
        model.metadata_ |= {
            "task": task.name,
            "base_frame": task.base_frame,
            "movement": task.movement,
            "endpoint": task.endpoint,
            "demonstrations": len(recordings),
            "samples": sum(min(len(recording.times), SAMPLES) for recording in recordings),
        }
        return model


def _plain(derived: DerivedFrames) -> dict[str, tuple[str, bool]]:
    return {name: (source.of, source.turned) for name, source in derived.sources.items()}
