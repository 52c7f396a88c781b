# SPDX-License-Identifier: Apache-2.0
"""Velocities and accelerations of sampled movements, by parabolas through neighbouring samples."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from tpgmm_core.common.types import Array
from tpgmm_core.geometry.manifold import Manifold


def difference_weights(times: ArrayLike, window: int = 3) -> tuple[NDArray[np.intp], Array]:
    """Weights of the samples of a window in the derivatives at each time.

    Parameters
    ----------
    times
        shape (T,), s, strictly increasing, not necessarily evenly
    window
        number of samples that each parabola is fitted to

    Returns
    -------
    tuple[NDArray[np.intp], Array]
        the first sample of the window of each time, (T,), and weights (3, T, window): x[t] itself, then the first and
        the second derivative of the parabola through the window's samples (by least squares for more than three).
        Windows are centred, except at both ends of the movement. Exact for parabolas

    Raises
    ------
    ValueError
        for less than three samples or a window that is even, below 3 or longer than the movement
    """
    times = np.asarray(times, dtype=float)
    if times.ndim != 1 or len(times) < 3 or not np.all(np.diff(times) > 0.0):
        raise ValueError(f"derivatives need three or more increasing times, got shape {times.shape}")
    if window < 3 or window % 2 == 0 or window > len(times):
        raise ValueError(f"a window is an odd number of samples, 3 to {len(times)} as the movement has, got {window}")
    now = np.arange(len(times))
    first = np.clip(now - window // 2, 0, len(times) - window)
    ahead = times[first[:, None] + np.arange(window)] - times[:, None]
    scale = np.abs(ahead).max(axis=1, keepdims=True)  # so that powers of short times do not spoil the fit
    powers = (ahead / scale)[..., None] ** np.arange(3)
    fit = np.moveaxis(np.linalg.pinv(powers), 1, 0)
    weights = np.stack([np.zeros_like(ahead), fit[1] / scale, 2.0 * fit[2] / scale**2])
    weights[0, now, now - first] = 1.0
    return first, weights


def derivatives(times: ArrayLike, data: ArrayLike, manifold: Manifold, window: int = 3) -> tuple[Array, Array]:
    """Velocity and acceleration of data on a manifold.

    On S³: angular velocity and acceleration about the fixed axes, rad/s and rad/s²; signs of quaternions do not matter.
    Wide windows smooth noise, and also movements that are shorter than the window.

    Parameters
    ----------
    times
        shape (T,), s, strictly increasing
    data
        shape (T, D)
    manifold
        space of the data
    window
        number of samples that each parabola is fitted to

    Returns
    -------
    tuple[Array, Array]
        shape (T, n), in the manifold's units per s, and per s²

    Raises
    ------
    ValueError
        like `difference_weights`
    """
    data = np.asarray(data, dtype=float)
    first, weights = difference_weights(times, window)
    around = data[first[:, None] + np.arange(window)]
    # In the tangent space at x[t], Exp agrees with a plain sum up to the second derivative
    steps = manifold.log(data[:, None], around)
    velocity, acceleration = np.einsum("atw,twi->ati", weights[1:], steps)
    return velocity, acceleration
