# SPDX-License-Identifier: Apache-2.0
"""`AttractorSystem`: base of the retrieval methods that have a state of their own and go to a goal."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Mapping

import numpy as np
from numpy.typing import ArrayLike

from tpgmm_core.common.types import Array
from tpgmm_core.geometry import quaternion
from tpgmm_core.geometry.frame import Frame
from tpgmm_core.geometry.gaussian import Gaussian
from tpgmm_core.geometry.manifold import Manifold
from tpgmm_core.geometry.mixture import GaussianMixture
from tpgmm_core.learning.endpoints import EndpointTPGMM
from tpgmm_core.model.reference import Reference
from tpgmm_core.model.situation import Situation
from tpgmm_core.retrieval.covariance_fade import CovarianceFade
from tpgmm_core.retrieval.interface import Retrieval, demonstrated_duration
from tpgmm_core.retrieval.time_scaling import TimeScaling

_SECOND = 1_000_000_000


class AttractorSystem(Retrieval, ABC):
    """A `Retrieval` whose scaled time is in units of the duration, and never runs backwards.

    Parameters
    ----------
    model
        fitted
    manifold
        of the references
    duration
        of the movement at speed 1, s; None: as demonstrated (`metadata_["duration_s"]`). It may be set at any time;
        like a new speed it takes effect with `blend_time` as time constant
    horizon_steps, horizon_time_step
        how many Gaussians ahead each reference holds, and their distance in time, s
    blend_time
        time constant with which sudden changes take effect, s

    Raises
    ------
    ValueError
        for times that are not positive
    """

    def __init__(
        self,
        model: EndpointTPGMM,
        manifold: Manifold,
        duration: float | None,
        horizon_steps: int,
        horizon_time_step: float,
        blend_time: float,
    ) -> None:
        if not isinstance(model, EndpointTPGMM):
            raise ValueError(
                f"the model is a {type(model).__name__}, which does not know where movements end: fit an EndpointTPGMM"
            )
        duration = demonstrated_duration(model) if duration is None else duration
        positive(duration=duration, horizon_time_step=horizon_time_step, blend_time=blend_time)
        self._manifold, self._frame_names = manifold, model.frame_names_
        self.blend_time = float(blend_time)
        self._horizon_time_step = horizon_time_step if horizon_steps else 0.0
        self._ahead_times: Array = horizon_time_step * np.arange(1, 1 + horizon_steps, dtype=np.float64)
        self._duration, self._speed = float(duration), 1.0
        self._time_scaling = TimeScaling(1.0 / self._duration, self.blend_time)
        self._fade = CovarianceFade(manifold.tangent_dim, self.blend_time)
        self._shown: Array = np.eye(manifold.tangent_dim)  # covariance of the last reference
        self._last_ns: int | None = None
        self._situation: Situation | None = None

    def _compile(self) -> None:
        """Make two steps, so that no later one waits for the compiler; with one frame, which nothing contradicts."""
        D = 1 + self.manifold.dim
        frame = Frame(np.eye(D), np.zeros(D))
        self.start(0)
        for time_ns in (0, 1):
            self.step(time_ns, {self.frame_names[0]: frame})
        self.horizon(1, 0.001)
        self._last_ns = self._situation = None

    @property
    def manifold(self) -> Manifold:
        """Manifold of the references, without time."""
        return self._manifold

    @property
    def frame_names(self) -> tuple[str, ...]:
        """The frames that the model was learned from."""
        return self._frame_names

    @property
    def duration(self) -> float:
        """Duration of the whole movement at speed 1, s."""
        return self._duration

    @duration.setter
    def duration(self, duration: float) -> None:
        positive(duration=duration)
        self._duration = float(duration)
        self._time_scaling.target = self._target()

    @property
    def speed(self) -> float:
        """1 as learned, 0 pauses."""
        return self._speed

    @speed.setter
    def speed(self, speed: float) -> None:
        if not (isinstance(speed, int | float) and math.isfinite(speed) and speed >= 0.0):
            raise ValueError(
                f"the speed is {speed!r}; this retrieval method cannot move backwards: give 0 or more, or "
                "choose a method that is a function of time"
            )
        self._speed = float(speed)
        self._time_scaling.target = self._target()

    def start(self, time_ns: int, state: ArrayLike | None = None, phase: float = 0.0) -> None:
        """Begin at rest at `state`; None: where the robot is at the first step, or else where demonstrations began.

        Raises
        ------
        ValueError
            for a state that is not on the manifold, and a phase that is not 0 to 1
        """
        if not 0.0 <= phase <= 1.0:
            raise ValueError(f"the phase to begin at is 0 to 1, got {phase!r}")
        self._start, self._start_phase = None if state is None else self._point(state), float(phase)
        self._last_ns = time_ns
        self._situation = None
        self._fade.forget()
        self._time_scaling.target = self._target()
        self._time_scaling.rate = self._time_scaling.target

    def step(
        self,
        time_ns: int,
        frames: Mapping[str, Frame],
        state: ArrayLike | None = None,
        weights: Mapping[str, float] | None = None,
    ) -> Reference:
        """The reference at a time.

        Raises
        ------
        ValueError
            before `start`
        """
        if self._last_ns is None:
            raise ValueError("the movement has not been started: call start(time_ns)")
        where = None if state is None else self._point(state)
        seconds = max(0.0, (time_ns - self._last_ns) / _SECOND)
        situation = Situation(frames, weights)
        if self._situation is None:
            self._begin(situation, self._start if self._start is not None else where, self._start_phase)
            self._situation = situation
        elif not situation.has_frames_of(self._situation):
            self._situate(situation)
            self._fade.take_over(self._shown, self._now()[1])
            self._situation = situation
        self._last_ns = time_ns
        if seconds > 0.0:
            self._time_scaling.target = self._target()
            self._advance(seconds, where)
            self._fade.advance(seconds)
        mean, covariance, activations = self._now()
        self._shown = self._fade.of(covariance)
        return Reference(
            phase=self._phase(),
            gaussian=Gaussian(mean, self._shown, self.manifold),
            horizon_time_step=self._horizon_time_step,
            horizon=tuple(self._shown_ahead(self._ahead_times)) if len(self._ahead_times) else (),
            activations=activations,
            frames=tuple(frames),
        )

    def horizon(self, n: int, dt: float) -> list[Gaussian]:
        """The next n Gaussians, dt (s) apart, if frames and robot stay where they are: see `Retrieval.horizon`."""
        positive(dt=dt)
        self._check_stepped()
        if n < 1:
            return []
        return self._shown_ahead(dt * np.arange(1, n + 1, dtype=np.float64))

    def mixture(self) -> GaussianMixture:
        """The model in the situation of the last step, over all dimensions that it encodes."""
        self._check_stepped()
        return self._mixture()

    def _target(self) -> float:
        """Target rate of scaled time, per s."""
        return self._speed / self._duration

    def _check_stepped(self) -> None:
        if self._situation is None:
            raise ValueError("there was no step yet: call start(time_ns) and step(...)")

    def _point(self, state: ArrayLike) -> Array:
        point = np.array(state, dtype=float)
        if point.shape != (self.manifold.dim,) or not np.all(np.isfinite(point)):
            raise ValueError(
                f"a state on {self.manifold} has shape ({self.manifold.dim},) and is finite, got {state!r}"
            )
        for s in self.manifold.spheres:
            point[s.ambient] = quaternion.normalize(point[s.ambient])
        return point

    def _shown_ahead(self, seconds: Array) -> list[Gaussian]:
        means, covariances = self._ahead(seconds)
        return [
            Gaussian._of_kernel(mean.copy(), np.array(self._fade.of(covariance, ahead)), self.manifold)
            for mean, covariance, ahead in zip(means, covariances, seconds.tolist(), strict=True)
        ]

    @abstractmethod
    def _begin(self, situation: Situation, state: Array | None, phase: float) -> None:
        """Take the first situation, and begin at this state, or where demonstrations did."""

    @abstractmethod
    def _situate(self, situation: Situation) -> None:
        """Change to another situation during the movement."""

    @abstractmethod
    def _advance(self, seconds: float, robot: Array | None) -> None:
        """Advance by a time > 0, s; robot (D,): where it is, or None."""

    @abstractmethod
    def _now(self) -> tuple[Array, Array, Array]:
        """Mean (D,) and covariance (n, n) of the reference, and the activations (K,)."""

    @abstractmethod
    def _ahead(self, seconds: Array) -> tuple[Array, Array]:
        """Means (H, D) and covariances (H, n, n) at increasing times (H,), H > 0, from now, s; the state stays."""

    @abstractmethod
    def _phase(self) -> float:
        """Share of the movement that is done: 0 at the start, 1 at the end."""

    @abstractmethod
    def _mixture(self) -> GaussianMixture: ...


def positive(**values: float) -> None:
    """Check that all values are positive and finite.

    Raises
    ------
    ValueError
        for the first one that is not, with its name
    """
    for name, value in values.items():
        if not (isinstance(value, int | float) and math.isfinite(value) and value > 0.0):
            raise ValueError(f"{name} is a positive number, got {value!r}")
