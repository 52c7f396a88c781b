# SPDX-License-Identifier: Apache-2.0
"""Linear quadratic regulation of a double integrator: stiffness and damping from a precision (Section 5).

The state is `[x, xdot]`, the control `u = xddot`, and the cost the integral of `(x - x_ref)^T Q (x - x_ref) + u^T R u`,
where Q is the precision of the reference's Gaussian: the control is stiff where the demonstrations varied little, and
soft where they varied much. The control law is `u = K_P (x_ref - x) + K_V (xdot_ref - xdot)`.
"""

from __future__ import annotations

from dataclasses import dataclass

import numba
import numpy as np
from numpy.typing import ArrayLike

from tpgmm_core.common.types import Array
from tpgmm_core.geometry.kernels import EXACT, is_finite
from tpgmm_core.lqr.riccati import continuous_regulator, discrete_regulator

# Eigenvalues this far below zero, relative to the largest one, are rounding; anything lower is indefinite.
NEGATIVE_EIGENVALUE_TOLERANCE = 1e-9


@dataclass(frozen=True, slots=True)
class Gains:
    """Gains of `u = stiffness (x_ref - x) + damping (xdot_ref - xdot)`, u an acceleration.

    Parameters
    ----------
    stiffness
        (..., D, D), K_P in 1/s^2
    damping
        (..., D, D), K_V in 1/s
    """

    stiffness: Array
    damping: Array


def double_integrator_gains(
    precision: ArrayLike,
    control_cost: ArrayLike = 1.0,
    *,
    min_stiffness: float = 0.0,
    max_stiffness: float = np.inf,
) -> Gains:
    """Infinite-horizon gains in closed form, for a cost on position and control.

    For `R = r I` the Riccati equation is solved by `K_P = (Q / r)^(1/2)`, `K_V = (2 K_P)^(1/2)`: every
    eigenvector of Q is a mode with damping ratio 1 / sqrt(2). A diagonal R is the same problem in the
    coordinates `R^(1/2) x`. Either way `K_P = K_V^2 / 2`, with or without the bounds.

    Parameters
    ----------
    precision
        (..., D, D), symmetric, semidefinite allowed (a direction without cost gets `min_stiffness`)
    control_cost
        scalar r > 0, or (D,) the diagonal of R, all > 0
    min_stiffness, max_stiffness
        bounds of the eigenvalues of K_P, in 1/s^2. Directions that no frame constrains need a weak lower bound (or a
        push carries the arm away for ever), those with hardly any variation need an upper bound (or delays make the
        loop unstable)

    Returns
    -------
    Gains
        K_P and K_V, shape (..., D, D), in 1/s² and 1/s where the accelerations are in the units of x per s²

    Raises
    ------
    ValueError
        for a precision that is not square, not finite or indefinite, a control cost that is not positive, and bounds
        out of order
    """
    Q = np.asarray(precision, dtype=np.float64)
    if Q.ndim < 2 or Q.shape[-1] != Q.shape[-2]:
        raise ValueError(f"precision has shape {Q.shape}, expected square matrices (..., D, D)")
    if not 0.0 <= min_stiffness <= max_stiffness:
        raise ValueError(f"expected 0 <= min_stiffness <= max_stiffness, got {min_stiffness} and {max_stiffness}")
    D = Q.shape[-1]
    diagonal = np.array(control_cost, dtype=np.float64)
    if diagonal.shape != (D,):
        if diagonal.ndim:
            raise ValueError(f"control_cost has shape {diagonal.shape}, expected a number or ({D},)")
        diagonal = np.full(D, control_cost, dtype=np.float64)
    stacked = np.array(Q, order="C").reshape(-1, D, D)  # a copy, since kernels take no read-only arrays
    stiffness, damping = np.empty(Q.shape), np.empty(Q.shape)
    outputs = stiffness.reshape(-1, D, D), damping.reshape(-1, D, D)
    status = _closed_form(stacked, diagonal, min_stiffness, max_stiffness, *outputs)
    if status == _BAD_CONTROL_COST:
        raise ValueError(f"control_cost must be positive and finite, got {diagonal}")
    if status == _NOT_FINITE:
        raise ValueError("precision has entries that are not finite")
    if status == _NOT_SEMIDEFINITE:
        smallest = np.linalg.eigvalsh(Q).min()
        raise ValueError(f"precision must be positive semidefinite, its smallest eigenvalue is {smallest:.3g}")
    return Gains(stiffness, damping)


def double_integrator_value(precision: ArrayLike, control_cost: ArrayLike = 1.0) -> Array:
    """Remaining cost under `double_integrator_gains`: `[x - x_ref, xdot]^T P [x - x_ref, xdot]`.

    `P = [[R K_P K_V, R K_P], [R K_P, R K_V]]`: with this terminal cost a finite horizon is equivalent to an infinite
    one.

    Parameters
    ----------
    precision, control_cost
        as for `double_integrator_gains`

    Returns
    -------
    Array
        P, shape (..., 2D, 2D)
    """
    gains = double_integrator_gains(precision, control_cost)
    R = np.broadcast_to(np.asarray(control_cost, dtype=np.float64), gains.stiffness.shape[-1:])[:, None]
    position, velocity = R * gains.stiffness, R * gains.damping
    both = position @ gains.damping
    return np.block([[both, position], [position, velocity]])


