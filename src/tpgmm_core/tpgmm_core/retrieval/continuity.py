# SPDX-License-Identifier: Apache-2.0
"""References that go on without a jump, although what they come from has become another one at once.

The difference between where the reference was going and where it is to go now is kept as an *offset* that dies out as
a critically damped spring does, continuous in velocity. The former covariance is faded out beside it: covariances form
a convex cone, which weighted means never leave. Once both are gone, the reference is exactly what the course says.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from tpgmm_core.frame import Frame
from tpgmm_core.frame_buffer import manifold_origin
from tpgmm_core.gaussian import Gaussian
from tpgmm_core.manifold import Manifold
from tpgmm_core.mixture import GaussianMixture
from tpgmm_core.quaternion import Array
from tpgmm_core.reference import Reference
from tpgmm_core.retrieval.interface import Retrieval

#: Two moments this far apart, s, tell the velocity of a reference. Short, so that a controller which takes the velocity
#: from a horizon of such steps sees what is kept continuous here.
MOMENT = 0.005
NEGLIGIBLE = 1e-13  # offsets (m, rad) that rounding hides
_SECOND = 1_000_000_000


class Continuity:
    """What is left, at present, of a reference's former course.

    manifold : of the references
    time_constant : with which it dies out, s
    """

    def __init__(self, manifold: Manifold, time_constant: float) -> None:
        self.manifold = manifold
        self.time_constant = time_constant
        self.forget()
        origin = manifold_origin(manifold)
        manifold.exp(origin, manifold.log(origin, origin))  # compiled, or loaded from the cache

    def forget(self) -> None:
        """Nothing of it is left."""
        self._offset = np.zeros(self.manifold.tangent_dim)
        self._rate = np.zeros(self.manifold.tangent_dim)
        self._covariance: Array | None = None
        self._share = 0.0
        self._is_gone = True

    def take_over(self, former: Sequence[Array], means: Sequence[Array], covariance: Array) -> None:
        """Go on as before, in place and velocity.

        former : where the reference would have been, two points (D,): now, and MOMENT later
        means : where the course has it now, at the same times
        covariance : (n, n), of the last reference
        """
        here, ahead = (self.manifold.log(mean, one) for mean, one in zip(means, former, strict=True))
        rate = 1.0 / self.time_constant
        self._offset = here
        self._rate = (math.exp(rate * MOMENT) * ahead - here) / MOMENT - rate * here
        self._covariance, self._share = covariance, 1.0
        self._is_gone = False

    def advance(self, seconds: float) -> None:
        """Let time pass."""
        if not self._is_gone and seconds > 0.0:
            self._offset, self._rate = self._after(seconds)
            self._share *= math.exp(-seconds / self.time_constant)
            if self._share < NEGLIGIBLE:
                left = np.abs(self._offset).max() + self.time_constant * np.abs(self._rate).max()
                if left < NEGLIGIBLE:
                    self.forget()

    def mean(self, mean: Array, ahead: float = 0.0) -> Array:
        """Where the reference is, (D,), where the course says `mean`; both so many seconds ahead."""
        if self._is_gone:
            return mean
        return self.manifold.exp(mean, self._after(ahead)[0] if ahead > 0.0 else self._offset)

    def covariance(self, covariance: Array, ahead: float = 0.0) -> Array:
        """Covariance (n, n) of the reference where the course says `covariance`."""
        if self._covariance is None:
            return covariance
        share = self._share * math.exp(-ahead / self.time_constant)
        return covariance + share * (self._covariance - covariance)

    def gaussian(self, mean: Array, covariance: Array, ahead: float = 0.0) -> Gaussian:
        """Both."""
        return Gaussian(self.mean(mean, ahead), self.covariance(covariance, ahead), self.manifold)

    def _after(self, seconds: float) -> tuple[Array, Array]:
        """Offset and its rate after a time: the exact solution of the critically damped spring."""
        rate = 1.0 / self.time_constant
        slope = self._rate + rate * self._offset
        decay = math.exp(-rate * seconds)
        return decay * (self._offset + seconds * slope), decay * (self._rate - rate * seconds * slope)


class Continued:
    """A `Retrieval` that takes over from another one while the robot moves, whatever both are.

    retrieval : the new one, started
    former, former_ns : the last reference of the former one, and its time, ns
    time_constant : with which the difference dies out, s

    Raises ValueError when the references are on different manifolds.
    """

    def __init__(self, retrieval: Retrieval, former: Reference, former_ns: int, time_constant: float) -> None:
        manifold = retrieval.manifold
        if manifold != former.gaussian.manifold:
            raise ValueError(
                f"what is to take over is on {manifold}, the movement on {former.gaussian.manifold}: "
                "load a model of the same dimensions, or end the movement first"
            )
        self._retrieval = retrieval
        self._continuity = Continuity(manifold, time_constant)
        self._former: Reference | None = former
        self._last_ns = former_ns

    @property
    def manifold(self) -> Manifold:
        return self._retrieval.manifold

    @property
    def frame_names(self) -> tuple[str, ...]:
        return self._retrieval.frame_names

    @property
    def duration(self) -> float:
        return self._retrieval.duration

    @property
    def speed(self) -> float:
        return self._retrieval.speed

    @speed.setter
    def speed(self, speed: float) -> None:
        self._retrieval.speed = speed

    def start(self, time_ns: int, state: Array | None = None, phase: float = 0.0) -> None:
        self._continuity.forget()
        self._former = None
        self._retrieval.start(time_ns, state, phase)

    def step(
        self,
        time_ns: int,
        frames: Mapping[str, Frame],
        state: Array | None = None,
        weights: Mapping[str, float] | None = None,
    ) -> Reference:
        reference = self._retrieval.step(time_ns, frames, state, weights)
        since = max(0.0, (time_ns - self._last_ns) / _SECOND)
        self._last_ns = time_ns
        if self._former is None:
            self._continuity.advance(since)
        else:
            self._take_over(self._former, reference, since)
            self._former = None
        dt, present = reference.horizon_time_step, reference.gaussian
        return replace(
            reference,
            gaussian=self._continuity.gaussian(present.mean, present.covariance),
            horizon=tuple(
                self._continuity.gaussian(g.mean, g.covariance, dt * i)
                for i, g in enumerate(reference.horizon, start=1)
            ),
        )

    def _take_over(self, former: Reference, reference: Reference, since: float) -> None:
        """From where the former reference would be by now, with the velocity that it had."""
        velocity, start = former.velocity(), former.gaussian.mean
        paths = [self.manifold.exp(start, (since + ahead) * velocity) for ahead in (0.0, MOMENT)]
        means = [reference.gaussian.mean, self._retrieval.horizon(1, MOMENT)[0].mean]
        self._continuity.take_over(paths, means, former.gaussian.covariance)

    def horizon(self, n: int, dt: float) -> list[Gaussian]:
        ahead = self._retrieval.horizon(n, dt)
        return [self._continuity.gaussian(g.mean, g.covariance, dt * i) for i, g in enumerate(ahead, start=1)]

    def mixture(self) -> GaussianMixture:
        return self._retrieval.mixture()
