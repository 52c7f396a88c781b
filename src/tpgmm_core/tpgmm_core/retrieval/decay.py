# SPDX-License-Identifier: Apache-2.0
"""Dynamical movement primitives in their probabilistic form (end of Section 3; Ijspeert et al. 2013).

A spring-damper is pulled to an attractor, whose path is learned over a decay term s instead of time:

    duration · s' = -decay_rate · s                                            (canonical system, from s = 1)
    duration · z' = stiffness · log_x(attractor(s)) - 2 sqrt(stiffness) · z    (critically damped)
    duration · x' = z

The attractor is the mean of N(attractor | s), by regression on the adapted mixture (Eqs. 5, 6). Frames may move and
the duration change while the movement runs: position and z never jump. On S³ z is a turn about the fixed axes.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from tpgmm_core import quaternion
from tpgmm_core.adaptation import Adapter
from tpgmm_core.demonstration import Demonstration
from tpgmm_core.frame import Frame
from tpgmm_core.gaussian import Gaussian
from tpgmm_core.manifold import Manifold
from tpgmm_core.quaternion import Array
from tpgmm_core.retrieval.differences import derivatives
from tpgmm_core.retrieval.frames import without_time
from tpgmm_core.tpgmm import TPGMM


@dataclass(frozen=True, slots=True, kw_only=True)
class DecayLaw:
    """The numbers that encoding and reproduction have in common.

    decay_rate : s falls to exp(-decay_rate) within the duration
    stiffness : of the spring, per duration²; what is left of an error after the time t is about
        exp(-sqrt(stiffness) t / duration)

    Raises ValueError for numbers that are not positive and finite.
    """

    decay_rate: float = 3.0
    stiffness: float = 400.0

    def __post_init__(self) -> None:
        _positive(decay_rate=self.decay_rate, stiffness=self.stiffness)

    def encode(
        self, demonstration: Demonstration, manifold: str | Manifold = "euclidean", window: int = 9
    ) -> Demonstration:
        """What the attractor did in a demonstration, [s, attractor] in place of [time, data], in the same frames.

        demonstration : data (T, 1 + d): time, then positions or poses; manifold : space of all of data, time included
        window : samples of the parabolas that velocity and acceleration are taken from; at most as many as there are

        The attractor is y = exp_x((z' + 2 sqrt(stiffness) z) / stiffness) with times in units of the duration. Frames
        may move; what the robot did is seen from where they were. A movement that is not at rest at its end has its
        attractor ahead of it, and is reproduced to end there. Raises ValueError for less than three samples, and
        frames that change time.
        """
        space = manifold if isinstance(manifold, Manifold) else Manifold.parse(manifold, demonstration.data.shape[1])
        data_space = space.subset(range(1, space.dim))
        without_time(demonstration.frames)
        times, x = demonstration.times, demonstration.data[:, 1:]
        phase = (times - times[0]) / max(times[-1] - times[0], np.finfo(float).tiny)
        window = min(window, (len(times) - 1) // 2 * 2 + 1)
        z, z_rate = derivatives(phase, x, data_space, window)
        attractor = data_space.exp(x, (z_rate + 2.0 * math.sqrt(self.stiffness) * z) / self.stiffness)
        decay = np.exp(-self.decay_rate * phase)
        return Demonstration(times, np.column_stack([decay, attractor]), demonstration.frames, demonstration.visible)


@dataclass(frozen=True, slots=True)
class DecayStep:
    """Where a decay system is after a step.

    phase : 0 at the start, 1 at the end of the duration, and greater while the spring settles
    position : (D,), a point of the manifold; velocity : (n,), per s, tangent, on S³ about the fixed axes
    attractor : Gaussian of the attractor in the middle of the step, with the covariance that regression gives it
    activations : (K,), of the components there
    """

    phase: float
    position: Array
    velocity: Array
    attractor: Gaussian
    activations: Array


class DecaySystem:
    """Reproduces a model of the attractor over the decay term.

    model : fitted to what `law.encode` returns; init="bins" of `TPGMM` suits, since s is not even in time
    duration : of the movement, s; may be set at any time. The path stays the same, and the velocity changes at once
    position : (D,), where to start; velocity : (n,), per s, at rest where None

    After the duration s stays where demonstrations ended, so that the system converges to `goal`, whatever happened
    before. Raises ValueError for a model without s, a position that is not on its manifold, and a duration that is not
    positive.
    """

    _duration: float
    _position: Array
    _z: Array

    def __init__(
        self, model: TPGMM, law: DecayLaw, duration: float, position: ArrayLike, velocity: ArrayLike | None = None
    ) -> None:
        if model.manifold_.factors[0][0] != "R" or model.manifold_.tangent_dim < 2:
            raise ValueError(f"the first dimension of the model is the decay term, then others; got {model.manifold_}")
        self.law = law
        self.manifold = model.manifold_.subset(range(1, model.manifold_.dim))
        self._adapter = Adapter(model)
        self.duration = duration
        self._phase = 0.0
        self._set_state(position, np.zeros(self.manifold.tangent_dim) if velocity is None else velocity)

    @property
    def duration(self) -> float:
        """s."""
        return self._duration

    @duration.setter
    def duration(self, duration: float) -> None:
        _positive(duration=duration)
        self._duration = float(duration)

    @property
    def phase(self) -> float:
        """0 at the start, 1 after the duration."""
        return self._phase

    def goal(self, frames: Mapping[str, Frame], weights: Mapping[str, float] | None = None) -> Gaussian:
        """Where the movement ends in a situation: the attractor at the end of s. Parameters as for `step`."""
        return self._attractor(math.exp(-self.law.decay_rate), frames, weights)[0]

    def step(
        self,
        dt: float,
        frames: Mapping[str, Frame],
        state: tuple[ArrayLike, ArrayLike] | None = None,
        weights: Mapping[str, float] | None = None,
    ) -> DecayStep:
        """Go on by dt (s), towards the attractor in the situation as it is now.

        frames : over [s, data] (`Frame.with_time`), at least one of the model's
        state : position (D,) and velocity (n,) per s of the robot, to go on from; from the last step where None
        weights : how far each frame is trusted, 0 to 1; fully where not named

        The spring is solved exactly for an attractor that stays during the step (on S³ in the tangent space at the
        position), hence stable for any dt. Raises ValueError like `Adapter.adapt`, and for numbers that do not fit.
        """
        _positive(dt=dt)
        if state is not None:
            self._set_state(*state)
        step = dt / self._duration
        decay = math.exp(-self.law.decay_rate * min(self._phase + 0.5 * step, 1.0))
        attractor, activations = self._attractor(decay, frames, weights)
        rate = math.sqrt(self.law.stiffness)
        error = self.manifold.log(attractor.mean, self._position)
        # On S³ both ends of a geodesic see it as the same turn about the fixed axes
        slope = self._z + rate * error
        left = math.exp(-rate * step)
        moved = left * (error + step * slope) - error
        self._position = self.manifold.exp(self._position, moved)
        self._z = left * (self._z - rate * step * slope)
        self._phase += step
        return DecayStep(self._phase, self._position.copy(), self._z / self._duration, attractor, activations)

    def _attractor(
        self, decay: float, frames: Mapping[str, Frame], weights: Mapping[str, float] | None
    ) -> tuple[Gaussian, Array]:
        """Gaussian of the attractor at s = decay, and the components' activations; free directions stay where it is."""
        without_time(frames)
        here = np.concatenate([[decay], self._position])
        means, covariances, activations = self._adapter.adapt_and_condition(frames, [decay], weights, here)
        return Gaussian(means[0], 0.5 * (covariances[0] + covariances[0].T), self.manifold), activations

    def _set_state(self, position: ArrayLike, velocity: ArrayLike) -> None:
        position, velocity = np.array(position, dtype=float), np.array(velocity, dtype=float)
        n = self.manifold.tangent_dim
        if position.shape != (self.manifold.dim,) or velocity.shape != (n,):
            raise ValueError(
                f"the state on {self.manifold} has a position ({self.manifold.dim},) and a velocity ({n},), "
                f"got {position.shape} and {velocity.shape}"
            )
        if not (np.all(np.isfinite(position)) and np.all(np.isfinite(velocity))):
            raise ValueError(f"the state must be finite, got {position} and {velocity}")
        for s in self.manifold.spheres:
            position[s.ambient] = quaternion.normalize(position[s.ambient])
        self._position = position
        self._z = self._duration * velocity


def _positive(**values: float) -> None:
    for name, value in values.items():
        if not (isinstance(value, int | float) and math.isfinite(value) and value > 0.0):
            raise ValueError(f"{name} is a positive number, got {value!r}")