def riccati_gains(
    position_cost: ArrayLike, velocity_cost: ArrayLike, control_cost: ArrayLike, time_step: float | None = None
) -> Gains:
    """Infinite-horizon gains by the algebraic Riccati equation, for a cost on position, velocity and control.

    Slower than `double_integrator_gains` by more than an order of magnitude; for problems without a closed form: a cost
    on velocities too, any control cost, discrete time.

    Parameters
    ----------
    position_cost
        (D, D), symmetric positive definite
    velocity_cost
        (D, D), symmetric positive semidefinite
    control_cost
        scalar > 0 or (D, D) symmetric positive definite
    time_step
        s, of a controller whose accelerations are constant over each step; None for continuous time. Costs are per s in
        both cases, so that short steps have the gains of continuous time

    Returns
    -------
    Gains
        K_P and K_V, shape (D, D)

    Raises
    ------
    ValueError
        for shapes that do not fit, costs for which no stabilising solution exists, and a time step that is not positive
    """
    Qx, Qv = np.atleast_2d(np.asarray(position_cost, float)), np.atleast_2d(np.asarray(velocity_cost, float))
    D = Qx.shape[0]
    for name, matrix in (("position_cost", Qx), ("velocity_cost", Qv)):
        if matrix.shape != (D, D):
            raise ValueError(f"{name} has shape {matrix.shape}, expected {(D, D)}")
    if np.linalg.matrix_rank(Qx) < D:
        raise ValueError("position_cost must be definite: a position without cost has no stabilising gain")
    zero, eye = np.zeros((D, D)), np.eye(D)
    Q = np.block([[Qx, zero], [zero, Qv]])
    if time_step is None:
        A, B = np.block([[zero, eye], [zero, zero]]), np.vstack([zero, eye])
        K = continuous_regulator(A, B, Q, control_cost).gain
    else:
        A, B = double_integrator(D, time_step)
        K = discrete_regulator(A, B, time_step * Q, time_step * np.asarray(control_cost, float)).gain
    return Gains(stiffness=K[:, :D], damping=K[:, D:])


def double_integrator(dimensions: int, time_step: float) -> tuple[Array, Array]:
    """Matrices A (2D, 2D) and B (2D, D) of `[x, xdot]` under accelerations that are constant over each time step.

    Parameters
    ----------
    dimensions
        D
    time_step
        s

    Returns
    -------
    tuple[Array, Array]
        A (2D, 2D) and B (2D, D)

    Raises
    ------
    ValueError
        for a time step that is not positive
    """
    if not 0.0 < time_step < np.inf:
        raise ValueError(f"a time step is positive and finite, in s; got {time_step}")
    eye, zero = np.eye(dimensions), np.zeros((dimensions, dimensions))
    return np.block([[eye, time_step * eye], [zero, eye]]), np.vstack([0.5 * time_step**2 * eye, time_step * eye])


_BAD_CONTROL_COST, _NOT_FINITE, _NOT_SEMIDEFINITE = 1, 2, 3


# With its signature given, this compiles (or loads from the cache) on import: no control step waits for it.
@numba.njit("i8(f8[:,:,::1], f8[:], f8, f8, f8[:,:,::1], f8[:,:,::1])", **EXACT)
def _closed_form(Q, control_cost, min_stiffness, max_stiffness, K_P, K_V):  # type: ignore[no-untyped-def]
    """Write the gains of the stack Q into K_P and K_V. Returns 0, or one of the codes above."""
    D = Q.shape[1]
    for i in range(D):
        if not 0.0 < control_cost[i] < np.inf:
            return _BAD_CONTROL_COST
    root = np.sqrt(control_cost)
    scaled = np.empty((D, D))
    for n in range(Q.shape[0]):
        for i in range(D):
            for j in range(D):
                if not is_finite(Q[n, i, j]):
                    return _NOT_FINITE
                scaled[i, j] = Q[n, i, j] / (root[i] * root[j])
        eigenvalues, vectors = np.linalg.eigh(scaled)
        if eigenvalues[0] < -NEGATIVE_EIGENVALUE_TOLERANCE * abs(eigenvalues[-1]):
            return _NOT_SEMIDEFINITE
        K_P[n] = 0.0
        K_V[n] = 0.0
        for k in range(D):
            stiffness = min(max(np.sqrt(max(eigenvalues[k], 0.0)), min_stiffness), max_stiffness)
            damping = np.sqrt(2.0 * stiffness)
            for i in range(D):
                for j in range(D):
                    # X -> R^(-1/2) X R^(1/2) leads back from the coordinates R^(1/2) x
                    mode = vectors[i, k] * vectors[j, k] * root[j] / root[i]
                    K_P[n, i, j] += stiffness * mode
                    K_V[n, i, j] += damping * mode
    return 0
