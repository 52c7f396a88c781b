# SPDX-License-Identifier: Apache-2.0
"""Infinite-horizon LQR of any linear system, in continuous and discrete time, risk-neutral or risk-sensitive.

The risk-sensitive problem minimises `(2 / theta) log E[exp(theta C / 2)]` of the cost C under process noise
(Jacobson 1973; Medina et al. 2012 take the predicted variability as that noise). theta = 0 is the expected cost: LQR.
theta > 0 (risk-averse) also counts the variance of the cost and becomes stiffer where noise enters; theta < 0 is
risk-seeking. Above some theta the expectation is infinite for every controller: no gains exist, and ValueError says so.

Both Riccati equations are solved by structure-preserving doubling (Chu, Fan and Lin 2005), compiled: it converges
quadratically, and takes a quarter of the time of scipy's Schur form, which is used where it does not converge.
"""

from __future__ import annotations

from dataclasses import dataclass

import numba
import numpy as np
from numpy.typing import ArrayLike
from scipy.linalg import solve_continuous_are, solve_discrete_are

from tpgmm_core.common.types import Array
from tpgmm_core.geometry.kernels import EXACT, is_finite, solve_in_place

MAX_DOUBLINGS = 60
SMALLEST_RISK = 1e-12  # times the noise: below it, risk is lost in rounding


@dataclass(frozen=True, slots=True)
class Regulator:
    """The control law `u = -gain x`.

    Parameters
    ----------
    gain
        (m, n)
    value
        (n, n), P: the cost from x on is x^T P x, without the part of the noise that does not depend on x
    """

    gain: Array
    value: Array


def continuous_regulator(
    A: ArrayLike,
    B: ArrayLike,
    state_cost: ArrayLike,
    control_cost: ArrayLike,
    *,
    noise: ArrayLike | None = None,
    risk: float = 0.0,
) -> Regulator:
    """Gains for `xdot = A x + B u`, the integral of `x^T Q x + u^T R u`, and noise of intensity W.

    Solves `A^T P + P A + Q - P (B R^-1 B^T - theta W) P = 0`; the gain is `R^-1 B^T P`.

    Parameters
    ----------
    A
        (n, n)
    B
        (n, m)
    state_cost
        (n, n), Q, symmetric semidefinite
    control_cost
        scalar > 0 or (m, m) symmetric positive definite, R
    noise
        (n, n), W, symmetric semidefinite: covariance that the state gains per s; None means none
    risk
        theta, in 1 over the unit of the cost

    Returns
    -------
    Regulator
        the gain and P

    Raises
    ------
    ValueError
        for shapes that do not fit, values that are not finite, costs for which no stabilising gain exists, and a risk
        beyond the breakdown
    """
    A, B, Q, R, W = _checked(A, B, state_cost, control_cost, noise, risk)
    G = B @ np.linalg.solve(R, B.T) - risk * W
    try:
        P, converged = _continuous(np.array(A, order="C"), G, np.array(Q, order="C"))
        if not converged:
            P = solve_continuous_are(A, *_with_noise(B, Q, R, W, risk))
    except (np.linalg.LinAlgError, ValueError) as error:
        raise ValueError(_no_solution(risk)) from error
    gain = np.linalg.solve(R, B.T @ P)
    worst = A - B @ gain + risk * W @ P  # with the worst-case noise
    if not _semidefinite(P) or np.linalg.eigvals(worst).real.max() >= 0.0:
        raise ValueError(_no_solution(risk))
    return Regulator(gain, 0.5 * (P + P.T))


