# SPDX-License-Identifier: Apache-2.0
"""Dynamic movement primitives in their probabilistic form (end of Section 3; Ijspeert et al. 2013).

A spring-damper is pulled to an attractor, whose path is learned over a decay term s instead of time:

    duration · s' = -decay_rate · s                                            (canonical system, from s = 1)
    duration · z' = stiffness · log_x(attractor(s)) - 2 sqrt(stiffness) · z    (critically damped)
    duration · x' = z

The attractor is the mean of N(attractor | s), by regression on the adapted mixture (Eqs. 5, 6). Towards the end the
goal takes its place: the point where demonstrations ended, as seen from the frames (`EndpointTPGMM`), so that the
movement ends there however many components the mixture has. Frames may move and the duration may change while the
movement runs: position and velocity never jump. On S³ z is a turn about the fixed axes.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from tpgmm_core.common.blending import smoothstep
from tpgmm_core.common.types import Array
from tpgmm_core.geometry.frame import Frame
from tpgmm_core.geometry.gaussian import Gaussian
from tpgmm_core.geometry.manifold import Manifold
from tpgmm_core.geometry.mixture import GaussianMixture
from tpgmm_core.learning.endpoints import BEGIN, END, EndpointTPGMM
from tpgmm_core.model.adaptation import Adapter
from tpgmm_core.model.demonstration import Demonstration
from tpgmm_core.model.situation import Situation
from tpgmm_core.retrieval.attractor_system import AttractorSystem, positive
from tpgmm_core.retrieval.differences import derivatives
from tpgmm_core.retrieval.frames import require_time_kept, without_time
from tpgmm_core.retrieval.spring import critically_damped

LONGEST_STEP = 0.005
"""Step of the attractor along its path, in durations; at most MAX_STEPS are made at once, else longer ones."""
MAX_STEPS = 200


@dataclass(frozen=True, slots=True, kw_only=True)
class DmpParameters:
    """The numbers that encoding and reproduction share.

    Parameters
    ----------
    decay_rate
        s falls to exp(-decay_rate) within the duration
    stiffness
        of the spring, per duration²; the share exp(-sqrt(stiffness) t / duration), about, of an error is left after the
        time t

    Raises
    ------
    ValueError
        for numbers that are not positive and finite
    """

    decay_rate: float = 3.0
    stiffness: float = 400.0

    def __post_init__(self) -> None:
        positive(decay_rate=self.decay_rate, stiffness=self.stiffness)

    def encode(
        self, demonstration: Demonstration, manifold: str | Manifold = "euclidean", window: int = 9
    ) -> Demonstration:
        """The attractor of a demonstration: [s, attractor] in place of [time, data], in the same frames.

        The attractor is y = exp_x((z' + 2 sqrt(stiffness) z) / stiffness) with times in units of the duration. Frames
        may move; what the robot did is seen from where they were. The last attractor is where the demonstration ended:
        the goal, also of a movement that was not at rest yet.

        Parameters
        ----------
        demonstration
            data (T, 1 + d): time, then positions or poses
        manifold
            space of all data, time included
        window
            number of samples of the parabolas that velocity and acceleration are taken from; at most as many as there
            are

        Returns
        -------
        Demonstration
            over [s, attractor]

        Raises
        ------
        ValueError
            for less than three samples, and frames that change time
        """
        space = manifold if isinstance(manifold, Manifold) else Manifold.parse(manifold, demonstration.data.shape[1])
        data_space = space.subset(range(1, space.dim))
        without_time(demonstration.frames)
        times, x = demonstration.times, demonstration.data[:, 1:]
        phase = (times - times[0]) / max(times[-1] - times[0], np.finfo(float).tiny)
        window = min(window, (len(times) - 1) // 2 * 2 + 1)
        z, z_rate = derivatives(phase, x, data_space, window)
        attractor = data_space.exp(x, (z_rate + 2.0 * math.sqrt(self.stiffness) * z) / self.stiffness)
        attractor[-1] = x[-1]
        decay = np.exp(-self.decay_rate * phase)
        return Demonstration(times, np.column_stack([decay, attractor]), demonstration.frames, demonstration.visible)


class DynamicMovementPrimitive(AttractorSystem):
    """Reproduces a model of the attractor over the decay term.

    - The phase is the time in durations, 1 when s has come to its end. s stays there, and the spring settles, so that
      the system converges to `goal`, whatever happened before. It begins at rest, also in the middle of the movement
      (`start` with a phase).
    - The spring is solved exactly for an attractor that stays during a step (on S³ in the tangent space at the
      position), hence stable for steps of any length.
    - The covariance of a reference is that of the attractor.

    Parameters
    ----------
    model
        fitted to what `parameters.encode` returns; init="bins" of `TPGMM` suits, since s is not even in time
    parameters
        those that the model was encoded with
    duration, horizon_steps, horizon_time_step, blend_time
        as for `AttractorSystem`
    goal_from
        phase from which on the goal takes the place of the attractor, smoothly; with 1 it is that of the model to the
        end
    wait_distance
        distance of the robot from the reference at which the movement goes on at half of its rate, m or the unit of the
        data. The rate is 1 / (1 + (distance / wait_distance)²): a movement waits for a robot that is held ("phase
        stopping", Ijspeert et al. 2013)
    metres_per_radian
        length that an angle counts as in this distance, m/rad

    Raises
    ------
    ValueError
        for a model without s, and numbers that are not positive
    """

    def __init__(
        self,
        model: EndpointTPGMM,
        parameters: DmpParameters,
        *,
        duration: float | None = None,
        horizon_steps: int = 2,
        horizon_time_step: float = 0.005,
        blend_time: float = 0.15,
        goal_from: float = 0.7,
        wait_distance: float = 0.1,
        metres_per_radian: float = 0.2,
    ) -> None:
        if model.manifold_.factors[0][0] != "R" or model.manifold_.tangent_dim < 2:
            raise ValueError(f"the first dimension of the model is the decay term, then others; got {model.manifold_}")
        points = model.manifold_.subset(range(1, model.manifold_.dim))
        super().__init__(model, points, duration, horizon_steps, horizon_time_step, blend_time)
        positive(wait_distance=wait_distance, metres_per_radian=metres_per_radian)
        if not 0.0 <= goal_from < 1.0:
            raise ValueError(f"goal_from is a phase from 0, below 1, got {goal_from!r}")
        self.parameters, self.goal_from = parameters, goal_from
        self._rate = math.sqrt(parameters.stiffness)
        self._scale = np.full(points.tangent_dim, 1.0 / wait_distance)
        for s in points.spheres:
            self._scale[s.tangent] = metres_per_radian / wait_distance
        self._adapter, self._endpoints = Adapter(model), Adapter(model.endpoints_)
        self._compile()

    def goal(self, frames: Mapping[str, Frame], weights: Mapping[str, float] | None = None) -> Gaussian:
        """Where the movement ends in a situation: the product of the frames' Gaussians of the attractors' ends."""
        return self._end(frames, weights, None, END)

    def _end(
        self, frames: Mapping[str, Frame], weights: Mapping[str, float] | None, state: Array | None, which: int
    ) -> Gaussian:
        endpoints = self._endpoints.adapt(frames, None if state is None else np.concatenate([[0.0], state]), weights)
        require_time_kept(self._endpoints.buffer)
        return Gaussian(endpoints.means[which, 1:], endpoints.covariances[which, 1:, 1:], self.manifold)

    def _begin(self, situation: Situation, state: Array | None, phase: float) -> None:
        if state is None:
            state = self._end(situation.frames, situation.weights, None, BEGIN).mean.copy()
        self._x = state
        self._z = np.zeros(self.manifold.tangent_dim)
        self._scaled_time = phase
        self._situate(situation)

    def _situate(self, situation: Situation) -> None:
        frames, weights = situation.frames, situation.weights
        self._goal = self._end(frames, weights, self._x, END)
        self._adapter.situate(frames, np.concatenate([[0.0], self._x]), weights)

    def _advance(self, seconds: float, robot: Array | None) -> None:
        if robot is not None:
            away = self._scale * self.manifold.log(self._x, robot)
            self._time_scaling.target /= 1.0 + float(away @ away)
        time = self._time_scaling.advance(seconds)
        self._x, self._z = self._go(self._x, self._z, self._scaled_time, time)
        self._scaled_time += time

    def _go(self, x: Array, z: Array, scaled: float, time: float) -> tuple[Array, Array]:
        """Position and z after a time, in durations, from a scaled time on."""
        if time <= 0.0:
            return x, z
        n_steps = int(min(max(math.ceil(time / LONGEST_STEP), 1), MAX_STEPS))
        step = time / n_steps
        attractors, _, _ = self._attractors(scaled + step * (np.arange(n_steps, dtype=np.float64) + 0.5))
        for attractor in attractors:
            # On S³ both ends of a geodesic see it as the same turn about the fixed axes
            error = self.manifold.log(attractor, x)
            left, z = critically_damped(error, z, self._rate, step)
            x = self.manifold.exp(x, left - error)
        return x, z

    def _attractors(self, scaled: Array) -> tuple[list[Array], Array, Array]:
        """Means and covariances of the attractor at scaled times (H,), and the activations (K,) at the first."""
        means, covariances, activations = self._adapter.condition(
            np.exp(-self.parameters.decay_rate * np.minimum(scaled, 1.0))
        )
        shares = smoothstep(np.clip((scaled - self.goal_from) / (1.0 - self.goal_from), 0.0, 1.0))
        attractors = list(means)
        for i in np.flatnonzero(shares):
            way = self.manifold.log(means[i], self._goal.mean)
            attractors[i] = self.manifold.exp(means[i], shares[i] * way)
            covariances[i] += shares[i] * (self._goal.covariance - covariances[i])
        return attractors, 0.5 * (covariances + np.swapaxes(covariances, 1, 2)), activations

    def _now(self) -> tuple[Array, Array, Array]:
        _, covariances, activations = self._attractors(np.array([self._scaled_time], dtype=np.float64))
        return self._x, covariances[0], activations

    def _ahead(self, seconds: Array) -> list[Gaussian]:
        times = self._time_scaling.ahead(seconds)
        _, covariances, _ = self._attractors(times + self._scaled_time)
        x, z, gone, gaussians = self._x, self._z, 0.0, []
        for time, covariance in zip(times, covariances, strict=True):
            x, z = self._go(x, z, self._scaled_time + gone, time - gone)
            gone = time
            gaussians.append(Gaussian(x, covariance, self.manifold))
        return gaussians

    def _phase(self) -> float:
        return min(self._scaled_time, 1.0)

    def _mixture(self) -> GaussianMixture:
        return self._adapter.mixture()
