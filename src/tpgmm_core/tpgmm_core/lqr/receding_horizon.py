# SPDX-License-Identifier: Apache-2.0
"""LQR of a double integrator along the Gaussians ahead, in continuous time and closed form: its present gains.

The references are joined by straight lines, at whose ends they change their velocity; the cost per s is constant over
each interval, that of the Gaussian at its beginning; after the last one it goes on for ever. With a control cost
`R = r I` the Hamiltonian matrix of an interval has blocks that are functions of one precision. Its exponential is then
four functions of each eigenvalue, those of the beam equation `d4x/dt4 = -4 a^4 x` (Krylov's), and the
Riccati differential equation becomes one linear solution per interval (Anderson and Moore 1990). Intervals may have any
length, and none is sampled: a controller at 1 kHz may plan with steps of 50 ms. `continuous_horizon` does the same for
any linear system, `lqr.double_integrator_gains` is the case without intervals.

**Risk** (Jacobson 1973; Medina et al. 2012). Under risk aversion (theta > 0) noise of covariance W acts as an
adversary, who takes a share `r theta W` of the control's authority. Here W is in proportion to the Gaussian's
covariance, and the share is given rather than theta and W: `risk_share` in directions that risk-neutral control holds
with the stiffness `risk_stiffness`, more where it is softer, in proportion to the variance. It is limited to
`LARGEST_SHARE`, hence no share leads to the breakdown. A negative share is risk-seeking.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from tpgmm_core.common.types import Array
from tpgmm_core.geometry.kernels import compiled, solve_in_place

#: Largest share of the control's authority that the worst case takes, or the best case adds.
LARGEST_SHARE = 0.9
#: Time constants of the fastest mode in one linear solution: exponentials of more lose the slow modes to rounding.
_LONGEST = 3.0


@dataclass(frozen=True, slots=True)
class RecedingHorizonGains:
    """Gains of `u = stiffness (r - x) + damping (rdot - xdot) + acceleration` at the beginning of a horizon.

    u is an acceleration.

    Parameters
    ----------
    stiffness, damping
        (n, n), K_P in 1/s^2 and K_V in 1/s; K_V is symmetric
    acceleration
        (n,), feedforward for what comes later on the horizon; zero where the first line goes on for ever
    """

    stiffness: Array
    damping: Array
    acceleration: Array


def receding_horizon_gains(
    positions: ArrayLike,
    covariances: ArrayLike,
    time_step: float,
    control_cost: float,
    *,
    min_stiffness: float = 1e-3,
    max_stiffness: float = 1e4,
    risk_share: float = 0.0,
    risk_stiffness: float = 1.0,
) -> RecedingHorizonGains:
    """Gains at the first of T Gaussians, of the state `[x, xdot]` under accelerations whose cost is `control_cost` I.

    Parameters
    ----------
    positions
        (T, n), T >= 1
    covariances
        (T, n, n), symmetric positive definite
    time_step
        s, between them; any number for a single one
    control_cost
        r > 0
    min_stiffness, max_stiffness
        bounds of (Q / r)^(1/2), the stiffness of each Gaussian by itself, in 1/s^2
    risk_share, risk_stiffness
        see the module

    Returns
    -------
    RecedingHorizonGains
        the gains to use now

    Raises
    ------
    ValueError
        for shapes that do not fit, values that are not finite, and costs, steps and bounds that are not positive or out
        of order
    """
    x, S = np.array(positions, dtype=np.float64, order="C"), np.array(covariances, dtype=np.float64, order="C")
    if x.ndim != 2 or not x.size or S.shape != (*x.shape, x.shape[1]):
        raise ValueError(f"expected positions (T, n) and covariances (T, n, n), T and n > 0; got {x.shape}, {S.shape}")
    if not (np.isfinite(x).all() and np.isfinite(S).all()):
        raise ValueError("positions and covariances must be finite")
    if not (0.0 < control_cost < np.inf and 0.0 < min_stiffness <= max_stiffness < np.inf):
        raise ValueError(
            f"expected a control cost > 0 and 0 < min_stiffness <= max_stiffness, got {control_cost}, {min_stiffness} "
            f"and {max_stiffness}"
        )
    if not (np.isfinite(risk_share) and 0.0 < risk_stiffness < np.inf):
        raise ValueError(f"expected a finite risk_share and a risk_stiffness > 0, got {risk_share}, {risk_stiffness}")
    if len(x) > 1 and not 0.0 < time_step < np.inf:
        raise ValueError(f"a time step is positive and finite, in s; got {time_step}")
    n = x.shape[1]
    K_P, K_V, acceleration = np.empty((n, n)), np.empty((n, n)), np.empty(n)
    moving_gains(
        x,
        S,
        float(time_step),
        float(control_cost),
        min_stiffness,
        max_stiffness,
        risk_share,
        risk_stiffness,
        K_P,
        K_V,
        acceleration,
    )
    return RecedingHorizonGains(K_P, K_V, acceleration)


@compiled
def modes(
    S: Array, r: float, lowest: float, highest: float, risk_share: float, risk_stiffness: float, k: Array, g: Array
) -> Array:
    """Eigenvectors of a covariance, with their stiffness and the authority that is left.

    Covariances that are not definite, by rounding, get the largest stiffness.

    Parameters
    ----------
    S
        (n, n), covariance
    r
        control cost
    lowest, highest
        bounds of the stiffness, 1/s²
    risk_share, risk_stiffness
        see the module
    k
        (n,), written: stiffness of each eigenvector, 1/s²
    g
        (n,), written: share of the control's authority that is left

    Returns
    -------
    Array
        eigenvectors, (n, n), one per column
    """
    values, vectors = np.linalg.eigh(S)
    for i in range(len(k)):
        k[i] = highest
        if values[i] > 0.0:
            k[i] = min(max(1.0 / math.sqrt(r * values[i]), lowest), highest)
        share = risk_share * (risk_stiffness / k[i]) ** 2
        g[i] = 1.0 - min(max(share, -LARGEST_SHARE), LARGEST_SHARE)
    return np.ascontiguousarray(vectors)


@compiled
def moving_gains(
    x: Array,
    S: Array,
    dt: float,
    r: float,
    lowest: float,
    highest: float,
    risk_share: float,
    risk_stiffness: float,
    K_P: Array,
    K_V: Array,
    acceleration: Array,
) -> None:
    """`receding_horizon_gains`, without checks.

    The value of the deviation e = [x - r(t), xdot - rdot(t)] is e^T P e - 2 p^T e, in units of the control cost.
    """
    T, n = x.shape
    k, g, p = np.empty(n), np.empty(n), np.zeros(2 * n)
    V = modes(S[T - 1], r, lowest, highest, risk_share, risk_stiffness, k, g)
    P = np.zeros((2 * n, 2 * n))
    for i in range(n):
        both = k[i] / math.sqrt(g[i])
        P[i, n + i] = P[n + i, i] = both
        P[n + i, n + i] = math.sqrt(2.0 * both / g[i])
        P[i, i] = g[i] * both * P[n + i, n + i]
    P = turned(P, np.ascontiguousarray(V.T))
    phi = np.empty((n, 4, 4))
    X_T, Y_T, forward = np.empty((2 * n, 2 * n)), np.empty((2 * n, 2 * n)), np.empty(2 * n)
    for t in range(T - 2, -1, -1):
        if t < T - 2:
            # the same velocity has another deviation from the line before
            for j in range(n):
                change = (2.0 * x[t + 1, j] - x[t, j] - x[t + 2, j]) / dt
                for i in range(2 * n):
                    p[i] -= P[i, n + j] * change
        V = modes(S[t], r, lowest, highest, risk_share, risk_stiffness, k, g)
        fastest = 0.0
        for i in range(n):
            fastest = max(fastest, math.sqrt(0.5 * k[i] * math.sqrt(g[i])))
        parts = max(1, math.ceil(fastest * dt / _LONGEST))
        for i in range(n):
            exponential(k[i], g[i], -dt / parts, phi[i])
        P, p = turned(P, V), turned_vector(p, V)
        for _ in range(parts):
            # [e, costate] at the beginning, from the end, where the costate is P e - p
            for i in range(n):
                for j in range(2 * n):
                    above, below = P[i, j], P[n + i, j]
                    X_T[j, i] = phi[i, 0, 2] * above + phi[i, 0, 3] * below
                    X_T[j, n + i] = phi[i, 1, 2] * above + phi[i, 1, 3] * below
                    Y_T[j, i] = phi[i, 2, 2] * above + phi[i, 2, 3] * below
                    Y_T[j, n + i] = phi[i, 3, 2] * above + phi[i, 3, 3] * below
                for a in range(2):
                    X_T[a * n + i, i] += phi[i, 0, a]
                    X_T[a * n + i, n + i] += phi[i, 1, a]
                    Y_T[a * n + i, i] += phi[i, 2, a]
                    Y_T[a * n + i, n + i] += phi[i, 3, a]
                forward[i] = phi[i, 0, 2] * p[i] + phi[i, 0, 3] * p[n + i]
                forward[n + i] = phi[i, 1, 2] * p[i] + phi[i, 1, 3] * p[n + i]
            solve_in_place(X_T, Y_T, 0.0)  # X leads from the end to the beginning: it has an inverse
            for i in range(2 * n):
                for j in range(2 * n):
                    P[i, j] = 0.5 * (Y_T[i, j] + Y_T[j, i])
            for i in range(n):
                first = phi[i, 2, 2] * p[i] + phi[i, 2, 3] * p[n + i]
                second = phi[i, 3, 2] * p[i] + phi[i, 3, 3] * p[n + i]
                p[i], p[n + i] = first, second
            for i in range(2 * n):
                for j in range(2 * n):
                    p[i] -= P[i, j] * forward[j]
        V_T = np.ascontiguousarray(V.T)
        P, p = turned(P, V_T), turned_vector(p, V_T)
    for i in range(n):
        acceleration[i] = p[n + i]
        for j in range(n):
            K_P[i, j], K_V[i, j] = P[n + i, j], P[n + i, n + j]


@compiled
def turned(P: Array, V: Array) -> Array:
    """A value P (2n, 2n) in the axes that are the columns of V (n, n), for positions and velocities."""
    n = len(V)
    half, result = np.zeros((2 * n, 2 * n)), np.zeros((2 * n, 2 * n))
    for a in range(0, 2 * n, n):
        for i in range(n):
            for k in range(n):
                for j in range(2 * n):
                    half[a + i, j] += V[k, i] * P[a + k, j]
    for i in range(2 * n):
        for b in range(0, 2 * n, n):
            for k in range(n):
                for j in range(n):
                    result[i, b + j] += half[i, b + k] * V[k, j]
    return result


@compiled
def turned_vector(p: Array, V: Array) -> Array:
    """A vector p (2n,) in the axes that are the columns of V (n, n)."""
    n = len(V)
    result = np.zeros(2 * n)
    for a in range(0, 2 * n, n):
        for k in range(n):
            for j in range(n):
                result[a + j] += p[a + k] * V[k, j]
    return result


@compiled
def exponential(k: float, g: float, t: float, phi: Array) -> None:
    """Write exp(t H) (4, 4) of position, velocity and their costates: of `v' = -g l_v, l_x' = -k^2 x, l_v' = -l_x`."""
    a = math.sqrt(0.5 * k * math.sqrt(g))
    z = a * t
    ch, sh, c, s = math.cosh(z), math.sinh(z), math.cos(z), math.sin(z)
    one, two, three, four = ch * c, 0.5 * (ch * s + sh * c), 0.5 * sh * s, 0.25 * (ch * s - sh * c)
    phi[0, 0] = phi[1, 1] = phi[2, 2] = phi[3, 3] = one
    phi[0, 1], phi[0, 2], phi[0, 3] = two / a, g * four / a**3, -g * three / a**2
    phi[1, 0], phi[1, 2], phi[1, 3] = -4.0 * a * four, g * three / a**2, -g * two / a
    phi[2, 0], phi[2, 1], phi[2, 3] = -4.0 * a**3 * two / g, -4.0 * a**2 * three / g, 4.0 * a * four
    phi[3, 0], phi[3, 1], phi[3, 2] = 4.0 * a**2 * three / g, 4.0 * a * four / g, -two / a