def discrete_regulator(
    A: ArrayLike,
    B: ArrayLike,
    state_cost: ArrayLike,
    control_cost: ArrayLike,
    *,
    noise: ArrayLike | None = None,
    risk: float = 0.0,
) -> Regulator:
    """Gains for `x[t+1] = A x[t] + B u[t] + w[t]` and the sum of `x^T Q x + u^T R u`, w of covariance W.

    Solves `P = Q + A^T (P~^-1 + B R^-1 B^T)^-1 A` with `P~ = (P^-1 - theta W)^-1`; the gain is
    `(R + B^T P~ B)^-1 B^T P~ A`.

    Parameters
    ----------
    A, B, state_cost, control_cost, noise, risk
        as for `continuous_regulator`, costs and noise per step

    Returns
    -------
    Regulator
        the gain and P

    Raises
    ------
    ValueError
        as of `continuous_regulator`
    """
    A, B, Q, R, W = _checked(A, B, state_cost, control_cost, noise, risk)
    G = B @ np.linalg.solve(R, B.T) - risk * W
    try:
        P, converged = _discrete(np.array(A, order="C"), G, np.array(Q, order="C"))
        if not converged:
            P = solve_discrete_are(A, *_with_noise(B, Q, R, W, risk))
    except (np.linalg.LinAlgError, ValueError) as error:
        raise ValueError(_no_solution(risk)) from error
    L = square_root(W)
    remaining = np.eye(len(A)) - risk * L.T @ P @ L
    if not _semidefinite(P) or not _semidefinite(remaining):
        raise ValueError(_no_solution(risk))
    worst_case = P + risk * P @ L @ np.linalg.solve(remaining, L.T @ P)
    gain = np.linalg.solve(R + B.T @ worst_case @ B, B.T @ worst_case @ A)
    return Regulator(gain, 0.5 * (P + P.T))


def square_root(covariances: ArrayLike) -> Array:
    """Square root L of covariances, `L L^T`.

    Parameters
    ----------
    covariances
        shape (..., n, n), symmetric, semidefinite allowed

    Returns
    -------
    Array
        shape (..., n, n)

    Raises
    ------
    ValueError
        for an indefinite matrix
    """
    values, vectors = np.linalg.eigh(np.asarray(covariances, dtype=np.float64))
    if np.any(values[..., 0] < -1e-9 * np.abs(values[..., -1])):
        raise ValueError(f"a covariance must be positive semidefinite, its smallest eigenvalue is {values.min():.3g}")
    return np.ascontiguousarray(vectors * np.sqrt(np.maximum(values, 0.0))[..., None, :])


# With their signatures given, these compile (or load from the cache) on import: no control step waits for them.
@numba.njit("Tuple((f8[:,::1], b1))(f8[:,::1], f8[:,::1], f8[:,::1])", **EXACT)
def _discrete(E, G, H):  # type: ignore[no-untyped-def]
    """P of `P = H + E^T P (I + G P)^-1 E`, and whether it converged; writes to its arguments.

    After k steps H is the value of a horizon of 2^k.
    """
    n = len(E)
    columns, left, right = np.empty((n, 2 * n)), np.empty((n, n)), np.empty((n, n))
    for _ in range(MAX_DOUBLINGS):
        system = G @ H
        for i in range(n):
            system[i, i] += 1.0
            for j in range(n):
                columns[i, j], columns[i, n + j] = E[i, j], G[i, j]
        if not solve_in_place(system, columns, 0.0):
            return H, False
        for i in range(n):
            for j in range(n):
                left[i, j], right[i, j] = columns[i, j], columns[i, n + j]
        gain, further = E.T @ (H @ left), E @ (right @ E.T)
        change, largest = 0.0, 0.0
        for i in range(n):
            for j in range(i + 1):
                G[i, j] = G[j, i] = 0.5 * (G[i, j] + G[j, i] + further[i, j] + further[j, i])
                H[i, j] = H[j, i] = 0.5 * (H[i, j] + H[j, i] + gain[i, j] + gain[j, i])
                if not is_finite(gain[i, j] + gain[j, i]):
                    return H, False
                change = max(change, abs(gain[i, j]), abs(gain[j, i]))
                largest = max(largest, abs(H[i, j]))
        if change <= 1e-15 * largest:
            return H, True
        E = E @ left
    return H, False


