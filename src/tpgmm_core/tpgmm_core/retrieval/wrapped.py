# SPDX-License-Identifier: Apache-2.0
"""Bases of movements that change what another one says: by steps, or as a function of time."""

from __future__ import annotations

from collections.abc import Mapping

from tpgmm_core.common.types import Array
from tpgmm_core.geometry.frame import Frame
from tpgmm_core.geometry.gaussian import Gaussian
from tpgmm_core.geometry.manifold import Manifold
from tpgmm_core.geometry.mixture import GaussianMixture
from tpgmm_core.model.reference import Reference
from tpgmm_core.retrieval.interface import Retrieval, TimeParametrized


class Wrapped(Retrieval):
    """A `Retrieval` that is another one in all that a subclass does not change.

    Parameters
    ----------
    retrieval
        the other one
    """

    def __init__(self, retrieval: Retrieval) -> None:
        self._retrieval = retrieval

    @property
    def manifold(self) -> Manifold:
        """Manifold of the references, without time."""
        return self._retrieval.manifold

    @property
    def frame_names(self) -> tuple[str, ...]:
        """The frames that the model was learned from."""
        return self._retrieval.frame_names

    @property
    def duration(self) -> float:
        """Duration of the whole movement at speed 1, s."""
        return self._retrieval.duration

    @property
    def speed(self) -> float:
        """Speed of the movement: see `Retrieval.speed`."""
        return self._retrieval.speed

    @speed.setter
    def speed(self, speed: float) -> None:
        self._retrieval.speed = speed

    def start(self, time_ns: int, state: Array | None = None, phase: float = 0.0) -> None:
        """Begin a movement: see `Retrieval.start`."""
        self._retrieval.start(time_ns, state, phase)

    def step(
        self,
        time_ns: int,
        frames: Mapping[str, Frame],
        state: Array | None = None,
        weights: Mapping[str, float] | None = None,
    ) -> Reference:
        """The reference at a time: see `Retrieval.step`."""
        return self._retrieval.step(time_ns, frames, state, weights)

    def horizon(self, n: int, dt: float) -> list[Gaussian]:
        """The next n Gaussians, dt (s) apart: see `Retrieval.horizon`."""
        return self._retrieval.horizon(n, dt)

    def mixture(self) -> GaussianMixture:
        """The model in the situation of the last step: see `Retrieval.mixture`."""
        return self._retrieval.mixture()


class WrappedTimeParametrized(TimeParametrized):
    """A `TimeParametrized` that is another one in all that a subclass does not change.

    Parameters
    ----------
    course
        the other one; its situation is changed
    """

    def __init__(self, course: TimeParametrized) -> None:
        self._course = course

    @property
    def manifold(self) -> Manifold:
        """Manifold of the data, without time."""
        return self._course.manifold

    @property
    def frame_names(self) -> tuple[str, ...]:
        """The frames that the model was learned from."""
        return self._course.frame_names

    @property
    def duration(self) -> float:
        """Duration of the model's time, s."""
        return self._course.duration

    def situate(
        self, frames: Mapping[str, Frame], state: Array | None = None, weights: Mapping[str, float] | None = None
    ) -> None:
        """Change to this situation: see `TimeParametrized.situate`."""
        self._course.situate(frames, state, weights)

    def at(self, times: Array) -> tuple[Array, Array, Array]:
        """The movement at times (H,), s: see `TimeParametrized.at`."""
        return self._course.at(times)

    def mixture(self) -> GaussianMixture:
        """The model in this situation, over all dimensions that it encodes, as the other one has it."""
        return self._course.mixture()
