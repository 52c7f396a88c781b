# SPDX-License-Identifier: Apache-2.0
"""`Continued`: another movement takes over while the robot moves, without a jump."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

from tpgmm_core.common.types import Array
from tpgmm_core.geometry.frame import Frame
from tpgmm_core.geometry.gaussian import Gaussian
from tpgmm_core.model.reference import Reference
from tpgmm_core.retrieval.continuity import MOMENT, Continuity
from tpgmm_core.retrieval.interface import Retrieval
from tpgmm_core.retrieval.wrapped import Wrapped

_SECOND = 1_000_000_000


class Continued(Wrapped):
    """A `Retrieval` that continues from another one while the robot moves, whatever methods both are.

    Parameters
    ----------
    retrieval
        the new one, started
    former, former_ns
        the last reference of the former one, and its time, ns
    time_constant
        with which the difference dies out, s

    Raises
    ------
    ValueError
        when the references are on different manifolds
    """

    def __init__(self, retrieval: Retrieval, former: Reference, former_ns: int, time_constant: float) -> None:
        manifold = retrieval.manifold
        if manifold != former.gaussian.manifold:
            raise ValueError(
                f"the new retrieval is on {manifold}, the movement on {former.gaussian.manifold}: "
                "load a model of the same dimensions, or end the movement first"
            )
        super().__init__(retrieval)
        self._continuity = Continuity(manifold, time_constant)
        self._former: Reference | None = former
        self._last_ns = former_ns

    def start(self, time_ns: int, state: Array | None = None, phase: float = 0.0) -> None:
        """Start the new retrieval afresh: the former one no longer matters."""
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
        """The reference of the new retrieval, with what remains of the difference to the former one."""
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
        """Continue from where the former reference would be by now, with the velocity that it had."""
        velocity, start = former.velocity(), former.gaussian.mean
        paths = [self.manifold.exp(start, (since + ahead) * velocity) for ahead in (0.0, MOMENT)]
        means = [reference.gaussian.mean, self._retrieval.horizon(1, MOMENT)[0].mean]
        self._continuity.take_over(paths, means, former.gaussian.covariance, reference.gaussian.covariance[None])

    def horizon(self, n: int, dt: float) -> list[Gaussian]:
        """The next n Gaussians, dt (s) apart, with what will remain of the difference then."""
        ahead = self._retrieval.horizon(n, dt)
        return [self._continuity.gaussian(g.mean, g.covariance, dt * i) for i, g in enumerate(ahead, start=1)]
