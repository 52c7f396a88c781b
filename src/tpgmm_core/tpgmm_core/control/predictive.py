# SPDX-License-Identifier: Apache-2.0
"""Model predictive control of joints: the finite-horizon LQR of a moving reference, within limits.

The problem is solved again and again as the frames move. The input is the joint acceleration (inverse dynamics): over
each step of the horizon it is constant, positions and velocities are linear in it, and so are the torques,
`tau = M vdot + h`, with the inertia M and the nonlinear effects h of a nearby state. Written in the accelerations alone
(`batch`) this is a small, dense, strictly convex problem:

- torques are hard limits. With accelerations free, some always keep them, so that a solution always exists;
- positions and velocities are soft limits: kept where the torques allow it, else exceeded as little as possible. A
  robot that is found beyond a limit, or too fast to stop before it, has a defined answer.

Costs are per second, so that the answer hardly depends on the steps; beyond the horizon the cost is that of the
infinite-horizon LQR. DAQP solves it (Arnström, Bemporad and Axehill 2022: a dual active-set method for embedded
control), an optional dependency: only this module needs it.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike

from tpgmm_core.common.types import Array
from tpgmm_core.lqr.batch import condense
from tpgmm_core.lqr.double_integrator import double_integrator, double_integrator_value
from tpgmm_core.lqr.finite_horizon import finite_horizon_gains

try:
    import daqp
except ImportError as error:  # the rest of the core does without it
    raise ImportError("model predictive control needs the solver DAQP: pip install daqp") from error


_HARD, _SOFT = 0, 8  # DAQP's kinds of constraints
_SOLVED, _SOLVED_SOFTLY = 1, 2  # DAQP's exit flags: all limits kept; soft limits exceeded
# Weights of what exceeds a soft limit: linear, so that limits are kept exactly where they can be, and quadratic
_LINEAR_WEIGHT, _INVERSE_QUADRATIC_WEIGHT = 1e3, 1e-6


@dataclass(frozen=True, slots=True, kw_only=True)
class JointLimits:
    """What the joints can do; an infinite limit is none.

    Parameters
    ----------
    torque
        (n,), N m, > 0, both ways; hard
    velocity
        (n,), rad/s, > 0, both ways; soft
    lower, upper
        (n,), rad; soft
    """

    torque: Array
    velocity: Array
    lower: Array
    upper: Array

    def __post_init__(self) -> None:
        for name in ("torque", "velocity", "lower", "upper"):
            object.__setattr__(self, name, np.array(getattr(self, name), dtype=np.float64))
        shapes = {x.shape for x in (self.torque, self.velocity, self.lower, self.upper)}
        if len(shapes) != 1 or self.torque.ndim != 1:
            raise ValueError(f"limits of n joints have shape (n,) each, got the shapes {shapes}")
        if not ((self.torque > 0.0).all() and (self.velocity > 0.0).all() and (self.lower < self.upper).all()):
            raise ValueError("limits of torques and velocities are positive, and lower limits below upper ones")


@dataclass(frozen=True, slots=True, kw_only=True)
class JointReference:
    """Where the joints are to be at the ends of the steps of the horizon, and how much it matters.

    Parameters
    ----------
    positions
        (N, n), rad
    precisions
        (N, n, n), symmetric semidefinite, 1/rad^2 (the cost per s)
    velocities
        (N, n), rad/s; None where velocities are free
    velocity_precisions
        (N, n, n), of the velocities, where there are any
    """

    positions: Array
    precisions: Array
    velocities: Array | None = None
    velocity_precisions: Array | None = None


@dataclass(frozen=True, slots=True, kw_only=True)
class PredictivePlan:
    """What to do now, and how the joints are expected to move.

    Parameters
    ----------
    torque
        (n,), N m, within its limits: feedforward of the first step
    accelerations
        (N, n), rad/s^2, over the steps
    positions, velocities
        (N, n), at their ends
    stiffness, damping
        (n, n), 1/s^2 and 1/s: the feedback around the plan until the next one, as an acceleration `K_P (q_plan - q) +
        K_V (v_plan - v)`; the gains of the finite-horizon LQR with the same costs
    status
        "optimal", or "softened" where a soft limit is exceeded, or "fallback" where the solver did not finish: the law
        without limits, its torque cut to its limits
    excess
        by how much soft limits are exceeded at most, rad or rad/s
    """

    torque: Array
    accelerations: Array
    positions: Array
    velocities: Array
    stiffness: Array
    damping: Array
    status: Literal["optimal", "softened", "fallback"]
    excess: float


class PredictiveController:
    """Solves the problem of the horizon again and again, without memory from one time to the next.

    The constructor solves one problem, so that no later one waits for the compiler.

    Parameters
    ----------
    time_steps
        (N,), s, the steps of the horizon; they may grow along it
    limits
        of the n joints
    control_cost
        scalar > 0 or (n,), of accelerations, per s
    max_iterations
        of the solver, each of which adds or removes one active limit

    Raises
    ------
    ValueError
        for steps or costs that are not positive
    """

    def __init__(
        self,
        time_steps: ArrayLike,
        limits: JointLimits,
        *,
        control_cost: ArrayLike = 1e-3,
        max_iterations: int = 2000,
    ) -> None:
        steps = np.asarray(time_steps, dtype=np.float64)
        if steps.ndim != 1 or not len(steps):
            raise ValueError(f"time_steps have shape (N,), N > 0; got {steps.shape}")
        N, n = len(steps), len(limits.torque)
        cost = np.asarray(control_cost, dtype=np.float64)
        if cost.shape not in ((), (n,)) or not (cost > 0.0).all():
            raise ValueError(f"control_cost is a positive number or {(n,)} of them, got {control_cost!r}")
        self.limits = limits
        self.time_steps = steps
        self._control_cost = np.broadcast_to(cost, (n,))
        systems = [double_integrator(n, step) for step in steps]
        self._A, self._B = np.stack([A for A, _ in systems]), np.stack([B for _, B in systems])
        self._R = steps[:, None, None] * np.diag(self._control_cost)
        self._condensed = condense(self._A, self._B, N)
        states = self._condensed.forced[1:]
        size = N * n
        self._rows = np.vstack(
            [np.zeros((size, size)), states[:, n:].reshape(size, -1), states[:, :n].reshape(size, -1)]
        )
        self._kinds = np.repeat([_HARD, _SOFT, _SOFT], size).astype(np.int32)
        self._settings = {
            "iter_limit": max_iterations,
            "rho_soft": _INVERSE_QUADRATIC_WEIGHT,
            "w_soft": _LINEAR_WEIGHT,
        }
        still = JointReference(positions=np.zeros((N, n)), precisions=np.tile(np.eye(n), (N, 1, 1)))
        self.solve(np.zeros(n), np.zeros(n), still, np.eye(n), np.zeros(n))

    @property
    def times(self) -> Array:
        """Ends of the steps, for which references are given: (N,), s from now."""
        return np.cumsum(self.time_steps)

    def solve(
        self, q: ArrayLike, v: ArrayLike, reference: JointReference, inertia: ArrayLike, bias: ArrayLike
    ) -> PredictivePlan:
        """The best plan from a state.

        A problem whose limits cannot be kept is no error.

        Parameters
        ----------
        q, v
            (n,), positions and velocities
        reference
            at `times`
        inertia
            M, (n, n) or for each step (N, n, n)
        bias
            h, (n,) or (N, n): Coriolis, gravity, friction

        Returns
        -------
        PredictivePlan
            torques and motion along the horizon

        Raises
        ------
        ValueError
            for shapes that do not fit and values that are not finite
        """
        N, n = len(self.time_steps), len(self.limits.torque)
        x0, Q, r, M, h = self._checked(q, v, reference, inertia, bias)
        H, f = self._condensed.objective(Q, self._R, x0, r)
        torque, velocity = self.limits.torque, self.limits.velocity
        for t in range(N):
            self._rows[t * n : (t + 1) * n, t * n : (t + 1) * n] = M[t]
        free = (self._condensed.free @ x0)[1:]
        lower = np.stack([-torque - h, -velocity - free[:, n:], self.limits.lower - free[:, :n]])
        upper = np.stack([torque - h, velocity - free[:, n:], self.limits.upper - free[:, :n]])
        u, _, flag, _ = daqp.solve(H, f, self._rows, upper.ravel(), lower.ravel(), self._kinds, **self._settings)
        law = finite_horizon_gains(self._A, self._B, Q, self._R, r)
        if flag not in (_SOLVED, _SOLVED_SOFTLY) or not np.isfinite(u).all():
            status: Literal["optimal", "softened", "fallback"] = "fallback"
            u = self._unlimited(law.gains, law.feedforward, x0, M, h)
        else:
            status = "optimal" if flag == _SOLVED else "softened"
        accelerations = u.reshape(N, n)
        states = self._condensed.states(x0, u)[1:]
        positions, velocities = states[:, :n], states[:, n:]
        beyond = np.stack(
            [np.abs(velocities) - velocity, positions - self.limits.upper, self.limits.lower - positions]
        ).max()
        return PredictivePlan(
            torque=np.clip(M[0] @ accelerations[0] + h[0], -torque, torque),
            accelerations=accelerations,
            positions=positions,
            velocities=velocities,
            stiffness=law.stiffness[0],
            damping=law.damping[0],
            status=status,
            excess=max(float(beyond), 0.0),
        )

    def _unlimited(self, gains: Array, feedforward: Array, x: Array, M: Array, h: Array) -> Array:
        """Accelerations (N n,) of the law without limits, with torques cut to theirs."""
        result = np.empty_like(feedforward)
        for t, (K, k) in enumerate(zip(gains, feedforward, strict=True)):
            torque = np.clip(M[t] @ (k - K @ x) + h[t], -self.limits.torque, self.limits.torque)
            result[t] = np.linalg.solve(M[t], torque - h[t])
            x = self._A[t] @ x + self._B[t] @ result[t]
        return result.ravel()

    def _checked(
        self, q: ArrayLike, v: ArrayLike, reference: JointReference, inertia: ArrayLike, bias: ArrayLike
    ) -> tuple[Array, Array, Array, Array, Array]:
        """First state (2n,), state costs (N + 1, 2n, 2n) and references (N + 1, 2n), inertia and bias of each step."""
        N, n = len(self.time_steps), len(self.limits.torque)
        q, v = np.asarray(q, dtype=np.float64), np.asarray(v, dtype=np.float64)
        M, h = np.asarray(inertia, dtype=np.float64), np.asarray(bias, dtype=np.float64)
        if q.shape != (n,) or v.shape != (n,) or M.shape not in ((n, n), (N, n, n)) or h.shape not in ((n,), (N, n)):
            raise ValueError(
                f"expected q and v of shape {(n,)}, inertia {(n, n)} or {(N, n, n)} and bias {(n,)} or {(N, n)}, "
                f"got {q.shape}, {v.shape}, {M.shape} and {h.shape}"
            )
        positions = np.asarray(reference.positions, dtype=np.float64)
        precisions = np.asarray(reference.precisions, dtype=np.float64)
        if positions.shape != (N, n) or precisions.shape != (N, n, n):
            raise ValueError(
                f"a reference over {N} steps of {n} joints has positions {(N, n)} and precisions {(N, n, n)}, got "
                f"{positions.shape} and {precisions.shape}"
            )
        Q, r = np.zeros((N + 1, 2 * n, 2 * n)), np.zeros((N + 1, 2 * n))
        Q[1:, :n, :n] = self.time_steps[:, None, None] * precisions
        r[1:, :n] = positions
        # how fast the reference moves on: what the terminal cost compares velocities with
        if N > 1:
            r[N, n:] = (positions[-1] - positions[-2]) / self.time_steps[-1]
        if reference.velocities is not None and reference.velocity_precisions is not None:
            r[1:, n:] = reference.velocities
            Q[1:, n:, n:] = self.time_steps[:, None, None] * reference.velocity_precisions
        elif reference.velocities is not None or reference.velocity_precisions is not None:
            raise ValueError("velocities and velocity_precisions belong together: give both or none")
        if not all(np.isfinite(x).all() for x in (q, v, M, h, Q, r)):
            raise ValueError("the state, the reference, the inertia and the bias must be finite")
        Q[N] += double_integrator_value(precisions[-1], self._control_cost)
        return np.concatenate([q, v]), Q, r, np.broadcast_to(M, (N, n, n)), np.broadcast_to(h, (N, n))
