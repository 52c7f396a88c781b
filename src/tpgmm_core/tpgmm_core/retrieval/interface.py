# SPDX-License-Identifier: Apache-2.0
"""What all methods of retrieving a movement have in common, as a loop uses them.

`Retrieval` is the interface of the loop: a reference for each step. Methods that know the whole movement as a function
of time in a situation are `TimeParametrized`; `retrieval.reproduction.Reproduction` steps through any of them, on any
phase, and keeps what it hands on free of jumps. Methods that have a state of their own are a `Retrieval` themselves.

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
from tpgmm_core.learning.tpgmm import TPGMM
from tpgmm_core.model.reference import Reference


class Retrieval(Protocol):
    """A movement that is being reproduced.

    Parameters
    ----------
    manifold
        of the references, without time
    frame_names
        the frames that the model was learned from
    duration
        of the whole movement at speed 1, s
    speed
        1 as learned, 0 pauses, less than 0 goes back; may be set at any time, and is taken over without a jump. Setting
        raises ValueError for a speed that is not finite or that this method cannot go
    """

    @property
    def manifold(self) -> Manifold: ...

    @property
    def frame_names(self) -> tuple[str, ...]: ...

    @property
    def duration(self) -> float: ...

    @property
    def speed(self) -> float: ...

    @speed.setter
    def speed(self, speed: float) -> None: ...

    def start(self, time_ns: int, state: Array | None = None, phase: float = 0.0) -> None:
        """Begin at this time, ns, from where the robot is (D,); what was going on is forgotten.

        Parameters
        ----------
        phase
            share of the movement that is done already, 0 to 1: where to go on when another method, or another model,
            takes over while the robot moves. What is handed on then is kept without a jump by
            `tpgmm_core.retrieval.continuity.Continued`, for all methods alike
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
            on the clock that `start` was given
        frames
            those that are known, by name, at least one. What counts as a change is another value: see
            `tpgmm_core.model.situation.Situation`
        state
            (D,), where the robot is, as far as that is known
        weights
            how far each frame is trusted, 0 to 1; fully where not named

        Raises
        ------
        ValueError
            for no frames, unknown ones, or when `start` was never called
        """

    def horizon(self, n: int, dt: float) -> list[Gaussian]:
        """The next n Gaussians, dt (s) apart, the first one dt after the last step, should the frames stay.

        Raises
        ------
        ValueError
            when there was no step yet
        """

    def mixture(self) -> GaussianMixture:
        """The model in the situation of the last step, over all that it encodes.

        Raises
        ------
        ValueError
            when there was no step yet
        """


class TimeParametrized(Protocol):
    """A movement as a function of the model's time, in one situation.

    Parameters
    ----------
    manifold
        of the data, without time
    frame_names
        the frames that the model was learned from
    duration
        of the model's time, s
    """

    @property
    def manifold(self) -> Manifold: ...

    @property
    def frame_names(self) -> tuple[str, ...]: ...

    @property
    def duration(self) -> float: ...

    def situate(
        self,
        frames: Mapping[str, Frame],
        state: Array | None = None,
        weights: Mapping[str, float] | None = None,
    ) -> None:
        """Take this situation; parameters and errors are those of `Retrieval.step`."""

    def at(self, times: Array) -> tuple[Array, Array, Array]:
        """Means (H, D), covariances (H, n, n), and the activations (K,) at the first of the model's times (H,), s."""

    def mixture(self) -> GaussianMixture:
        """The model in this situation, over all that it encodes."""


def demonstrated_duration(model: TPGMM) -> float:
    """How long the demonstrations of a model took on average, s.

    Raises
    ------
    ValueError
        when the model's metadata do not say
    """
    duration = model.metadata_.get("duration_s")
    if not isinstance(duration, int | float) or not duration > 0.0:
        raise ValueError(
            f"the model's metadata say duration_s = {shown(duration)}; expected the demonstrations' mean duration in "
            "s: a model that is to be reproduced over time is trained by 'train'"
        )
    return float(duration)
