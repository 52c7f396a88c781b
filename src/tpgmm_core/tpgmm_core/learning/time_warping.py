# SPDX-License-Identifier: Apache-2.0
"""Demonstrations of different paces get a common time: dynamic time warping, in all frames at once.

Who shows a movement again dwells longer here and less there. At the same share of the time one demonstration is then
already at the object and another one is not, and their mean is a movement that nobody showed. Each demonstration is
warped to the mean of all, as the frames see it (Sakoe and Chiba 1978, with their slopes from 1/2 to 2). A difference
in a frame counts by the inverse of its variance there: frames in which the demonstrations do the same decide, and those
that do not matter have no say. Mean and warps are found in turn. On the average, time stays as it was.

Only times change: no sample is invented, moved or left out.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import scipy
from numpy.typing import NDArray

from tpgmm_core.common.types import Array
from tpgmm_core.geometry.manifold import Manifold
from tpgmm_core.learning.cycles import interpolated, numbers_of
from tpgmm_core.model.demonstration import Demonstration
from tpgmm_core.model.samples import Samples

KEY = "time_warping"
"""Key in settings."""
SHARES = 100
"""Moments of a movement that are compared, at equal shares of its time."""
ROUNDS = 4
"""Of finding the mean, and warping to it."""
AGREE_M = 0.01
"""Demonstrations that differ by less than this agree: a frame does not count more where they do so by chance."""
RELUCTANCE = 0.3
"""What it costs to change the pace for a step, as a share of the mean difference: noise and rests do not bend time."""
SMOOTH = 0.03
"""Share of the movement over which the pace changes, as a standard deviation."""


def on_common_time(demonstrations: Sequence[Demonstration], manifold: Manifold) -> list[Demonstration]:
    """Demonstrations that are at the same place of the movement at the same share of their time.

    Parameters
    ----------
    demonstrations
        over [time, data], with the same frames
    manifold
        space of their data, time included

    Returns
    -------
    list[Demonstration]
        the same samples at other times; each begins, ends and lasts as before

    Raises
    ------
    ValueError
        for demonstrations that do not agree in dimensions or frames
    """
    numbers, seen = _views(demonstrations, manifold)
    warps = _warps(numbers, seen)
    return [_retimed(shown, warp) for shown, warp in zip(demonstrations, warps, strict=True)]


def _views(demonstrations: Sequence[Demonstration], manifold: Manifold) -> tuple[list[Array], NDArray[np.bool_]]:
    """Numbers of what frames saw at even shares of the time, (M, SHARES, F_j) each; and whether, (J, M, SHARES)."""
    samples = Samples.from_demonstrations(demonstrations, manifold, may_be_unseen=True)
    first = np.cumsum(samples.lengths)[:-1]
    even = [np.linspace(shown.times[0], shown.times[-1], SHARES) for shown in demonstrations]

    def at_even(x: Array) -> Array:
        parts = zip(demonstrations, np.split(x, first), even, strict=True)
        return np.array([interpolated(shown.times, part, times) for shown, part, times in parts])

    numbers = []
    for name, x in samples.X.items():
        space = samples.manifolds[name]
        numbers.append(at_even(numbers_of(space.subset(range(1, space.dim)), x[:, 1:])))
    return numbers, np.array([at_even(seen[:, None].astype(float))[..., 0] for seen in samples.seen]) > 0.5


def _warps(numbers: Sequence[Array], seen: NDArray[np.bool_]) -> Array:
    """Where each demonstration is at even shares of the common time, (M, S) shares of its own, increasing."""
    M, S = seen.shape[1:]
    even = np.linspace(0.0, 1.0, S)
    warps = np.tile(even, (M, 1))
    for _ in range(ROUNDS if M > 1 else 0):
        at = np.clip(np.rint(warps * (S - 1)).astype(int), 0, S - 1)
        costs = _costs(numbers, seen, at)
        found = np.array([_warp(cost) for cost in costs])
        pace = np.pad(found - even, ((0, 0), (S - 1, S - 1)), mode="reflect", reflect_type="odd")
        found = even + scipy.ndimage.gaussian_filter1d(pace, SMOOTH * S, axis=1)[:, S - 1 : 2 * S - 1]
        mean = found.mean(axis=0)
        warps = np.array([np.interp(even, mean, warp) for warp in found])
    return warps


def _costs(numbers: Sequence[Array], seen: NDArray[np.bool_], at: NDArray[np.intp]) -> Array:
    """How far each demonstration m at its sample i is from the mean at k, (M, S, S), m^2: weighted over the frames."""
    M, S = at.shape
    rows = np.arange(M)[:, None]
    total, weights = np.zeros((M, S, S)), np.zeros((M, S, S))
    for x, sees in zip(numbers, seen, strict=True):
        here, counts = x[rows, at], sees[rows, at]
        n = np.maximum(counts.sum(axis=0), 1)
        mean = np.sum(here * counts[..., None], axis=0) / n[:, None]
        variance = np.sum(np.sum((here - mean) ** 2, axis=-1) * counts, axis=0) / np.maximum(n - 1, 1)
        weight = (n > 1) / (variance + AGREE_M**2) * sees[:, :, None]
        squares = np.sum(x**2, axis=-1)[:, :, None] - 2.0 * x @ mean.T + np.sum(mean**2, axis=-1)
        total += weight * squares
        weights += weight
    return np.asarray(total / np.maximum(weights, 1e-12))


def _warp(cost: Array) -> Array:
    """The samples of a demonstration that fit those of the mean best, (S,) as shares: both begin and end together.

    A step goes on by one sample in both, or by two in one of them. Each counts by how far it goes on, so that all ways
    to the end are as long.
    """
    S = len(cost)
    extra = RELUCTANCE * float(np.mean(np.diagonal(cost)))
    best = np.full((S, S), np.inf)
    step = np.zeros((S, S), dtype=np.int8)
    best[0, 0] = cost[0, 0]
    for i in range(1, S):
        ways = np.full((3, S), np.inf)
        ways[0, 1:] = best[i - 1, :-1] + cost[i, 1:]
        ways[1, 2:] = best[i - 1, :-2] + 0.75 * (cost[i, 1:-1] + cost[i, 2:]) + extra
        if i > 1:
            ways[2, 1:] = best[i - 2, :-1] + 0.75 * (cost[i - 1, 1:] + cost[i, 1:]) + extra
        step[i] = np.argmin(ways, axis=0)
        best[i] = np.min(ways, axis=0)
    i = k = S - 1
    on_path = [(i, k)]
    while (i, k) != (0, 0):
        di, dk = ((1, 1), (1, 2), (2, 1))[step[i, k]]
        i, k = i - di, k - dk
        on_path.append((i, k))
    points = np.array(on_path[::-1], dtype=float)
    return np.interp(np.arange(S), points[:, 1], points[:, 0]) / (S - 1)


def _retimed(shown: Demonstration, warp: Array) -> Demonstration:
    """A demonstration whose samples get the times at which the mean is where they are."""
    lasts = shown.times[-1] - shown.times[0]
    if lasts == 0.0:  # of one sample
        return shown
    share = np.interp((shown.times - shown.times[0]) / lasts, warp, np.linspace(0.0, 1.0, len(warp)))
    data = shown.data.copy()
    data[:, 0] = data[0, 0] + share * (data[-1, 0] - data[0, 0])
    return Demonstration(shown.times[0] + share * lasts, data, shown.frames, shown.visible)
