# SPDX-License-Identifier: Apache-2.0
"""`KinematicMovement`: a model of kinematic frames as a movement in configuration space, which a loop steps through."""

from __future__ import annotations

import math
from collections.abc import Mapping

import numpy as np

from tpgmm_core.common.types import Array
from tpgmm_core.geometry.frame import Frame
from tpgmm_core.geometry.gaussian import Gaussian
from tpgmm_core.geometry.manifold import Manifold
from tpgmm_core.geometry.mixture import GaussianMixture
from tpgmm_core.kinematics.moving import ConfigurationProduct, MovingFrames
from tpgmm_core.learning.learned_mixture import LearnedMixture
from tpgmm_core.model.reference import Reference
from tpgmm_core.model.situation import Situation
from tpgmm_core.retrieval.interface import Retrieval, demonstrated_duration
from tpgmm_core.retrieval.time_scaling import TimeScaling

_SECOND = 1_000_000_000
MAX_JOINT_SPEED = 1.0  # rad/s
LEASH = 0.2  # rad
SPEED_TIME_CONSTANT = 0.1  # s, with which a new speed is taken over


class KinematicMovement(Retrieval):
    """A `Retrieval` whose states are configurations (n,): at each step the product about its own last reference.

    So the reference does not lag behind as the robot does, and stays where it is in directions that frames leave free.
    Before each step, it is brought to within `leash` of where the robot is, all joints together: it waits for a robot
    that is held, and a robot that is pushed farther away takes it along. Otherwise it never jumps, whatever objects do:
    it moves to the product at `max_joint_speed` at most, all joints together. Its horizon repeats the present
    reference, since the motion of objects is not known. Objects are the frames that it needs: poses over [time, pose],
    as in other retrievals.

    Parameters
    ----------
    model
        as for `ConfigurationProduct`
    frames
        at least the model's; for this movement alone
    duration
        s; None: that of the model's metadata. A model that is not over time goes on afterwards as before
    max_joint_speed
        rad/s
    leash
        rad, of the joint that is farthest away

    Raises
    ------
    ValueError
        like `ConfigurationProduct`, and for a time, a speed or a leash that is not positive
    """

    def __init__(
        self,
        model: LearnedMixture,
        frames: MovingFrames,
        *,
        duration: float | None = None,
        max_joint_speed: float = MAX_JOINT_SPEED,
        leash: float = LEASH,
    ) -> None:
        self._model_duration = demonstrated_duration(model)
        self._duration = self._model_duration if duration is None else duration
        for name, value in (
            ("duration", self._duration), ("max_joint_speed", max_joint_speed), ("leash", leash),
        ):  # fmt: skip
            if not (math.isfinite(value) and value > 0.0):
                raise ValueError(f"{name} is {value!r}; give a positive number")
        self._product = ConfigurationProduct(model, frames)
        self._max_joint_speed, self._leash = max_joint_speed, leash
        self._needs = {name: self._product.frames.objects_of(name) for name in model.frame_names_}
        self._time_scaling = TimeScaling(1.0, SPEED_TIME_CONSTANT)
        self._last_ns: int | None = None
        self._last: Gaussian | None = None
        self._compile()

    def _compile(self) -> None:
        """Make a step where all objects are at the origin, so that no later one waits for the compiler."""
        origin = Frame.from_pose(np.zeros(3), [0.0, 0.0, 0.0, 1.0]).with_time()
        self.start(0, np.zeros(self._product.frames.kinematics.n_joints))
        self.step(0, dict.fromkeys(self.frame_names, origin), weights=dict.fromkeys(self.frame_names, 1.0))
        self._last_ns = self._last = None

    @property
    def manifold(self) -> Manifold:
        """R^n of the configurations."""
        return Manifold.euclidean(self._product.frames.kinematics.n_joints)

    @property
    def frame_names(self) -> tuple[str, ...]:
        """The objects that the model's frames need."""
        return tuple(sorted(self._product.frames.objects))

    @property
    def duration(self) -> float:
        """Duration of the movement at speed 1, s."""
        return self._duration

    @property
    def speed(self) -> float:
        """Speed of the model's time, not of the joints; see `Retrieval.speed`."""
        return self._time_scaling.target

    @speed.setter
    def speed(self, speed: float) -> None:
        if not math.isfinite(speed):
            raise ValueError(f"the speed is {speed!r}; give a finite number")
        self._time_scaling.target = float(speed)

    def start(self, time_ns: int, state: Array | None = None, phase: float = 0.0) -> None:
        """Begin at this time, ns; the reference begins at the configuration `state` (n,)."""
        self._last_ns = time_ns
        self._phase = min(max(phase, 0.0), 1.0)
        self._time_scaling.rate = self._time_scaling.target
        self._q = state
        self._mean = state
        self._last = None
        self._situation: Situation | None = None

    def step(
        self,
        time_ns: int,
        frames: Mapping[str, Frame],
        state: Array | None = None,
        weights: Mapping[str, float] | None = None,
    ) -> Reference:
        """The reference at a time, over configurations; states are (n,), rad or m.

        Raises
        ------
        ValueError
            before `start`, and while no state was ever given
        """
        if self._last_ns is None:
            raise ValueError("the movement has not been started: call start(time_ns)")
        q = self._q if state is None else state
        if q is None:
            raise ValueError("the configuration of the robot is not known: there were no joint states yet")
        since = max(0.0, (time_ns - self._last_ns) / _SECOND)
        situation = Situation(frames, weights)
        if self._situation is None or not situation.has_frames_of(self._situation):
            self._situation = situation
            self._poses = {name: _without_time(frame) for name, frame in frames.items()}
        self._phase = min(max(self._phase + self._time_scaling.advance(since) / self._duration, 0.0), 1.0)
        self._weights = self._weights_of_frames(weights)
        last = q if self._mean is None else _within(self._leash, self._mean, q)
        product = self._product.step(last, self._poses, self._time, self._weights, since)
        self._mean = _within(self._max_joint_speed * since, product.mean, last)
        self._q, self._around, self._last_ns = q, last, time_ns
        self._last = Gaussian(self._mean, product.covariance)
        return Reference(
            phase=self._phase,
            gaussian=self._last,
            horizon_time_step=0.0,
            horizon=(),
            activations=self._product.activations,
            frames=tuple(frames),
        )

    def horizon(self, n: int, dt: float) -> list[Gaussian]:
        """The last reference n times: if the frames stay, so does its target."""
        return [self._require_step()] * n

    def mixture(self) -> GaussianMixture:
        """The model about the last configuration: over configurations, or over [time, configuration]."""
        self._require_step()
        return self._product.mixture(self._around, self._poses, self._time, self._weights)

    def _require_step(self) -> Gaussian:
        if self._last is None:
            raise ValueError("there was no step yet: call start(time_ns) and step(...)")
        return self._last

    @property
    def _time(self) -> float | None:
        return self._phase * self._model_duration if self._product.over_time else None

    def _weights_of_frames(self, weights: Mapping[str, float] | None) -> dict[str, float] | None:
        """The weight of each frame: the smallest one of the objects that it needs."""
        if weights is None:
            return None
        return {
            name: min((weights.get(item, 1.0) for item in needed), default=1.0)
            for name, needed in self._needs.items()
            if needed <= self._poses.keys()
        }


def _within(limit: float, there: Array, centre: Array) -> Array:
    """The configuration on the way from the centre to another one at which no joint is beyond a limit, rad."""
    way = there - centre
    farthest = float(np.abs(way).max())
    return there if farthest <= limit else centre + way * (limit / farthest)


def _without_time(frame: Frame) -> Frame:
    """The frame of a pose, from one over [time, pose]."""
    return Frame(frame.A[1:, 1:], frame.b[1:])
