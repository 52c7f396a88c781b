# SPDX-License-Identifier: Apache-2.0
"""The common interface of all retrieval methods.

A control loop uses `Retrieval`: a reference for each step. Methods that know the whole movement as a function
of time in a situation are `TimeParametrized`; `retrieval.reproduction.Reproduction` steps through any of them, on any
phase, and keeps its references free of jumps. Methods that have a state of their own implement `Retrieval` themselves.

Frames are over [time, data] (`Frame.with_time`) for all methods, so that one situation serves all; a state is (D,), a
point of the data's manifold, without time.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Protocol

from tpgmm_core.common.text import shown
from tpgmm_core.common.types import Array
from tpgmm_core.geometry.frame import Frame
from tpgmm_core.geometry.gaussian import Gaussian
from tpgmm_core.geometry.manifold import Manifold
from tpgmm_core.geometry.mixture import GaussianMixture
from tpgmm_core.learning.learned_mixture import LearnedMixture
from tpgmm_core.model.reference import Reference


class Retrieval(Protocol):
    """A movement that is being reproduced."""

    @property
    def manifold(self) -> Manifold:
        """Manifold of the references, without time."""

    @property
    def frame_names(self) -> tuple[str, ...]:
        """The frames that the model was learned from."""

    @property
    def duration(self) -> float:
        """Duration of the whole movement at speed 1, s."""

    @property
    def speed(self) -> float:
        """Speed of the movement: 1 as learned, 0 pauses, less than 0 goes back.

        It may be set at any time, and changes without a jump. Setting raises ValueError for a speed that is not finite
        or that this method cannot go at.
        """

    @speed.setter
    def speed(self, speed: float) -> None: ...

    def start(self, time_ns: int, state: Array | None = None, phase: float = 0.0) -> None:
        """Begin a movement; whatever went on before is forgotten.

        Parameters
        ----------
        time_ns
            of the beginning, ns
        state
            (D,), where the robot is; None where not known
        phase
            share of the movement that is already done, 0 to 1: where to continue when another method, or another model,
            takes over while the robot moves. `tpgmm_core.retrieval.continued.Continued` then keeps the references free
            of jumps, for all methods alike
        """

    def step(
        self,
        time_ns: int,
        frames: Mapping[str, Frame],
        state: Array | None = None,
        weights: Mapping[str, float] | None = None,
    ) -> Reference:
        """The reference at a time.

        Parameters
        ----------
        time_ns
            now, ns, on the clock of `start`
        frames
            those that are known, by name, at least one. Only different values are a change: see
            `tpgmm_core.model.situation.Situation`
        state
            (D,), where the robot is; None where not known
        weights
            how far each frame is trusted, 0 to 1; 1 where not named

        Returns
        -------
        Reference
            where to be, how exactly, and what comes next

        Raises
        ------
        ValueError
            for no frames, unknown ones, or when `start` was never called
        """

    def horizon(self, n: int, dt: float) -> list[Gaussian]:
        """The next Gaussians, if the frames stay.

        Parameters
        ----------
        n
            number of Gaussians
        dt
            distance in time, s; the first one is dt after the last step

        Returns
        -------
        list[Gaussian]
            n of them, or fewer where the movement does not know further

        Raises
        ------
        ValueError
            when there was no step yet
        """

    def mixture(self) -> GaussianMixture:
        """The model in the situation of the last step, over all dimensions that it encodes.

        Returns
        -------
        GaussianMixture
            over all dimensions that the model encodes

        Raises
        ------
        ValueError
            when there was no step yet
        """


class TimeParametrized(Protocol):
    """A movement as a function of the model's time, in one situation."""

    @property
    def manifold(self) -> Manifold:
        """Manifold of the data, without time."""

    @property
    def frame_names(self) -> tuple[str, ...]:
        """The frames that the model was learned from."""

    @property
    def duration(self) -> float:
        """Duration of the model's time, s."""

    def situate(
        self,
        frames: Mapping[str, Frame],
        state: Array | None = None,
        weights: Mapping[str, float] | None = None,
    ) -> None:
        """Change to this situation.

        Parameters
        ----------
        frames
            over [time, data] (`Frame.with_time`), at least one of the model's
        state
            (D,), where the robot is: what no frame constrains stays there; the origin where None
        weights
            how far each frame is trusted, 0 to 1; 1 where not named

        Raises
        ------
        ValueError
            like `Adapter.adapt`, and for frames that change time
        """

    def at(self, times: Array) -> tuple[Array, Array, Array]:
        """The movement at some of the model's times.

        Parameters
        ----------
        times
            (H,), s

        Returns
        -------
        tuple[Array, Array, Array]
            means (H, D), covariances (H, n, n), and the activations (K,) at the first of the times
        """

    def mixture(self) -> GaussianMixture:
        """The model in this situation, over all dimensions that it encodes."""


def demonstrated_duration(model: LearnedMixture) -> float:
    """Mean duration of the demonstrations of a model, s.

    Parameters
    ----------
    model
        with metadata

    Returns
    -------
    float
        s

    Raises
    ------
    ValueError
        when the model's metadata do not hold it
    """
    duration = model.metadata_.get("duration_s")
    if not isinstance(duration, int | float) or not duration > 0.0:
        raise ValueError(
            f"the model's metadata say duration_s = {shown(duration)}; expected the demonstrations' mean duration in "
            "s, which 'train' writes into each model"
        )
    return float(duration)
