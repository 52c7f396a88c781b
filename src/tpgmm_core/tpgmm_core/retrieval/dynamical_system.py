# SPDX-License-Identifier: Apache-2.0
"""Autonomous dynamical systems: velocity from position by regression, with a guarantee that the goal is reached.

The setting is that of Khansari-Zadeh and Billard (2011): a mixture over [x, v] without time, v = E[v | x]; here it is
adapted to the situation by Eqs. (5), (6), on R^n and on poses. Their constraints on the parameters do not survive the
product of Eq. (6). The guarantee is a control Lyapunov function (Khansari-Zadeh and Billard 2014) instead, which moves
with the situation, and the smallest correction of the velocity that makes it fall.

Let x* be the goal in the situation, where demonstrations ended as the frames saw it (`EndpointTPGMM`), and d(x) the
distance to it, in m, with an angle counted as its arc at `Convergence.metres_per_radian`. Beside x the system keeps a
radius r >= d(x), at first (1 + detour) d(x_0), and later never more than (1 + detour) d(x):

    r' <= -rho(r),   rho(r) = min(rate r_0^(1/3) r^(2/3), goal_rate r, c)

r_0 is the longest d(x) since the start, c the top speed of the model, rates are per duration. What of the regressed
velocity would lead out of the ball of radius r about x* is taken from it, along the geodesic to x*; the rest stays.
The power 2/3 is that of a movement that comes to rest with a jerk other than zero, as hands do: d falls as the third
power of the time left.

**Theorem.** While the frames stand still and the robot does not pull the system away, for any start and time steps of
any length: d(x) <= r, and r falls by rho at least. Hence d(x(t)) <= (1 + detour) d(x_0) at all times, and x converges
to x*: where top speed is not what limits it, d(x) <= r_0 ((1 + detour)^(1/3) - rate t / 3)^3, with t in durations,
until the spring of goal_rate holds. With detour = 0, d itself is the Lyapunov function. When the goal moves by delta,
r changes with d(x), by no more than delta; when the robot pulls the system by delta, r grows by delta: errors do not
add up (input-to-state stability), not even those of a goal that trembles.

*Proof.* The laws in rho are solved exactly, each alone; what falls by their minimum is never below any of the three.
A step of x that ends outside of the ball is brought to the ball's nearest point. The bound holds after each step by
construction, no integration error enters. On S³, where opposite points are half a turn away, every way from there is
down. Tests check the bound at every step, on random models, starts and time steps
(`test_retrieval_dynamical_system.py`).
"""

from __future__ import annotations

import copy
import math
from collections.abc import Mapping

import numpy as np

from tpgmm_core.common.types import Array
from tpgmm_core.geometry.frame import Frame
from tpgmm_core.geometry.gaussian import Gaussian
from tpgmm_core.geometry.manifold import Manifold
from tpgmm_core.geometry.mixture import GaussianMixture
from tpgmm_core.learning.endpoints import BEGIN, END, EndpointTPGMM
from tpgmm_core.model.adaptation import Adapter
from tpgmm_core.model.situation import Situation
from tpgmm_core.retrieval import kernels_dynamical_system as kernels
from tpgmm_core.retrieval.attractor_system import AttractorSystem
from tpgmm_core.retrieval.convergence import Convergence
from tpgmm_core.retrieval.covariance_mean import CovarianceMean
from tpgmm_core.retrieval.frame_derivatives import frames_with_derivatives
from tpgmm_core.retrieval.interface import demonstrated_duration
from tpgmm_core.retrieval.spring import Smoothed, critically_damped
from tpgmm_core.retrieval.velocity_features import with_velocity

__all__ = ["Convergence", "StableDynamics", "with_velocity"]

MAX_TIME_STEP = 0.005
"""Step of the integration, in durations; at most MAX_STEPS are made at once, longer ones after a long pause."""
MAX_STEPS = 200
MEMORY = 0.05
"""Time constant with which a covariance follows the place, in durations, twice: it is late by a tenth of a duration."""
BEFORE_THE_END = 1.0 - 1e-9
GONE_AGAIN = 3.0
"""A movement that has arrived stays ended up to this many times the distance `Convergence.arrival` from the goal."""


