# SPDX-License-Identifier: Apache-2.0
"""A learned movement, step by step: where to be and how much it matters, for the frames as they are right now.

Frames move, disappear and come back while the movement runs, and each time the adapted mixture is another one at once.
What is handed on must not jump: the difference between the movement as it was and as it is now is taken over as an
*offset* that dies out as a critically damped spring does, with continuous velocity. While the frames stay, the mean is
exactly what the model says; the covariance follows the model with the same time constant.
"""

from __future__ import annotations

import math
from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from tpgmm_core.adaptation import Adapter
from tpgmm_core.frame import Frame
from tpgmm_core.gaussian import Gaussian
from tpgmm_core.manifold import Manifold
from tpgmm_core.mixture import GaussianMixture
from tpgmm_core.reference import Reference
from tpgmm_core.tpgmm import TPGMM

Array = NDArray[np.float64]
_SECOND = 1_000_000_000
#: Now and a moment later, s: what tells the velocity of a reference. Short, so that a controller which takes the
#: velocity from a horizon of such steps sees what is kept continuous here.
_NEAR: Array = np.array([0.0, 0.005])


class Reproduction:
    """Reproduces a model whose first dimension is time, by regression on the adapted mixture (Eqs. 5, 6, GMR).

    Args:
        model: a fitted model; its first dimension is time in s.
        duration: how long the movement is to take, s; as demonstrated where None.
        horizon_steps: how many Gaussians ahead each reference holds.
        horizon_time_step: their distance in time, s.
        blend_time: time constant with which a change of the frames is taken over, s.

    Raises:
        ValueError: a model that was not learned over time, or a time that is not positive.
    """

    def __init__(
        self,
        model: TPGMM,
        *,
        duration: float | None = None,
        horizon_steps: int = 2,
        horizon_time_step: float = 0.005,
        blend_time: float = 0.15,
    ) -> None:
        self.model_duration = demonstrated_duration(model)
        self.duration = self.model_duration if duration is None else duration
        for name, value in (
            ("duration", self.duration),
            ("horizon_time_step", horizon_time_step),
            ("blend_time", blend_time),
        ):
            if not (math.isfinite(value) and value > 0.0):
                raise ValueError(f"{name} is {value!r}; give a positive number of seconds")
        self.model = model
        self.manifold: Manifold = model.manifold_.subset(range(1, model.manifold_.dim))
        self._adapter = Adapter(model)
        self._horizon_time_step = horizon_time_step if horizon_steps else 0.0
        self._ahead: Array = horizon_time_step * np.arange(1 + horizon_steps, dtype=np.float64)
        self._blend_time = blend_time
        self._start_ns: int | None = None
        self._compile()

    def _compile(self) -> None:
        """Two steps with a change of frames, so that no later one waits for the compiler."""
        D = self.model.manifold_.dim
        self.start(0)
        for _ in range(2):
            self.step(0, {name: Frame(np.eye(D), np.zeros(D)) for name in self.model.frame_names_})
        self._start_ns = None

    def start(self, time_ns: int) -> None:
        """Begin at this time, ns; whatever was going on is forgotten."""
        self._start_ns = time_ns
        self._last_ns = time_ns
        self._frames: Mapping[str, Frame] | None = None
        self._weights: Mapping[str, float] | None = None
        self._offset = np.zeros(self.manifold.tangent_dim)
        self._offset_rate = np.zeros(self.manifold.tangent_dim)
        self._covariance: Array | None = None

    def step(
        self,
        time_ns: int,
        frames: Mapping[str, Frame],
        weights: Mapping[str, float] | None = None,
        state: Array | None = None,
    ) -> Reference:
        """The reference at a time.

        Args:
            time_ns: the time, ns, on the clock that ``start`` was given.
            frames: the frames that are known, by name, with the model's dimensions (``Frame.with_time``). Pass the same
                mapping as long as nothing has changed: a new one is taken as a change.
            weights: how far each frame is trusted, 0..1; fully where not named.
            state: (D,), where the robot is; what no frame constrains stays there.

        Raises:
            ValueError: no frames, unknown ones, or ``start`` was never called.
        """
        if self._start_ns is None:
            raise ValueError("the reproduction has not been started: call start(time_ns)")
        elapsed = max(0.0, (time_ns - self._start_ns) / _SECOND)
        since = max(0.0, (time_ns - self._last_ns) / _SECOND)
        self._last_ns = time_ns
        phase = min(1.0, elapsed / self.duration)
        times = self._model_times(elapsed + self._ahead)
        if state is None and frames is self._frames and weights is self._weights:
            means, covariances, activations = self._adapter.condition(times)
        else:
            # The new course begins where the last step was, so that this step is already on it.
            near = self._model_times(max(0.0, elapsed - since) + _NEAR)
            former = self._former_means(near)
            means, covariances, activations = self._adapter.adapt_and_condition(frames, times, weights, state)
            self._take_over(former, near)
            self._frames, self._weights = frames, weights
        self._offset, self._offset_rate = self._offset_after(since)
        covariance = self._blend_covariance(covariances[0], since)
        gaussians = [
            Gaussian(self.manifold.exp(mean, self._offset_after(ahead)[0]), cov, self.manifold)
            for mean, cov, ahead in zip(means, [covariance, *covariances[1:]], self._ahead, strict=True)
        ]
        return Reference(
            phase=phase,
            gaussian=gaussians[0],
            horizon_time_step=self._horizon_time_step,
            horizon=tuple(gaussians[1:]),
            activations=activations,
            frames=tuple(frames),
        )

    def mixture(self) -> GaussianMixture:
        """The model adapted to the frames of the last step, over all dimensions, time first.

        Raises:
            ValueError: there was no step since ``start``.
        """
        if self._start_ns is None or self._frames is None:
            raise ValueError("there was no step yet: call start(time_ns) and step(...)")
        return self._adapter.adapt(self._frames, weights=self._weights)

    def _model_times(self, elapsed: Array) -> Array:
        """Times of the model, s, from those of the reproduction; the end lasts."""
        return np.minimum(elapsed / self.duration, 1.0) * self.model_duration

    def _former_means(self, times: Array) -> list[Array]:
        """Where the frames of the last step had the reference, at two times from then on; nothing at the first step."""
        if self._frames is None:
            return []
        means = self._adapter.condition(times)[0]
        return [self.manifold.exp(mean, self._offset_after(ahead)[0]) for mean, ahead in zip(means, _NEAR, strict=True)]

    def _take_over(self, former: list[Array], times: Array) -> None:
        """Let the offset begin such that the reference goes on as the former frames had it, in place and velocity."""
        if former:
            means = self._adapter.condition(times)[0]
            here, ahead = (self.manifold.log(mean, one) for mean, one in zip(means, former, strict=True))
            rate, moment = 1.0 / self._blend_time, float(_NEAR[1])
            self._offset = here
            self._offset_rate = (math.exp(rate * moment) * ahead - here) / moment - rate * here

    def _offset_after(self, seconds: float) -> tuple[Array, Array]:
        """Offset and its rate after a time: the exact solution of the critically damped spring."""
        rate = 1.0 / self._blend_time
        slope = self._offset_rate + rate * self._offset
        decay = math.exp(-rate * seconds)
        return decay * (self._offset + seconds * slope), decay * (self._offset_rate - rate * seconds * slope)

    def _blend_covariance(self, covariance: Array, seconds: float) -> Array:
        """Covariances form a convex cone: a first-order low-pass never leaves it."""
        if self._covariance is None:
            self._covariance = covariance.copy()
        else:
            share = 1.0 - math.exp(-seconds / self._blend_time)
            self._covariance = self._covariance + share * (covariance - self._covariance)
        return self._covariance


def demonstrated_duration(model: TPGMM) -> float:
    """How long the demonstrations of a model took on average, s.

    Raises:
        ValueError: the model's metadata do not say.
    """
    duration = model.metadata_.get("duration_s")
    if not isinstance(duration, int | float) or not duration > 0.0:
        raise ValueError(
            f"the model's metadata say duration_s = {duration!r}; expected the demonstrations' mean duration in s: "
            "a model that is to be reproduced over time is trained by 'train'"
        )
    return float(duration)
