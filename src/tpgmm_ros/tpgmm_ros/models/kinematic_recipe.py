# SPDX-License-Identifier: Apache-2.0
"""Recordings of configurations and objects to a model of kinematic frames, and that model to a movement."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from tpgmm_core import TPGMM, Frame
from tpgmm_core.common.text import shown
from tpgmm_core.kinematics.movement import KinematicMovement
from tpgmm_core.kinematics.object_targets import target_object_origins
from tpgmm_core.learning.estimation.compiled_em import Progress
from tpgmm_core.retrieval.interface import Retrieval
from tpgmm_core.retrieval.methods import KEY
from tpgmm_ros.recordings.bags import Recording
from tpgmm_ros.task.kinematic_section import KinematicSpec

METHOD = "kinematic"
"""What metadata say of these models: the name of their retrieval method."""

_SPEC_KEY = "kinematic"


@dataclass(frozen=True, slots=True)
class KinematicRecipe:
    """How a model of kinematic frames is learned.

    Attributes
    ----------
    spec
        the frames
    arguments
        of TPGMM. With one component (the default) the model is about moments; with more it is over time.
    """

    spec: KinematicSpec
    arguments: Mapping[str, Any]

    @property
    def max_iter(self) -> int:
        """At most this many iterations of EM."""
        return int(TPGMM(**self._all).max_iter)

    @property
    def _all(self) -> dict[str, Any]:
        return {"n_components": 1, **self.arguments}

    def learn(self, recordings: Sequence[Recording], duration: float, progress: Progress | None = None) -> TPGMM:
        """A model of recordings, whose times are stretched linearly to a duration, s.

        Raises
        ------
        ValueError
            a recording without configurations, an object that was not seen from the start, a robot that
            does not fit, or what cannot be learned from.
        OSError
            the robot file cannot be read.
        """
        frames, arguments = self.spec.frames(), self._all
        over_time = arguments["n_components"] > 1
        demonstrations = []
        for recording in recordings:
            if recording.configurations is None:
                raise ValueError(f"{recording.path} was read without configurations, which kinematic frames see")
            late = sorted(name for name in frames.objects if not recording.visible[name].all())
            if late:
                raise ValueError(
                    f"{recording.path}: {', '.join(late)} was not seen from the start, and tasks are relative to "
                    "it: publish it before the demonstration starts"
                )
            objects = {
                name: Frame.from_pose(recording.frames[name][:, :3], recording.frames[name][:, 3:])
                for name in frames.objects
            }
            times = recording.times * (duration / recording.duration)
            demonstrations.append(frames.demonstration(times, recording.configurations, objects, with_time=over_time))
        model = TPGMM(**arguments).fit(demonstrations, progress)
        target_object_origins(model, self.spec.aiming, over_time)
        model.dimensions_ = _dimensions(self.spec, over_time)
        model.metadata_ = {KEY: METHOD, _SPEC_KEY: self.spec.description, "duration_s": duration}
        return model


def check_model(model: TPGMM, spec: KinematicSpec) -> None:
    """Raises ValueError for a model that was not learned from these frames, and OSError without the robot file."""
    if model.metadata_.get(KEY) != METHOD:
        raise ValueError(
            "the model was not learned from the task's kinematic frames: train it again, from joint states"
        )
    dimensions = tuple(model.dimensions_ or ())
    expected = _dimensions(spec, dimensions[:1] == ("time",))
    if dimensions != expected or model.manifold_.dim != len(expected):
        raise ValueError(f"the model is over {dimensions}; the task needs {expected}")
    if model.metadata_.get(_SPEC_KEY) != spec.description:
        raise ValueError(
            "the task's kinematic frames differ from those that the model was learned from: train it again"
        )


def make_movement(
    model: TPGMM,
    spec: KinematicSpec,
    method: str | None = None,
    *,
    duration: float | None = None,
    phase: str = "clock",
    speed: float = 1.0,
    **others: float,
) -> Retrieval:
    """A movement of the model; parameters as for `make_retrieval`, of which it has no `others`.

    Raises
    ------
    ValueError
        another method or phase than this kind of model has, or a model that does not fit.
    OSError
        the robot file cannot be read.
    """
    if method is not None or phase != "clock":
        raise ValueError(
            f"a model of kinematic frames is reproduced by one method, on the clock; got {shown(method or METHOD)} and "
            f"{shown(phase)}: leave retrieval empty and the phase at 'clock'"
        )
    movement = KinematicMovement(model, spec.frames(), duration=duration)
    movement.speed = speed
    return movement


def _dimensions(spec: KinematicSpec, over_time: bool) -> tuple[str, ...]:
    return (*(("time",) if over_time else ()), *spec.joint_names())
