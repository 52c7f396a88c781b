# SPDX-License-Identifier: Apache-2.0
"""Finite-horizon LQR in continuous time, for costs and references that are constant over each interval.

The Riccati differential equation `-Pdot = Q + A^T P + P A - P (B R^-1 B^T - theta W) P` is not integrated but solved:
over an interval, P is a linear fractional function of P at its end, by the exponential of the Hamiltonian matrix
(Anderson and Moore 1990). References enter through the state `[x, 1]`. For a computer that holds its controls over each
step, `finite_horizon` is the right one; this is its limit for short steps.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike
from scipy.linalg import expm

from tpgmm_core.common.types import Array
from tpgmm_core.lqr.finite_horizon import FiniteHorizonGains, checked_problem


def continuous_horizon_gains(
    A: ArrayLike,
    B: ArrayLike,
    state_costs: ArrayLike,
    control_cost: ArrayLike,
    references: ArrayLike,
    time_step: float,
    *,
    noise: ArrayLike | None = None,
    risk: float = 0.0,
) -> FiniteHorizonGains:
    """Gains and feedforward of `xdot = A x + B u` at the beginning of each interval.

    Parameters
    ----------
    A
        (n, n) or (T, n, n)
    B
        (n, m) or (T, n, m)
    state_costs
        (T + 1, n, n), symmetric semidefinite: Q per s over each interval, then the terminal cost
    control_cost
        scalar > 0, (m, m) or (T, m, m), R per s
    references
        (T + 1, n), over each interval, then at the end
    time_step
        s, of an interval
    noise
        (n, n), W, covariance that the state gains per s; None means none
    risk
        theta, in 1 over the unit of the cost, as in `finite_horizon`

    Returns
    -------
    FiniteHorizonGains
        at the beginning of each interval

    Raises
    ------
    ValueError
        like `finite_horizon_gains`, and for a time step that is not positive
    """
    A, B, Q, R, r = checked_problem(A, B, state_costs, control_cost, references)
    (T, n), m = (len(Q) - 1, A.shape[1]), B.shape[2]
    W = np.zeros((n, n)) if noise is None else np.asarray(noise, dtype=np.float64)
    if W.shape != (n, n) or not (np.isfinite(W).all() and np.isfinite(risk)):
        raise ValueError(f"expected noise of shape {(n, n)} and a risk, all finite; got {W.shape} and {risk}")
    if not 0.0 < time_step < np.inf:
        raise ValueError(f"a time step is positive and finite, in s; got {time_step}")
    gains, feedforward = np.empty((T, m, n)), np.empty((T, m))
    P = _with_reference(Q[T], r[T])
    hamiltonian = np.zeros((2 * (n + 1), 2 * (n + 1)))
    for t in range(T - 1, -1, -1):
        At, Bt, Rt = A[min(t, len(A) - 1)], B[min(t, len(B) - 1)], R[min(t, len(R) - 1)]
        to_control = np.linalg.solve(Rt, Bt.T)
        hamiltonian[:n, :n] = At
        hamiltonian[:n, n + 1 : -1] = risk * W - Bt @ to_control
        hamiltonian[n + 1 :, : n + 1] = -_with_reference(Q[t], r[t])
        hamiltonian[n + 1 : -1, n + 1 : -1] = -At.T
        both = expm(-time_step * hamiltonian) @ np.vstack([np.eye(n + 1), P])
        P = np.linalg.solve(both[: n + 1].T, both[n + 1 :].T)  # P is symmetric: Y X^-1 = X^-T Y^T
        P = 0.5 * (P + P.T)
        values = np.linalg.eigvalsh(P[:n, :n])
        # a cost that has gone through infinity comes back negative
        if not (np.isfinite(values).all() and values[0] >= -1e-7 * max(values[-1], 1e-300)):
            raise ValueError(
                f"the risk {risk:g} is beyond the breakdown: from step {t} of {T} on, the expected cost is infinite "
                "for every controller; lower the risk, the noise or the horizon"
            )
        gains[t] = to_control @ P[:n, :n]
        feedforward[t] = -to_control @ P[:n, n]
    return FiniteHorizonGains(gains, feedforward)


def _with_reference(Q: Array, r: Array) -> Array:
    """Cost `(x - r)^T Q (x - r)` as a quadratic form (n + 1, n + 1) of `[x, 1]`."""
    Qr = Q @ r
    return np.block([[Q, -Qr[:, None]], [-Qr[None], np.array([[r @ Qr]])]])
