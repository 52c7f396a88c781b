# SPDX-License-Identifier: Apache-2.0
"""Finite-horizon LQR that tracks a sequence of Gaussians: feedback gains and feedforward for every step (Section 5).

The system is `x[t+1] = A x[t] + B u[t]`, the cost the sum of `(x[t] - r[t])^T Q[t] (x[t] - r[t])` over t = 0 .. T and
`u[t]^T R u[t]` over t = 0 .. T-1. With r[t] and Q[t] the means and precisions of a reproduction's horizon, this is the
minimal intervention controller of the paper; `lqr.double_integrator_gains` is its limit for a Gaussian that stays.
"""

from __future__ import annotations

from dataclasses import dataclass

import numba
import numpy as np
from numpy.typing import ArrayLike, NDArray

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class FiniteHorizonGains:
    """The control law `u[t] = feedforward[t] - gains[t] x[t]`.

    gains : (T, m, n)
    feedforward : (T, m)
    """

    gains: Array
    feedforward: Array


def double_integrator(dimensions: int, time_step: float) -> tuple[Array, Array]:
    """A (2D, 2D) and B (2D, D) of `[x, xdot]` under accelerations that are constant over each time step (s)."""
    eye, zero = np.eye(dimensions), np.zeros((dimensions, dimensions))
    return np.block([[eye, time_step * eye], [zero, eye]]), np.vstack([0.5 * time_step**2 * eye, time_step * eye])


def finite_horizon_gains(
    A: ArrayLike, B: ArrayLike, state_costs: ArrayLike, control_cost: ArrayLike, references: ArrayLike
) -> FiniteHorizonGains:
    """Gains and feedforward by the backward Riccati recursion.

    Parameters
    ----------
    A : (n, n)
    B : (n, m)
    state_costs : (T + 1, n, n), Q, symmetric, semidefinite allowed
    control_cost : scalar > 0 or (m, m) symmetric positive definite, R
    references : (T + 1, n), r

    Raises
    ------
    ValueError : shapes that do not fit, values that are not finite, a control cost that is not positive definite.
    """
    A, B, Q, r = (np.ascontiguousarray(x, dtype=np.float64) for x in (A, B, state_costs, references))
    if A.ndim != 2 or B.ndim != 2 or A.shape != (len(A), len(A)) or len(B) != len(A):
        raise ValueError(f"A has shape {A.shape} and B {B.shape}, expected (n, n) and (n, m)")
    n, m = B.shape
    if Q.ndim != 3 or len(Q) < 2 or Q.shape[1:] != (n, n) or r.shape != (len(Q), n):
        raise ValueError(
            f"state_costs have shape {Q.shape} and references {r.shape}, expected (T + 1, {n}, {n}) and (T + 1, {n})"
        )
    R = np.asarray(control_cost, dtype=np.float64)
    R = R * np.eye(m) if R.ndim == 0 else np.ascontiguousarray(R)
    if R.shape != (m, m):
        raise ValueError(f"control_cost has shape {R.shape}, expected a number or {(m, m)}")
    if not all(np.isfinite(x).all() for x in (A, B, Q, R, r)):
        raise ValueError("A, B, costs and references must be finite")
    if np.linalg.eigvalsh(R)[0] <= 0.0:
        raise ValueError("control_cost must be positive definite")
    gains, feedforward = np.empty((len(Q) - 1, m, n)), np.empty((len(Q) - 1, m))
    _recursion(A, B, Q, R, r, gains, feedforward)
    return FiniteHorizonGains(gains, feedforward)


# With its signature given, this compiles (or loads from the cache) on import: no control step waits for it.
@numba.njit("(f8[:,::1], f8[:,::1], f8[:,:,::1], f8[:,::1], f8[:,::1], f8[:,:,::1], f8[:,::1])", cache=True, nogil=True)
def _recursion(A, B, Q, R, r, gains, feedforward):  # type: ignore[no-untyped-def]
    """The value of being at x at time t is x^T P x - 2 x^T p + const; writes gains and feedforward."""
    n, m = B.shape
    T = len(gains)
    P = Q[T].copy()
    p = Q[T] @ r[T]
    columns = np.empty((m, n + 1))  # both right-hand sides, so that one factorisation serves gains and feedforward
    for t in range(T - 1, -1, -1):
        BP = B.T @ P
        columns[:, :n] = BP @ A
        columns[:, n] = B.T @ p
        solution = np.linalg.solve(R + BP @ B, columns)
        gains[t] = solution[:, :n]
        feedforward[t] = solution[:, n]
        closed = A - B @ gains[t]
        P = Q[t] + A.T @ (P @ closed)
        P = 0.5 * (P + P.T)  # rounding must not add up to an asymmetric value
        p = Q[t] @ r[t] + closed.T @ p
