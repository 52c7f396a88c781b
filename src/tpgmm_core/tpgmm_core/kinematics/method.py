# SPDX-License-Identifier: Apache-2.0
"""The retrieval method "kinematic": configurations as frames see them that move with the robot, learned and retrieved.

It is no row of `METHODS`, since it is made for a robot and its tasks; else it is used as all others are, by `Recipe`
and `make_retrieval`.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass
from typing import Any, ClassVar

from tpgmm_core.geometry.frame import Frame
from tpgmm_core.geometry.manifold import Manifold
from tpgmm_core.kinematics.movement import KinematicMovement
from tpgmm_core.kinematics.moving import MovingFrames
from tpgmm_core.kinematics.object_targets import target_object_origins
from tpgmm_core.learning.learned_mixture import LearnedMixture
from tpgmm_core.model.demonstration import Demonstration
from tpgmm_core.retrieval.encodings import Encoding
from tpgmm_core.retrieval.interface import Retrieval
from tpgmm_core.retrieval.methods import KEY, RetrievalMethod

NAME = "kinematic"
"""Of the method, in metadata."""

_TEXT = "kinematic"
"""Of what the frames mean, in metadata."""


@dataclass(frozen=True, slots=True, kw_only=True)
class KinematicEncoding(Encoding):
    """Configurations, seen from frames about the step before; of demonstrations [time, pose, configuration].

    Frames of these demonstrations are poses of objects: what they see of a configuration is the configuration.

    Attributes
    ----------
    frames : callable
        Makes the frames, each time for one user. May raise ValueError and OSError, as robots come from files.
    text : str
        What the frames mean: models are for the frames that they were learned from.
    aims : collection of str
        Frames that aim at the origins of their objects, whatever was demonstrated.
    over_time : bool
        Whether time is the first dimension, or the model is about moments.
    """

    name: ClassVar[str] = NAME
    description: ClassVar[str] = "configurations of a robot"
    frames: Callable[[], MovingFrames]
    text: str
    aims: Collection[str] = ()
    over_time: bool = False

    def __post_init__(self) -> None:
        """Nothing is a number with a range here."""

    def encode(self, demonstration: Demonstration, manifold: Manifold) -> Demonstration:
        """See `Encoding.encode`.

        Returns
        -------
        Demonstration
            over configurations, or [time, configuration]

        Raises
        ------
        ValueError
            where an object is not seen from the beginning
        """
        frames = self.frames()
        late = sorted(name for name in frames.objects if not demonstration.is_visible(name).all())
        if late:
            raise ValueError(
                f"{', '.join(late)} was not seen from the start, and tasks are relative to it: publish it before the "
                "demonstration starts"
            )
        objects = {name: _of_pose(demonstration.frames[name]) for name in frames.objects}
        configurations = demonstration.data[:, -frames.kinematics.n_joints :]
        return frames.demonstration(demonstration.times, configurations, objects, with_time=self.over_time)

    def finish(self, model: LearnedMixture) -> None:
        """See `Encoding`: where the targets of objects are in the model that was fitted."""
        target_object_origins(model, self.aims, self.over_time)

    def manifold(self, manifold: Manifold) -> Manifold:
        """See `Encoding`: joint positions, with time where the model is over time."""
        return Manifold.euclidean(_n_joints(manifold) + self.over_time)

    def dimensions(self, names: Sequence[str], manifold: Manifold) -> tuple[str, ...]:
        """See `Encoding`: the names of the joints, after that of time where the model is over time."""
        return (*names[: 1 if self.over_time else 0], *names[-_n_joints(manifold) :])

    def metadata(self) -> dict[str, str | float]:
        """See `Encoding`: the kinematic frames as text, so that a model of others is refused."""
        return {_TEXT: self.text}


def _n_joints(manifold: Manifold) -> int:
    return manifold.factors[-1][1]


def _of_pose(frame: Frame) -> Frame:
    """The frame of a pose, of one over [time, pose, configuration]."""
    return Frame(frame.A[..., 1:8, 1:8], frame.b[..., 1:8])


@dataclass(frozen=True, slots=True, kw_only=True)
class KinematicMethod(RetrievalMethod):
    """How movements come out of models of kinematic frames: see `KinematicMovement`.

    Attributes
    ----------
    text : str
        What the frames mean, as of `KinematicEncoding`.
    """

    text: str

    @classmethod
    def of(cls, frames: Callable[[], MovingFrames], text: str) -> KinematicMethod:
        """For frames that are made, and what they mean."""

        def movement(model: LearnedMixture, *, duration: float | None = None, **_: Any) -> Retrieval:
            return KinematicMovement(model, frames(), duration=duration)

        return cls(name=NAME, encoding=KinematicEncoding, movement=movement, text=text)

    def check(self, model: LearnedMixture) -> None:
        """See `RetrievalMethod.check`.

        Raises
        ------
        ValueError
            for a model of other frames than the task's
        """
        if model.metadata_.get(KEY) != NAME:
            raise ValueError(
                "the model was not learned from the task's kinematic frames: train it again, from joint states"
            )
        if model.metadata_.get(_TEXT) != self.text:
            raise ValueError(
                "the task's kinematic frames differ from those that the model was learned from: train it again"
            )
