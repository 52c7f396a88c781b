# SPDX-License-Identifier: Apache-2.0
"""A learned movement, step by step: where to be and how much it matters, for the frames as they are right now.

Frames move, disappear and come back while the movement runs, and each time the movement is suddenly another one. The
references do not jump: see `continuity`. While the frames stay, they are exactly those of the movement.
"""

from __future__ import annotations

import math
from collections.abc import Mapping

import numpy as np

from tpgmm_core.common.types import Array
from tpgmm_core.geometry.frame import Frame
from tpgmm_core.geometry.gaussian import Gaussian
from tpgmm_core.geometry.manifold import Manifold
from tpgmm_core.geometry.mixture import GaussianMixture
from tpgmm_core.learning.learned_mixture import LearnedMixture
from tpgmm_core.model.adaptation import UNCONSTRAINED_VARIANCE
from tpgmm_core.model.reference import Reference
from tpgmm_core.model.situation import Situation
from tpgmm_core.retrieval.continuity import Continuity
from tpgmm_core.retrieval.interface import Retrieval, TimeParametrized
from tpgmm_core.retrieval.phase import ClockPhase
from tpgmm_core.retrieval.regression import AdaptThenRegress

_SECOND = 1_000_000_000


class Reproduction(Retrieval):
    """A `Retrieval` that steps through a `TimeParametrized`.

    Parameters
    ----------
    course
        the movement as a function of the model's time; a fitted model with time as its first dimension stands for its
        `AdaptThenRegress`
    phase
        how the model's time advances, for this reproduction alone; None: with the clock
    duration
        how long the movement takes at speed 1, s; None: as demonstrated
    horizon_steps, horizon_time_step
        how many Gaussians ahead each reference holds, and their distance in time, s
    blend_time
        time constant with which a change of the frames takes effect, s

    Raises
    ------
    ValueError
        for a model that was not learned over time, and a time that is not positive
    """

    def __init__(
        self,
        course: TimeParametrized | LearnedMixture,
        *,
        phase: ClockPhase | None = None,
        duration: float | None = None,
        horizon_steps: int = 2,
        horizon_time_step: float = 0.005,
        blend_time: float = 0.15,
    ) -> None:
        self.course: TimeParametrized = AdaptThenRegress(course) if isinstance(course, LearnedMixture) else course
        duration = self.course.duration if duration is None else duration
        for name, value in (
            ("duration", duration),
            ("horizon_time_step", horizon_time_step),
            ("blend_time", blend_time),
        ):
            if not (math.isfinite(value) and value > 0.0):
                raise ValueError(f"{name} is {value!r}; give a positive number of seconds")
        self.phase = ClockPhase() if phase is None else phase
        self.phase.bind(self.course, duration)
        self._horizon_time_step = horizon_time_step if horizon_steps else 0.0
        self._ahead: Array = horizon_time_step * np.arange(1 + horizon_steps, dtype=np.float64)
        self._continuity = Continuity(self.course.manifold, blend_time)
        self._last_ns: int | None = None
        self._situation: Situation | None = None

    @property
    def manifold(self) -> Manifold:
        """Manifold of the references, without time."""
        return self.course.manifold

    @property
    def frame_names(self) -> tuple[str, ...]:
        """The frames that the model was learned from."""
        return self.course.frame_names

    @property
    def duration(self) -> float:
        """Duration of the whole movement at speed 1, s."""
        return self.phase.duration

    @property
    def speed(self) -> float:
        """Speed: 1 as learned, 0 pauses, less than 0 goes back; see `ClockPhase.speed`."""
        return self.phase.speed

    @speed.setter
    def speed(self, speed: float) -> None:
        self.phase.speed = speed

    def start(self, time_ns: int, state: Array | None = None, phase: float = 0.0) -> None:
        """Begin a movement; whatever went on before is forgotten."""
        self.phase.start(time_ns, phase)
        self._last_ns = time_ns
        self._state = state
        self._situation = None
        self._former: Array | None = None
        self._is_free = False
        self._continuity.forget()

    def step(
        self,
        time_ns: int,
        frames: Mapping[str, Frame],
        state: Array | None = None,
        weights: Mapping[str, float] | None = None,
    ) -> Reference:
        """The reference at a time.

        A direction that no frame constrains stays where the robot is, and so follows the state; otherwise the state
        matters to the phase alone.

        Raises
        ------
        ValueError
            before `start`
        """
        if self._last_ns is None:
            raise ValueError("the reproduction has not been started: call start(time_ns)")
        since = max(0.0, (time_ns - self._last_ns) / _SECOND)
        self._last_ns = time_ns
        self._state = self._state if state is None else state
        situation, known = Situation(frames, weights, self._state), self._situation
        if known is None or not (situation == known if self._is_free else situation.has_frames_of(known)):
            means, covariances, activations = self._situate(time_ns, situation)
        else:
            self.phase.advance(time_ns)
            means, covariances, activations = self.course.at(self.phase.times(self._ahead))
        self._continuity.advance(since)
        H = len(self._ahead)
        gaussians = self._continuity.gaussians(means[:H], covariances[:H], self._ahead)
        self._covariance = gaussians[0].covariance
        if state is not None:
            self.phase.observe(gaussians[0], state)
        return Reference(
            phase=self.phase.value,
            gaussian=gaussians[0],
            horizon_time_step=self._horizon_time_step,
            horizon=tuple(gaussians[1:]),
            activations=activations,
            frames=tuple(frames),
        )

    def _situate(self, time_ns: int, situation: Situation) -> tuple[Array, Array, Array]:
        """The movement now and ahead in a new situation, which begins where the last step was.

        Hence this step already belongs to the new situation.
        """
        moments = self._continuity.moments
        if self._situation is not None:
            means, self._former_covariances, _ = self.course.at(self.phase.times(moments))
            self._former = self._continuity.means(means, moments)
            self._situation = None  # a situation that is refused must not be used again
        self.course.situate(situation.frames, situation.state, situation.weights)
        self.phase.situated()
        near = self.phase.times(moments)
        self.phase.advance(time_ns)
        means, covariances, activations = self.course.at(np.concatenate([self.phase.times(self._ahead), near]))
        if self._former is not None:
            first = len(self._ahead)
            self._continuity.take_over(
                self._former, means[first:], self._covariance, covariances[first:], self._former_covariances
            )
        self._situation = situation
        self._is_free = float(covariances[0].max()) > 0.5 * UNCONSTRAINED_VARIANCE
        return means, covariances, activations

    def horizon(self, n: int, dt: float) -> list[Gaussian]:
        """The next n Gaussians, dt (s) apart, if the frames stay."""
        self._require_step()
        ahead = dt * np.arange(1, n + 1, dtype=np.float64)
        means, covariances, _ = self.course.at(self.phase.times(ahead))
        return self._continuity.gaussians(means, covariances, ahead)

    def mixture(self) -> GaussianMixture:
        """The model in the situation of the last step, time first."""
        self._require_step()
        return self.course.mixture()

    def _require_step(self) -> None:
        if self._situation is None:
            raise ValueError("there was no step yet: call start(time_ns) and step(...)")
