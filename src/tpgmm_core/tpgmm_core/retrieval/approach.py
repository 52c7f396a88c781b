# SPDX-License-Identifier: Apache-2.0
"""`Approach`: a movement whose beginning the reference goes to first, slowly, whatever its method is."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from tpgmm_core.common.blending import minimum_jerk
from tpgmm_core.common.types import Array
from tpgmm_core.geometry.frame import Frame
from tpgmm_core.geometry.gaussian import Gaussian
from tpgmm_core.geometry.manifold import Manifold
from tpgmm_core.model.reference import Reference
from tpgmm_core.retrieval.interface import Retrieval
from tpgmm_core.retrieval.wrapped import Wrapped

_SECOND = 1_000_000_000
PEAK = 1.875
"""Of a movement of least jerk from rest to rest: its largest speed over its mean speed (Flash and Hogan 1985)."""


def way_time(manifold: Manifold, apart: Array, speed: float, rate: float) -> float:
    """Distance over the largest speed: what the way would take at least, s.

    Parameters
    ----------
    manifold
        of the references
    apart
        (n,), tangent vector
    speed
        at most, of places, m/s
    rate
        at most, of orientations and of movements of joints, rad/s

    Returns
    -------
    float
        s
    """
    places = np.zeros(0, dtype=np.intp) if manifold.is_euclidean else np.asarray(manifold.flat_tangent)
    others = np.setdiff1d(np.arange(manifold.tangent_dim), places)
    return max(float(np.linalg.norm(apart[places])) / speed, float(np.linalg.norm(apart[others])) / rate)


class Approach(Wrapped):
    """A `Retrieval` that waits at its beginning, while the reference comes there on a path of least jerk.

    It waits at speed 0, and gets its speed then, as a change of speed is taken over.

    Parameters
    ----------
    retrieval
        the movement
    start_ns
        when the way begins, ns
    seconds
        how long it takes, s
    apart
        (n,), tangent vector from the movement's beginning to where the reference is
    state
        as for `Retrieval.start`
    """

    def __init__(
        self, retrieval: Retrieval, start_ns: int, seconds: float, apart: Array, state: Array | None = None
    ) -> None:
        super().__init__(retrieval)
        self._apart, self._seconds, self._start_ns = apart, seconds, start_ns
        self._asked, self._waits, self._passed = retrieval.speed, True, 0.0
        retrieval.speed = 0.0
        retrieval.start(start_ns, state)

    @property
    def speed(self) -> float:
        """That of the movement once it has begun: see `Retrieval.speed`."""
        return self._asked if self._waits else self._retrieval.speed

    @speed.setter
    def speed(self, speed: float) -> None:
        self._retrieval.speed = speed  # which refuses what it cannot go
        if self._waits:
            self._asked, self._retrieval.speed = speed, 0.0

    def start(self, time_ns: int, state: Array | None = None, phase: float = 0.0) -> None:
        """Start the movement afresh, without a way to it: see `Retrieval.start`."""
        self._go()
        self._retrieval.start(time_ns, state, phase)

    def _go(self) -> None:
        self._waits = False
        self._retrieval.speed = self._asked

    def _left(self, ahead: float, g: Gaussian) -> Gaussian:
        """A Gaussian of the movement, moved by what is left of the way a time ahead, s."""
        left = 1.0 - minimum_jerk((self._passed + ahead) / self._seconds)
        return g if left == 0.0 else replace(g, mean=self.manifold.exp(g.mean, left * self._apart))

    def step(
        self,
        time_ns: int,
        frames: Mapping[str, Frame],
        state: Array | None = None,
        weights: Mapping[str, float] | None = None,
    ) -> Reference:
        """The reference at a time, on the way or of the movement: see `Retrieval.step`."""
        if self._waits:
            self._passed = max(0.0, (time_ns - self._start_ns) / _SECOND)
            if self._passed >= self._seconds:
                self._go()
        reference = self._retrieval.step(time_ns, frames, state, weights)
        if not self._waits:
            return reference
        dt = reference.horizon_time_step
        ahead = tuple(self._left(dt * i, g) for i, g in enumerate(reference.horizon, start=1))
        return replace(reference, gaussian=self._left(0.0, reference.gaussian), horizon=ahead)

    def horizon(self, n: int, dt: float) -> list[Gaussian]:
        """The next n Gaussians, dt (s) apart: see `Retrieval.horizon`."""
        ahead = self._retrieval.horizon(n, dt)
        return [self._left(dt * i, g) for i, g in enumerate(ahead, start=1)] if self._waits else ahead
