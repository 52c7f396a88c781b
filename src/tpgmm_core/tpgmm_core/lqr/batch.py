# SPDX-License-Identifier: Apache-2.0
"""Finite-horizon LQR in batch form: all controls at once, as one least-squares problem.

The states of a linear system are affine in its first state and its controls, `x[t] = free[t] x[0] + forced[t] u`, so
that the cost of `finite_horizon` is quadratic in u and its minimum one linear solution. Constraints can be added to
this form (`predictive`), and it is an independent check of the recursion. The effort grows
with the third power of the number of controls, that of the recursion with the number of steps.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike
from scipy.linalg import cho_factor, cho_solve

from tpgmm_core.common.types import Array
from tpgmm_core.lqr.finite_horizon import checked_problem


@dataclass(frozen=True, slots=True)
class Condensed:
    """States as functions of the first state and the stacked controls u (T m,).

    Parameters
    ----------
    free
        (T + 1, n, n)
    forced
        (T + 1, n, T m); zeros where controls come later than the state
    """

    free: Array
    forced: Array

    def states(self, x0: Array, controls: Array) -> Array:
        """States (T + 1, n), from the first state (n,) and the controls (T m,)."""
        return np.asarray(self.free @ x0 + self.forced @ controls)

    def objective(self, state_costs: Array, control_costs: Array, x0: Array, references: Array) -> tuple[Array, Array]:
        """Quadratic objective of the controls: H (T m, T m) and f (T m,) of the cost `u^T H u + 2 f^T u + const`.

        Parameters
        ----------
        state_costs
            (T + 1, n, n)
        control_costs
            (T, m, m)
        x0
            (n,)
        references
            (T + 1, n)

        Returns
        -------
        tuple[Array, Array]
            H (T m, T m) and f (T m,)
        """
        n, size = self.forced.shape[1:]
        weighed = (state_costs @ self.forced).reshape(-1, size)
        H = self.forced.reshape(-1, size).T @ weighed
        m = control_costs.shape[1]
        for t, R in enumerate(control_costs):
            H[t * m : (t + 1) * m, t * m : (t + 1) * m] += R
        return H, weighed.T @ (self.free @ x0 - references).ravel()


@dataclass(frozen=True, slots=True)
class BatchLaw:
    """The best controls from any first state: `u = feedforward - gain x[0]`; `finite_horizon` in one piece.

    Parameters
    ----------
    feedforward
        (T, m)
    gain
        (T, m, n)
    """

    feedforward: Array
    gain: Array

    def controls(self, x0: ArrayLike) -> Array:
        """Controls (T, m), from the first state (n,)."""
        return np.asarray(self.feedforward - self.gain @ np.asarray(x0, dtype=np.float64))


def condense(A: Array, B: Array, steps: int) -> Condensed:
    """Write T steps of `x[t+1] = A[t] x[t] + B[t] u[t]` as one.

    Parameters
    ----------
    A
        shape (1 or T, n, n)
    B
        shape (1 or T, n, m)
    steps
        T

    Returns
    -------
    Condensed
        what all states are, given the first one and all controls
    """
    n, m = B.shape[1:]
    free, forced = np.zeros((steps + 1, n, n)), np.zeros((steps + 1, n, steps * m))
    free[0] = np.eye(n)
    for t in range(steps):
        At, Bt = A[min(t, len(A) - 1)], B[min(t, len(B) - 1)]
        free[t + 1] = At @ free[t]
        forced[t + 1, :, : t * m] = At @ forced[t, :, : t * m]
        forced[t + 1, :, t * m : (t + 1) * m] = Bt
    return Condensed(free, forced)


def batch_gains(
    A: ArrayLike, B: ArrayLike, state_costs: ArrayLike, control_cost: ArrayLike, references: ArrayLike
) -> BatchLaw:
    """The same problem as `finite_horizon_gains`, solved at once.

    Parameters
    ----------
    A, B, state_costs, control_cost, references
        as for `finite_horizon_gains`

    Returns
    -------
    BatchLaw
        the controls as an affine function of the first state
    """
    A, B, Q, R, r = checked_problem(A, B, state_costs, control_cost, references)
    (T, n), m = (len(Q) - 1, A.shape[1]), B.shape[2]
    condensed = condense(A, B, T)
    H, f = condensed.objective(Q, np.broadcast_to(R, (T, m, m)), np.zeros(n), r)
    cross = condensed.forced.reshape(-1, T * m).T @ (Q @ condensed.free).reshape(-1, n)
    solution = cho_solve(cho_factor(H), np.column_stack([-f, cross]))
    return BatchLaw(solution[:, 0].reshape(T, m), solution[:, 1:].reshape(T, m, n))