class StableDynamics(AttractorSystem):
    """Reproduces a model over [x, v], by a system that converges to `goal`, wherever it is: see the module.

    - The covariance of a reference is that of the positions in the active components: large along the movement,
      smaller across it. Near the goal it becomes that of the demonstrations' ends. It is a mean in logarithms
      (`CovarianceMean`) over the recent past (MEMORY): components take over from one another within some mm, and a
      system without time reaches these places earlier or later with every disturbance. Stiffness has to follow the
      place, without leaps.
    - The phase is the share of the way that is done, 1 - d / (the largest d since the start); 1 within
      `Convergence.arrival`, so that it may fall when the goal moves away. It is computed from a goal that follows the
      one of the situation as a critically damped spring with blend_time: perceived poses are noisy.
    - When frames change, the velocity changes at once, and within some mm where one component takes over from another.
      What exceeds the acceleration from rest to top speed within blend_time goes into an offset of the reference, which
      dies out as a critically damped spring with blend_time. In the same way the reference starts at rest.
    - The reference waits for a robot that is held, at one to two lengths of the leash; a robot that is pulled away
      takes the reference along, by no more than leash_speed. The movement goes on from there.

    Parameters
    ----------
    model
        fitted to what `with_velocity` returns
    duration, horizon_steps, horizon_time_step, blend_time
        as for `AttractorSystem`
    convergence
        how it comes to its goal

    Attributes
    ----------
    velocity, regressed
        (n,) at the last step, per s at speed 1 and the demonstrated duration, with and without the correction (too fast
        a velocity is shortened before it is corrected)

    Raises
    ------
    ValueError
        for a model that is not over [x, v]
    """

    def __init__(
        self,
        model: EndpointTPGMM,
        *,
        duration: float | None = None,
        horizon_steps: int = 2,
        horizon_time_step: float = 0.005,
        blend_time: float = 0.15,
        convergence: Convergence | None = None,
    ) -> None:
        points = _points(model.manifold_)
        super().__init__(model, points, duration, horizon_steps, horizon_time_step, blend_time)
        self.convergence = convergence or Convergence()
        known = "duration_s" in model.metadata_
        self._model_duration = demonstrated_duration(model) if known else self.duration
        n, K = points.tangent_dim, len(model.priors_)
        self._metric = np.ones(n)
        for s in points.spheres:
            self._metric[s.tangent] = self.convergence.metres_per_radian**2
        self._adapter, self._endpoints = Adapter(model), Adapter(model.endpoints_)
        self._log_priors = np.log(np.maximum(model.priors_, np.finfo(float).tiny))
        self._whitening, self._offsets, self._gains = np.empty((K, n, n)), np.empty(K), np.empty((K, n, n))
        self._activations, self.velocity, self.regressed = np.empty(K), np.zeros(n), np.zeros(n)
        self._covariances = CovarianceMean(points, K)
        self._layout = points.ambient_of_tangent, points.sphere_starts
        self._compile()

    def goal(self, frames: Mapping[str, Frame], weights: Mapping[str, float] | None = None) -> Gaussian:
        """Where the movement ends in a situation: the product of the frames' Gaussians of the demonstrations' ends."""
        return self._end(self._with_derivatives(frames), weights, None, END)

    def _end(
        self,
        frames_with_derivatives: Mapping[str, Frame],
        weights: Mapping[str, float] | None,
        state: Array | None,
        which: int,
    ) -> Gaussian:
        endpoints = self._endpoints.adapt(frames_with_derivatives, self._with_rest(state), weights)
        D, n = self.manifold.dim, self.manifold.tangent_dim
        return Gaussian(endpoints.means[which, :D], endpoints.covariances[which, :n, :n], self.manifold)

    def _with_derivatives(self, frames: Mapping[str, Frame]) -> dict[str, Frame]:
        return frames_with_derivatives(frames, self.manifold, 1, keeps_time=False)

    def _with_rest(self, state: Array | None) -> Array | None:
        return None if state is None else np.concatenate([state, np.zeros(self.manifold.tangent_dim)])

    def _begin(self, situation: Situation, state: Array | None, phase: float) -> None:
        if state is None:
            state = self._end(self._with_derivatives(situation.frames), situation.weights, None, BEGIN).mean.copy()
        self._x = state
        self._offset = np.zeros(self.manifold.tangent_dim)
        self._goal_offset, self._goal_rate = np.zeros_like(self._offset), np.zeros_like(self._offset)
        self._longest, self._has_arrived = 0.0, False
        self._take(situation)
        self._radius = (1.0 + self.convergence.detour) * self.distance
        self._reach(self.distance / max(1.0 - phase, 1e-6))
        self.velocity[:] = 0.0
        self._offset_rate = np.zeros_like(self.velocity)
        self._take_velocity(0.0)
        self._of_late = Smoothed(self._place(self._x))

    def _situate(self, situation: Situation) -> None:
        slack, seen = self._radius - self.distance, self._seen_goal
        self._take(situation)
        self._goal_offset = self.manifold.log(self._goal.mean, seen)
        self._radius = self.distance + slack  # noise of the goal does not add up
        self._take_velocity(0.0)

    def _take(self, situation: Situation) -> None:
        """Prepare the mixture and the goal of a situation for regression."""
        frames_with_derivatives, weights = self._with_derivatives(situation.frames), situation.weights
        self._adapted = self._adapter.adapt(frames_with_derivatives, self._with_rest(self._x), weights)
        self._goal = self._end(frames_with_derivatives, weights, self._x, END)
        self._centres = np.ascontiguousarray(self._adapted.means)
        self._spreads = np.ascontiguousarray(self._adapted.covariances)
        prepared = self._whitening, self._offsets, self._gains
        if not (
            kernels.prepare(self._log_priors, self._centres, self._spreads, self.manifold.dim, *prepared)
            and self._covariances.take(self._centres, self._spreads, self._goal)
        ):
            raise ValueError("a covariance of the adapted mixture is not positive definite")
        n = self.manifold.tangent_dim
        scale, T = self.convergence, self._model_duration
        means, variances = self._centres[:, -n:], np.diagonal(self._spreads, axis1=1, axis2=2)[:, -n:]
        speeds = np.sqrt(means**2 @ self._metric) + 2.0 * np.sqrt(variances @ self._metric)
        self._law = np.array([
            scale.rate / T, scale.goal_rate / T, 0.0, speeds.max(), scale.detour, self._size(self._goal.covariance)
        ])  # fmt: skip
        self._reach()
        self._system = (
            self._goal.mean.copy(), self._law, self._metric, self._centres, *prepared, *self._layout,
            self._activations, self.regressed,
        )  # fmt: skip

    def _reach(self, at_least: float = 0.0) -> None:
        """The longest distance from the goal since the start."""
        self._longest = self._law[2] = max(self._longest, self.distance, at_least)

    def _take_velocity(self, seconds: float, astray: Array | float = 0.0) -> None:
        """Compute `velocity` and `regressed` where the system is now; too fast a change goes into the offset.

        Parameters
        ----------
        seconds
            since the last call, s
        astray
            (n,), distance between where the last step led and where the former velocity would have led
        """
        former = self.velocity.copy()
        kernels.stable_velocity(self._x, max(self._radius, 1e-300), *self._system, self.velocity, np.empty(len(former)))
        scale = self._time_scaling.rate * self._model_duration
        change = scale * (self.velocity - former)
        size, admitted = self._length(change), self._law[3] * scale * seconds / self.blend_time
        if size > admitted:
            too_fast = 1.0 - admitted / size
            self._offset, self._offset_rate = self._offset - too_fast * astray, self._offset_rate - too_fast * change

    def _advance(self, seconds: float, robot: Array | None) -> None:
        if robot is not None:
            self._follow(robot, seconds)
        scaled = self._time_scaling.advance(seconds) * self._model_duration
        before = self._x.copy()
        self._radius = self._go(self._x, self._radius, scaled)
        self._offset, self._offset_rate = self._offset_after(seconds)
        rate = 1.0 / self.blend_time
        self._goal_offset, self._goal_rate = critically_damped(self._goal_offset, self._goal_rate, rate, seconds)
        self._reach()
        self._take_velocity(seconds, self.manifold.log(before, self._x) - scaled * self.velocity)
        self._of_late.follow(self._place(self._x), self._memory_rate, seconds)

    def _go(self, x: Array, radius: float, scaled: float) -> float:
        """Advance x by a scaled time, s as demonstrated; returns the new radius."""
        n_steps = int(min(max(math.ceil(scaled / (MAX_TIME_STEP * self._model_duration)), 1), MAX_STEPS))
        return float(kernels.go(x, radius, scaled, n_steps, *self._system, np.empty(len(self.velocity))))

    def _follow(self, robot: Array, seconds: float) -> None:
        """Slow down for a robot that is farther away than the leash, and be pulled along by it.

        Softly: as the excess begins to grow nothing changes at once. At twice the leash the system itself stops.
        """
        away = self.manifold.log(self.manifold.exp(self._x, self._offset), robot)
        length, leash = self._length(away), self.convergence.leash
        excess = length - leash
        if excess > 0.0:
            self._time_scaling.target *= max(1.0 - excess / leash, 0.0)
            pulled = min(-math.expm1(-seconds / self.blend_time) * excess, self.convergence.leash_speed * seconds)
            self._x = self.manifold.exp(self._x, away * (pulled / length))
            self._radius += pulled

    def _now(self) -> tuple[Array, Array, Array]:
        covariance = self._covariance_at(self._x, self._of_late)
        return self.manifold.exp(self._x, self._offset), covariance, self._activations.copy()

    @property
    def _memory_rate(self) -> float:
        return 1.0 / (MEMORY * self.duration)

    def _place(self, x: Array) -> Array:
        """What the covariance goes by: the activations (K,) and the way from the goal to x (n,)."""
        return np.concatenate([self._activations, self.manifold.log(self._goal.mean, x)])

    def _covariance_at(self, x: Array, of_late: Smoothed) -> Array:
        K = len(self._activations)
        d = self._length(of_late.value[K:])
        near = math.exp(-0.5 * (d / self._law[5]) ** 2)
        return self._covariances.at(x, (1.0 - near) * of_late.value[:K])

    def _ahead(self, seconds: Array) -> list[Gaussian]:
        x, radius = self._x.copy(), self._radius
        kept = self._activations.copy(), self.regressed.copy()
        of_late, gaussians, gone, before = copy.copy(self._of_late), [], 0.0, 0.0
        for time, scaled in zip(
            seconds.tolist(), self._time_scaling.ahead(seconds) * self._model_duration, strict=True
        ):
            radius, gone = self._go(x, radius, scaled - gone), scaled
            of_late.follow(self._place(x), self._memory_rate, time - before)
            before = time
            mean = self.manifold.exp(x, self._offset_after(time)[0])
            gaussians.append(Gaussian(mean, self._covariance_at(x, of_late), self.manifold))
        self._activations[:], self.regressed[:] = kept
        return gaussians

    def _offset_after(self, seconds: float) -> tuple[Array, Array]:
        return critically_damped(self._offset, self._offset_rate, 1.0 / self.blend_time, seconds)

    @property
    def _seen_goal(self) -> Array:
        """Position of the goal (D,), smoothed."""
        return self.manifold.exp(self._goal.mean, self._goal_offset)

    def _phase(self) -> float:
        reference = self.manifold.exp(self._x, self._offset)
        d = self._length(self.manifold.log(self._seen_goal, reference))
        self._has_arrived = d <= self.convergence.arrival * (GONE_AGAIN if self._has_arrived else 1.0)
        return 1.0 if self._has_arrived else min(max(1.0 - d / self._longest, 0.0), BEFORE_THE_END)

    def _mixture(self) -> GaussianMixture:
        return self._adapted

    @property
    def radius(self) -> float:
        """Radius of the ball about the goal that the system is in, m: the Lyapunov function."""
        return self._radius

    @property
    def distance(self) -> float:
        """Distance of the system from its goal, m; at most `radius`. The reference differs by the offset alone."""
        return self._length(self.manifold.log(self._goal.mean, self._x))

    def _size(self, covariance: Array) -> float:
        """Standard deviation of the length, m."""
        return math.sqrt(float(np.diagonal(covariance) @ self._metric))

    def _length(self, tangent: Array) -> float:
        return math.sqrt(float(self._metric @ (tangent * tangent)))


def _points(manifold: Manifold) -> Manifold:
    """The space of x, of that of [x, v]. Raises ValueError where there is none."""
    n, odd = divmod(manifold.tangent_dim, 2)
    D = manifold.dim - n
    if odd or n == 0 or any(s.ambient.stop > D for s in manifold.spheres):
        raise ValueError(
            "the model is over [x, v], points and their velocities (see with_velocity): D + n dimensions, of which "
            f"the last n are Euclidean, such as R3 x S3 x R6; got {manifold}"
        )
    return manifold.subset(range(D))
