# SPDX-License-Identifier: Apache-2.0
"""`PoseFilter`: a noisy pose is averaged while it is at rest, and followed when it moves.

The estimate is the mean of the newest observations. How many of them is decided anew with each one: the longest window
whose mean agrees with the means of all shorter windows, as far as the noise explains it (Lepski 1990; the intersection
of confidence intervals of Goldenshluger and Nemirovski 1997). With noise of covariance V, means over the newest j and
the newest N > j observations of a fixed place differ by a Gaussian of covariance (1 / j - 1 / N) V. They agree where

    |m_j - m_N|² <= AGREES v (1 / j - 1 / N),   v the largest eigenvalue of V.

- At rest the window grows up to the memory, and the error falls with the square root of their number.
- When an object moves, its former place drops out of the window as soon as the difference is more than noise: at a
  steady speed of u per observation about (4 sqrt(AGREES v) / u)^(2/3) observations are left, and the estimate lags by
  half of these. That is 3.3 standard deviations at most, at any speed; 4.5 since v is learned, and errs to the larger.
- A jump, and a single outlier, is passed on at once and unchanged.

V is learned, separately for positions and turns, from differences of neighbours, which drift hardly changes. A window
shows noise where neighbours differ as much as independent observations do (von Neumann 1941), where most of them do
differ, and where their sum does not come from a few of them. Exact poses show none: neighbours of a smooth motion are
alike, and a pose at rest repeats itself. While no noise is known, poses pass as they are, bit by bit.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import ArrayLike, NDArray

from tpgmm_core.common.types import Array
from tpgmm_core.geometry import quaternion
from tpgmm_core.geometry.kernels import compiled

_SECOND = 1_000_000_000
#: The quantile of chi squared with 3 degrees of freedom that noise exceeds with a probability of 1e-5.
AGREES = 25.9
#: Least number of observations in which noise is recognised.
FEWEST = 10
#: Largest number of observations that are kept: it reduces noise to 1/16.
MOST = 256
#: Windows, as numbers of the newest observations.
WINDOWS = np.array([1, 2, 3, 4, 6, 8, FEWEST, 14, 20, 28, 40, 56, 80, 112, 160, 208, MOST])
#: Half the mean squared difference of neighbours, as a share of the variance: 1 for noise, near 0 for a motion.
INDEPENDENT = 0.6
#: Mean square of the squared differences over their squared mean. Noise in one direction has 3, an outlier more.
EVEN = 4.0
#: Factor by which the variance may differ in a shorter window, before the noise counts as changed.
SIMILAR = 9.0
#: Standard deviations, m and rad, that are rounding and not noise.
ROUNDING = 1e-9


class PoseFilter:
    """Filters the observations of one frame. It uses neither clock nor chance: equal observations, equal estimates.

    Parameters
    ----------
    memory
        how long an observation counts at most, s; with 0 poses pass as they are. Observations that are further apart
        are not averaged, and the filter starts anew after a gap of this length
    """

    def __init__(self, memory: float) -> None:
        self.memory_ns = round(memory * _SECOND)
        self._parts = _Part(), _Part()
        self.forget()

    def forget(self) -> None:
        """Start anew."""
        self._stamps = np.empty(0, dtype=np.int64)
        self._seen = np.empty((0, 7))
        for part in self._parts:
            part.forget()

    @classmethod
    def compile_kernels(cls) -> None:
        """Observe as many poses as needed until it averages, so that no later one waits for the compiler."""
        poses, rest = cls(1.0), [0.0, 0.0, 0.0, 1.0]
        for i, place in enumerate(1e-3 * np.random.default_rng(0).normal(size=(2 * FEWEST, 3))):
            poses.observe([*place, *rest], i)

    @property
    def noise(self) -> tuple[float, float]:
        """Standard deviations in the direction of most noise, m and rad; 0 where none is known."""
        position, turn = (float(np.sqrt(part.variance)) for part in self._parts)
        return position, turn

    @property
    def is_noisy(self) -> bool:
        """Whether any noise is known."""
        return any(part.variance > 0.0 for part in self._parts)

    @property
    def windows(self) -> tuple[int, int]:
        """Numbers of observations that are averaged in the present position and orientation."""
        position, turn = (part.window for part in self._parts)
        return position, turn

    def observe(self, pose: ArrayLike, stamp_ns: int) -> Array:
        """Add an observation.

        Parameters
        ----------
        pose
            shape (7,) ``[x, y, z, qx, qy, qz, qw]``, m, with a unit quaternion
        stamp_ns
            when it was seen, ns. With a stamp that is not newer than the last one the filter starts anew

        Returns
        -------
        Array
            where the frame is, shape (7,), with a unit quaternion; `pose` itself where nothing is averaged
        """
        seen = np.array(pose, dtype=np.float64)
        if self.memory_ns == 0:
            return seen
        if len(self._stamps) and not 0 < stamp_ns - int(self._stamps[0]) <= self.memory_ns:
            self.forget()
        n = min(int(np.count_nonzero(self._stamps > stamp_ns - self.memory_ns)), MOST - 1)
        self._stamps = np.concatenate([[stamp_ns], self._stamps[:n]])
        self._seen = np.concatenate([seen[None], self._seen[:n]])
        position, turn = self._parts
        shift = position.mean(self._seen[:, :3] - seen[:3])
        turned = turn.mean(turns(np.ascontiguousarray(self._seen[:, 3:])))
        estimate = seen.copy()
        if shift is not None:
            estimate[:3] += shift
        if turned is not None:
            estimate[3:] = quaternion.normalize(quaternion.multiply(quaternion.exp(turned), seen[3:]))
        return estimate


class _Part:
    """Positions or turns of one frame."""

    def __init__(self) -> None:
        self._known, self._mean = np.zeros(2), np.zeros(3)
        self.forget()

    def forget(self) -> None:
        self._known[:] = 0.0
        self.window = 1

    @property
    def variance(self) -> float:
        return float(self._known[0])

    def mean(self, seen: Array) -> Array | None:
        """Mean of the window, (3,); None for a window of one. `seen` (N, 3): newest first, relative to it."""
        if len(seen) >= FEWEST:
            learn(seen, WINDOWS, self._known)
        if self._known[0] == 0.0:
            self.window = 1
            return None
        self.window = int(agreeing(seen, WINDOWS, AGREES * self._known[0], self._mean))
        return self._mean if self.window > 1 else None


@compiled
def learn(seen: Array, windows: NDArray[np.int64], known: Array) -> None:
    """Learn the noise from the longest window that shows it; the shortest window is the newest `FEWEST` observations.

    Parameters
    ----------
    seen
        (N, 3), newest first, the first at the origin
    windows
        lengths of the windows, increasing
    known
        [variance, from how many], which is changed
    """
    longest, variance, k = 0, 0.0, 0
    differ, squares, fourths, spread = 0, 0.0, 0.0, 0.0
    total, products = np.zeros(3), np.zeros((3, 3))
    for n in range(2, len(seen) + 1):
        square = 0.0
        for i in range(3):
            step, value = seen[n - 1, i] - seen[n - 2, i], seen[n - 1, i]
            square += step * step
            total[i] += value
            spread += value * value
            for j in range(3):
                products[i, j] += step * (seen[n - 1, j] - seen[n - 2, j])
        differ += square > ROUNDING**2
        squares += square
        fourths += square * square
        if n == FEWEST and differ == 0:
            known[:] = 0.0  # it repeats itself
            return
        while k < len(windows) and windows[k] < n:
            k += 1
        if n < FEWEST or not (n == len(seen) or (k < len(windows) and windows[k] == n)):
            continue
        about = spread - (total[0] ** 2 + total[1] ** 2 + total[2] ** 2) / n
        independent = 0.5 * squares >= INDEPENDENT * about
        if not (independent and 2 * differ >= n - 1 and fourths * (n - 1) <= EVEN * squares * squares):
            break
        longest, variance = n, np.linalg.eigvalsh(products)[2] / (2.0 * (n - 1))
    if longest == 0:
        return
    similar = known[0] <= SIMILAR * variance and variance <= SIMILAR * known[0]
    if longest >= known[1] or not similar:
        known[0], known[1] = variance if variance > ROUNDING**2 else 0.0, longest


@compiled
def agreeing(seen: Array, windows: NDArray[np.int64], bound: float, mean: Array) -> int:
    """The longest window that agrees with all shorter ones, as those before it do.

    Parameters
    ----------
    seen
        observations, (n, 3)
    windows
        their lengths, ascending
    bound
        of the squared distance of two means, per difference of their inverse lengths
    mean
        (3,), written: the mean of that window

    Returns
    -------
    int
        how many observations the window holds
    """
    total, means, counts = np.zeros(3), np.empty((len(windows) + 1, 3)), np.empty(len(windows) + 1)
    found, k = 0, 0
    for n in range(1, len(seen) + 1):
        for i in range(3):
            total[i] += seen[n - 1, i]
        if not (n == len(seen) or (k < len(windows) and windows[k] == n)):
            continue
        for j in range(found):
            apart = 0.0
            for i in range(3):
                apart += (means[j, i] - total[i] / n) ** 2
            if apart > bound * (1.0 / counts[j] - 1.0 / n):
                return int(counts[found - 1])
        for i in range(3):
            means[found, i] = mean[i] = total[i] / n
        counts[found] = n
        found, k = found + 1, k + 1
    return int(counts[found - 1])


@compiled
def turns(seen: Array) -> Array:
    """Rotation vectors (N, 3) from the first of the unit quaternions (N, 4) to each; the first is 0."""
    out = np.zeros((len(seen), 3))
    x, y, z, w = seen[0]
    for k in range(1, len(seen)):
        a, b, c, d = seen[k]
        vx = -d * x + a * w - b * z + c * y
        vy = -d * y + a * z + b * w - c * x
        vz = -d * z - a * y + b * x + c * w
        cosine = d * w + a * x + b * y + c * z
        sine = math.sqrt(vx * vx + vy * vy + vz * vz)
        scale = 2.0
        if sine > 1e-9:
            scale = 2.0 * math.atan2(sine, abs(cosine)) / sine
        if cosine < 0.0:
            scale = -scale
        out[k, 0], out[k, 1], out[k, 2] = scale * vx, scale * vy, scale * vz
    return out
