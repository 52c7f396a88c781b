# SPDX-License-Identifier: Apache-2.0
"""Delay margins of feedback: how late it may act before damping starts to swing; compiled.

A mode of the loop is `a = -k x(t - T) - d v(t - T)`. Its open loop `(d s + k) / s^2` crosses 1 at the frequency w with
`w^2 = (d^2 + (d^4 + 4 k^2)^(1/2)) / 2`, with a phase margin of `atan(d w / k)`: it is stable for delays below
`atan(d w / k) / w` (Astrom and Murray 2008, Section 9.3). The margin is `pi / (2 d)` for pure damping, k = 0,
`1.04 / d` for the modes of an LQR with `k = d^2 / 2`, and `1.29 / d` for critically damped ones.

**Slower in time.** With d times a share s and k times its square, the mode does the same s times as slowly: the damping
ratio stays, and the margin becomes 1 / s times as long. So one number, the share, adapts a loop of any modes to a
delay. Friction in the joints helps too, but is not counted on.
"""

from __future__ import annotations

import math

import numpy as np

from tpgmm_core.common.types import Array
from tpgmm_core.geometry.kernels import compiled

#: A loop is made stable for this many times the known delay: half of the phase margin is left.
DELAY_SAFETY = 2.0
#: Delay margins times the rate d: of pure damping, and of critical damping with k = d^2 / 4.
OF_DAMPING, OF_CRITICAL = 0.5 * math.pi, 1.2948


@compiled
def delay_margin(k: float, d: float) -> float:
    """Delay (s) below which `a = -k x(t - T) - d v(t - T)` is stable, for k >= 0 (1/s^2) and d >= 0 (1/s)."""
    if not (k > 0.0 or d > 0.0):
        return math.inf
    crossover = math.sqrt(0.5 * (d * d + math.sqrt(d**4 + 4.0 * k * k)))
    return math.atan2(d * crossover, k) / crossover


@compiled
def borne_share(margin: float, delay: float) -> float:
    """Share (0 to 1) of its rates with which a loop of a margin (s) is stable with a delay (s), by `DELAY_SAFETY`."""
    late = DELAY_SAFETY * delay
    return 1.0 if late <= margin else margin / late


@compiled
def fastest_rate(rates: Array, length: float) -> float:
    """Largest eigenvalue (1/s) of K_V (6, 6) of a pose, which is symmetric where turns are weighed by a length (m)."""
    scaled = np.empty((6, 6))
    for i in range(6):
        for j in range(6):
            scaled[i, j] = rates[i, j] * (1.0 if i < 3 else length) / (1.0 if j < 3 else length)
    for i in range(6):
        for j in range(i):
            scaled[i, j] = scaled[j, i] = 0.5 * (scaled[i, j] + scaled[j, i])
    return max(np.linalg.eigvalsh(scaled)[5], 0.0)


@compiled
def joint_damping(damping: float, bandwidth: float, mass: Array, inverse: Array, delay: float, out: Array) -> None:
    """Damping (n,) of joints, N m s/rad, that is stable with a delay: less for joints that it would shake.

    Each has `min(damping, b mass)` with the largest b up to `bandwidth` (1/s) for which all of them together are stable
    with the delay (s). Light joints would be shaken by more. Then M^-1 D has eigenvalues up to b times those of M^-1
    diag(mass), for which the largest sum of a row of mass^1/2 M^-1 mass^1/2 is a bound. mass (n,) is the inertia that
    each joint feels, 1 / (M^-1)_ii; inverse (n, n) is M^-1.
    """
    n, coupling = len(mass), 1.0
    for i in range(n):
        total = 0.0
        for j in range(n):
            total += abs(inverse[i, j]) * math.sqrt(mass[i] * mass[j])
        coupling = max(coupling, total)
    if delay > 0.0:
        bandwidth = min(bandwidth, OF_DAMPING / (DELAY_SAFETY * delay * coupling))
    for i in range(n):
        out[i] = min(damping, bandwidth * mass[i])
