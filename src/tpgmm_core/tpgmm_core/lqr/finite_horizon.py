# SPDX-License-Identifier: Apache-2.0
"""Finite-horizon LQR that tracks a sequence of Gaussians: feedback gains and feedforward for every step (Section 5).

The system is `x[t+1] = A[t] x[t] + B[t] u[t]`, the cost the sum of `(x[t] - r[t])^T Q[t] (x[t] - r[t])` over
t = 0 .. T and `u[t]^T R[t] u[t]` over t = 0 .. T-1; Q[T] is the terminal cost. With r[t] and Q[t] the means and
precisions of a reproduction's horizon, this is the minimal intervention controller of the paper;
`lqr.double_integrator_gains` is its limit for a constant Gaussian. `batch` solves the same problem in one piece.

With process noise of covariance W[t] and a risk theta it is the risk-sensitive variant (Jacobson 1973, Whittle 1981;
Medina et al. 2012 take the predicted variability as the noise): it minimises `(2 / theta) log E[exp(theta C / 2)]`.
In the recursion P[t+1] becomes `(P[t+1]^-1 - theta W[t])^-1`, and theta = 0 is LQR.
"""

from __future__ import annotations

from dataclasses import dataclass

import numba
import numpy as np
from numpy.typing import ArrayLike

from tpgmm_core.common.types import Array
from tpgmm_core.geometry.kernels import EXACT, cholesky, gram, invert_lower, is_finite, solve_in_place
from tpgmm_core.lqr.riccati import square_root


@dataclass(frozen=True, slots=True)
class FiniteHorizonGains:
    """The control law `u[t] = feedforward[t] - gains[t] x[t]`.

    Parameters
    ----------
    gains
        (T, m, n)
    feedforward
        (T, m)
    """

    gains: Array
    feedforward: Array

    @property
    def stiffness(self) -> Array:
        """Stiffness K_P (T, m, m), 1/s^2, of a state `[x, xdot]` under accelerations."""
        return self.gains[:, :, : self.gains.shape[1]]

    @property
    def damping(self) -> Array:
        """Damping K_V (T, m, m), 1/s, of a state `[x, xdot]` under accelerations."""
        return self.gains[:, :, self.gains.shape[1] :]

    def feedforward_at(self, references: ArrayLike) -> Array:
        """Feedforward (T, m) that remains beside `gains[t] (r[t] - x[t])`, for references (T or more, n)."""
        r = np.asarray(references, dtype=np.float64)[: len(self.gains)]
        return np.asarray(self.feedforward - np.einsum("tmn,tn->tm", self.gains, r))


def finite_horizon_gains(
    A: ArrayLike,
    B: ArrayLike,
    state_costs: ArrayLike,
    control_cost: ArrayLike,
    references: ArrayLike,
    *,
    noise: ArrayLike | None = None,
    risk: float = 0.0,
) -> FiniteHorizonGains:
    """Gains and feedforward by the backward Riccati recursion.

    Parameters
    ----------
    A
        (n, n), or (T, n, n) for a system that varies
    B
        (n, m) or (T, n, m)
    state_costs
        (T + 1, n, n), Q, symmetric, semidefinite allowed; the last one is the terminal cost
    control_cost
        scalar > 0, or (m, m) or (T, m, m) symmetric positive definite, R
    references
        (T + 1, n), r
    noise
        (n, n) or (T, n, n), W, symmetric semidefinite: covariance that each step adds to the state; None means none
    risk
        theta, in 1 over the unit of the cost: 0 is LQR, above it, costs that vary count more (risk-averse)

    Returns
    -------
    FiniteHorizonGains
        gains and feedforward of T steps

    Raises
    ------
    ValueError
        for shapes that do not fit, values that are not finite, a control cost that is not positive definite, state
        costs so far from semidefinite or so large that a step has no gains, and a risk so large that the expectation is
        infinite from some step on (the breakdown)
    """
    A, B, Q, R, r = checked_problem(A, B, state_costs, control_cost, references)
    (T, n), m = (len(Q) - 1, A.shape[1]), B.shape[2]
    W = np.zeros((0, n, n)) if noise is None or risk == 0.0 else np.asarray(noise, dtype=np.float64)
    W = W[None] if W.ndim == 2 else W
    if W.shape[1:] != (n, n) or len(W) not in (0, 1, T):
        raise ValueError(f"noise has shape {W.shape}, expected {(n, n)} or {(T, n, n)}")
    if not (np.isfinite(W).all() and np.isfinite(risk)):
        raise ValueError(f"noise and risk must be finite, got the risk {risk}")
    gains, feedforward = np.empty((T, m, n)), np.empty((T, m))
    broken = _recursion(A, B, Q, R, r, square_root(W) if len(W) else W, float(risk), gains, feedforward)
    if broken < -1:
        raise ValueError(
            f"the costs are not semidefinite, or grow beyond all numbers: step {-2 - broken} of {T} has no gains"
        )
    if broken >= 0:
        raise ValueError(
            f"the risk {risk:g} is beyond the breakdown: from step {broken} of {T} on, the expected cost is infinite "
            "for every controller; lower the risk, the noise or the horizon"
        )
    return FiniteHorizonGains(gains, feedforward)


