# SPDX-License-Identifier: Apache-2.0
"""A smooth path through Gaussians by linear quadratic tracking, from a reference's present position and velocity."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from tpgmm_core.common.types import Array
from tpgmm_core.geometry.kernels import compiled
from tpgmm_core.geometry.manifold import Manifold
from tpgmm_core.lqr.double_integrator import double_integrator
from tpgmm_core.lqr.finite_horizon import finite_horizon_gains


@dataclass(frozen=True, slots=True, eq=False)
class TrackingPlan:
    """A path of H steps of constant acceleration, in the tangent space at where it begins.

    Parameters
    ----------
    manifold
        of the path
    time_step
        duration of a step
    begin
        (D,), a point of the manifold
    states
        (H + 1, 2 n), [x, x']
    accelerations
        (H, n)
    """

    manifold: Manifold
    time_step: float
    begin: Array
    states: Array
    accelerations: Array

    def at(self, time: float) -> tuple[Array, Array]:
        """Point (D,) and velocity (n,), tangent there, a time after the beginning; the last step goes on."""
        n = len(self.accelerations[0])
        i, left = self._step_at(time)
        point = self.point(time)
        velocity = self.states[i, n:] + left * self.accelerations[i]
        if not self.manifold.is_euclidean:
            velocity = self.manifold.transport(self.begin, point) @ velocity
        return point, velocity

    def point(self, time: float) -> Array:
        """Point (D,) a time after the beginning; the last step goes on."""
        n = len(self.accelerations[0])
        i, left = self._step_at(time)
        way = self.states[i, :n] + left * (self.states[i, n:] + 0.5 * left * self.accelerations[i])
        return self.manifold.exp(self.begin, way)

    def _step_at(self, time: float) -> tuple[int, float]:
        """The step of a time, and how much time has passed in it."""
        i = min(int(time / self.time_step), len(self.accelerations) - 1)
        return i, time - i * self.time_step


class Planner:
    """Plans paths of n_steps steps of a given duration.

    The path minimises the sum of |log_mu(x)|² in the precision Lambda of each step and of control_cost |x''|² (Section
    5): it is close to Gaussians of high precision, and smooth between the others. Costs are quadratic in the tangent
    space at the beginning, so that a plan on S³ is accurate near to it; it is renewed long before it ends.
    """

    def __init__(self, manifold: Manifold, time_step: float, n_steps: int) -> None:
        self._manifold, self._time_step, self._n_steps = manifold, time_step, n_steps
        n = manifold.tangent_dim
        self._A, self._B = double_integrator(n, time_step)
        self._costs = np.zeros((n_steps + 1, 2 * n, 2 * n))
        self._references = np.zeros((n_steps + 1, 2 * n))
        targets = np.tile(manifold.exp(_origin(manifold), np.zeros(n)), (n_steps + 1, 1))
        # compiled, or loaded from the cache
        self.plan(targets[0], np.zeros(n), targets, np.tile(np.eye(n), (n_steps + 1, 1, 1)), np.eye(n)).at(0.0)

    def plan(
        self, begin: Array, velocity: Array, targets: Array, precisions: Array, control_cost: Array
    ) -> TrackingPlan:
        """The path from a point and a velocity along targets.

        Parameters
        ----------
        begin
            (D,), point
        velocity
            (n,)
        targets
            (n_steps + 1, D)
        precisions
            (n_steps + 1, n, n), of the targets, moved to the tangent space at begin
        control_cost
            (n, n)

        Returns
        -------
        TrackingPlan
            the path
        """
        n = self._manifold.tangent_dim
        self._costs[:, :n, :n] = precisions
        self._references[:, :n] = self._manifold.log(begin[None], targets)
        gains = finite_horizon_gains(self._A, self._B, self._costs, control_cost, self._references)
        states, accelerations = np.zeros((self._n_steps + 1, 2 * n)), np.empty((self._n_steps, n))
        states[0, n:] = velocity
        _roll_out(self._A, self._B, gains.gains, gains.feedforward, states, accelerations)
        return TrackingPlan(self._manifold, self._time_step, begin, states, accelerations)


def _origin(manifold: Manifold) -> Array:
    origin = np.zeros(manifold.dim)
    for s in manifold.spheres:
        origin[s.ambient.stop - 1] = 1.0
    return origin


@compiled
def _roll_out(A: Array, B: Array, gains: Array, feedforward: Array, states: Array, controls: Array) -> None:
    """The path of x[t+1] = A x[t] + B u[t] under u[t] = feedforward[t] - gains[t] x[t], from states[0] on."""
    T, m, n = gains.shape
    for t in range(T):
        for i in range(m):
            controls[t, i] = feedforward[t, i]
            for j in range(n):
                controls[t, i] -= gains[t, i, j] * states[t, j]
        for i in range(n):
            total = 0.0
            for j in range(n):
                total += A[i, j] * states[t, j]
            for j in range(m):
                total += B[i, j] * controls[t, j]
            states[t + 1, i] = total