@numba.njit("Tuple((f8[:,::1], b1))(f8[:,::1], f8[:,::1], f8[:,::1])", **EXACT)
def _continuous(A, G, H):  # type: ignore[no-untyped-def]
    """P of `A^T P + P A + H - P G P = 0`, and whether it converged: a Cayley transform, then `_discrete`."""
    n, a, g, h = len(A), 0.0, 0.0, 0.0
    for i in range(n):
        for j in range(n):
            a += A[i, j] ** 2
            g += G[i, j] ** 2
            h += H[i, j] ** 2
    # about as fast as the closed loop: then few doublings are needed
    rate = max(np.sqrt(a), (g * h) ** 0.125)
    shifted, inverse, middle = A.copy(), np.zeros((n, n)), np.zeros((n, n))
    for i in range(n):
        shifted[i, i] -= rate
        inverse[i, i] = middle[i, i] = 1.0
    if not solve_in_place(shifted, inverse, 0.0):
        return H, False
    right = inverse @ G
    system = H @ right
    for i in range(n):
        system[i, i] -= rate
        for j in range(n):
            system[i, j] += A[j, i]
    if not solve_in_place(system, middle, 0.0):
        return H, False
    E, F, value = np.empty((n, n)), right @ middle, middle @ (H @ inverse)
    for i in range(n):
        for j in range(n):
            E[i, j] = 2.0 * rate * middle[j, i] + (1.0 if i == j else 0.0)
            F[i, j] *= 2.0 * rate
            value[i, j] *= 2.0 * rate
    return _discrete(E, F, value)


def _with_noise(B: Array, Q: Array, R: Array, W: Array, risk: float) -> tuple[Array, Array, Array]:
    """Inputs, Q, costs of inputs, with the noise as an adversary of cost -1 / theta (Basar and Bernhard 1995)."""
    if abs(risk) * np.abs(W).max() < SMALLEST_RISK:
        return B, Q, R
    n, m = B.shape
    # sqrt(|theta|) goes into the input, so that the costs are of one size
    weights = np.zeros((m + n, m + n))
    weights[:m, :m] = R
    weights[m:, m:] = -np.sign(risk) * np.eye(n)
    return np.hstack([B, np.sqrt(abs(risk)) * square_root(W)]), Q, weights


def _checked(
    A: ArrayLike, B: ArrayLike, state_cost: ArrayLike, control_cost: ArrayLike, noise: ArrayLike | None, risk: float
) -> tuple[Array, Array, Array, Array, Array]:
    A, B, Q, R = (np.asarray(x, dtype=np.float64) for x in (A, B, state_cost, control_cost))
    if A.ndim != 2 or B.ndim != 2 or A.shape != (len(A), len(A)) or len(B) != len(A):
        raise ValueError(f"A has shape {A.shape} and B {B.shape}, expected (n, n) and (n, m)")
    n, m = B.shape
    R = R * np.eye(m) if R.ndim == 0 else R
    W = np.zeros((n, n)) if noise is None else np.asarray(noise, dtype=np.float64)
    if Q.shape != (n, n) or R.shape != (m, m) or W.shape != (n, n):
        raise ValueError(
            f"state_cost has shape {Q.shape}, control_cost {R.shape} and noise {W.shape}, "
            f"expected {(n, n)}, a number or {(m, m)}, and {(n, n)}"
        )
    if not all(np.isfinite(x).all() for x in (A, B, Q, R, W, risk)):
        raise ValueError("A, B, costs, noise and risk must be finite")
    if np.linalg.eigvalsh(R)[0] <= 0.0:
        raise ValueError("control_cost must be positive definite")
    if noise is not None:
        square_root(W)  # raises where it has none
    return A, B, Q, R, W


def _semidefinite(P: Array) -> bool:
    values = np.linalg.eigvalsh(0.5 * (P + P.T))
    return bool(values[0] >= -1e-7 * max(abs(values[-1]), 1e-300))


def _no_solution(risk: float) -> str:
    if risk > 0.0:
        return (
            f"no stabilising gains exist for these costs at the risk {risk:g}: it may be beyond the breakdown; lower it"
        )
    return "no stabilising gains exist for these costs: each unstable direction needs a cost and a control"