def checked_problem(
    A: ArrayLike, B: ArrayLike, state_costs: ArrayLike, control_cost: ArrayLike, references: ArrayLike
) -> tuple[Array, Array, Array, Array, Array]:
    """Check a problem, and bring its arrays into the shapes that all solvers take.

    Parameters
    ----------
    A, B, state_costs, control_cost, references
        as for `finite_horizon_gains`

    Returns
    -------
    tuple[Array, Array, Array, Array, Array]
        A (1 or T, n, n), B (1 or T, n, m), Q (T + 1, n, n), R (1 or T, m, m), r (T + 1, n)

    Raises
    ------
    ValueError
        for shapes that do not fit, values that are not finite, and a control cost that is not positive definite
    """
    # copies, since kernels take no read-only arrays
    A, B, Q, r = (np.array(x, dtype=np.float64, order="C") for x in (A, B, state_costs, references))
    A, B = (x[None] if x.ndim == 2 else x for x in (A, B))
    if A.ndim != 3 or B.ndim != 3 or A.shape[1] != A.shape[2] or B.shape[1] != A.shape[1]:
        raise ValueError(f"A has shape {A.shape} and B {B.shape}, expected (n, n) and (n, m), or (T, ...) of each")
    n, m = B.shape[1:]
    if Q.ndim != 3 or len(Q) < 2 or Q.shape[1:] != (n, n) or r.shape != (len(Q), n):
        raise ValueError(
            f"state_costs have shape {Q.shape} and references {r.shape}, expected (T + 1, {n}, {n}) and (T + 1, {n})"
        )
    R = np.array(control_cost, dtype=np.float64, order="C")
    R = R * np.eye(m) if R.ndim == 0 else R
    R = R[None] if R.ndim == 2 else R
    if R.ndim != 3 or R.shape[1:] != (m, m):
        raise ValueError(f"control_cost has shape {R.shape}, expected a number, {(m, m)} or (T, {m}, {m})")
    for name, matrices in (("A", A), ("B", B), ("control_cost", R)):
        if len(matrices) not in (1, len(Q) - 1):
            raise ValueError(f"{name} has {len(matrices)} time steps, the costs have T = {len(Q) - 1}")
    if not all(np.isfinite(x).all() for x in (A, B, Q, R, r)):
        raise ValueError("A, B, costs and references must be finite")
    if np.linalg.eigvalsh(R)[:, 0].min() <= 0.0:
        raise ValueError("control_cost must be positive definite")
    return A, B, Q, R, r


# With its signature given, this compiles (or loads from the cache) on import: no control step waits for it.
@numba.njit(
    "i8(f8[:,:,::1], f8[:,:,::1], f8[:,:,::1], f8[:,:,::1], f8[:,::1], f8[:,:,::1], f8, f8[:,:,::1], f8[:,::1])",
    **EXACT,
)
def _recursion(A, B, Q, R, r, L, risk, gains, feedforward):  # type: ignore[no-untyped-def]
    """The value of being at x at time t is x^T P x - 2 x^T p + const; writes gains and feedforward.

    L (0, 1 or T, n, n): square roots of the noise. What does not vary has one entry. Returns -1, the step t from which
    the risk is too large, or -2 - t for the step that has no gains.
    """
    T, m, n = gains.shape
    P = Q[T].copy()
    p = Q[T] @ r[T]
    columns = np.empty((m, n + 1))  # both right-hand sides, so that one factorisation serves gains and feedforward
    factor, inverse, middle = np.zeros((n, n)), np.zeros((n, n)), np.empty((n, n))
    for t in range(T - 1, -1, -1):
        At, Bt, Rt = A[min(t, len(A) - 1)], B[min(t, len(B) - 1)], R[min(t, len(R) - 1)]
        if len(L) > 0:
            # (P^-1 - theta L L^T)^-1 by Woodbury, which stays symmetric and takes singular P and L
            Lt = L[min(t, len(L) - 1)]
            LP = Lt.T @ P
            left = LP @ Lt
            for i in range(n):
                for j in range(n):
                    left[i, j] = (1.0 if i == j else 0.0) - risk * left[i, j]
            if not cholesky(left, n, factor):
                return t
            invert_lower(factor, n, inverse)
            gram(inverse, n, middle)
            worst_case = middle @ LP
            pushed, further = worst_case.T @ (Lt.T @ p), LP.T @ worst_case
            for i in range(n):
                p[i] += risk * pushed[i]
                for j in range(n):
                    P[i, j] += risk * further[i, j]
        BP = Bt.T @ P
        system, of_state, of_value = BP @ Bt, BP @ At, Bt.T @ p
        for i in range(m):
            columns[i, n] = of_value[i]
            for j in range(m):
                system[i, j] += Rt[i, j]
            for j in range(n):
                columns[i, j] = of_state[i, j]
        if not solve_in_place(system, columns, 0.0):
            return -2 - t
        for i in range(m):
            feedforward[t, i] = columns[i, n]
            for j in range(n):
                gains[t, i, j] = columns[i, j]
                if not is_finite(columns[i, j]):
                    return -2 - t
        closed = Bt @ gains[t]
        for i in range(n):
            for j in range(n):
                closed[i, j] = At[i, j] - closed[i, j]
        later, own = At.T @ (P @ closed), Q[t] @ r[t]
        p = closed.T @ p
        for i in range(n):
            p[i] += own[i]
            for j in range(i + 1):  # rounding must not add up to an asymmetric value
                P[i, j] = P[j, i] = 0.5 * (Q[t, i, j] + Q[t, j, i] + later[i, j] + later[j, i])
    return -1
