# SPDX-License-Identifier: Apache-2.0
"""Time steps of a model as demonstrations of near situations say them: `tpgmm_core.learning.local_weights`.

Only the steps that a time lies between are computed, once for each situation. Where frames stand still that costs
nothing; where they move before each step, a step takes up to three times as long.
"""

from __future__ import annotations

import math
from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from tpgmm_core.common.types import Array
from tpgmm_core.geometry.frame import Frame
from tpgmm_core.geometry.kernels import compiled, copy, copy_rows
from tpgmm_core.geometry.kernels_manifold import move
from tpgmm_core.learning.time_steps import TimeStepTPGMM


class LocalSteps:
    """Means, velocities and covariances of steps, for the situation at hand.

    Parameters
    ----------
    model
        with `shown_`
    points, velocities, within
        (P, T, D), (P, T, n), (P, T, n, n): where all demonstrations count alike; they are written to
    view
        (n,), the layout of what a frame sees, without time
    spheres
        as `Manifold.sphere_starts`, without time
    """

    def __init__(
        self,
        model: TimeStepTPGMM,
        points: Array,
        velocities: Array,
        within: Array,
        view: NDArray[np.intp],
        spheres: NDArray[np.int64],
    ) -> None:
        assert model.shown_ is not None
        self._shown, self._strength = model.shown_, float(model.prior_strength)
        self._locality = float(model.locality)
        self._out = points, velocities, within
        self._alike = points.copy(), velocities.copy(), within.copy()
        self._layout = view, spheres
        P, T, n = velocities.shape
        m = len(self._shown.shown)
        self.n_modes = int(self._shown.modes.max()) + 1
        self._set: int | None = None
        self._deviations = np.zeros((P, T, m, n))
        self._more = np.zeros((P, T, n, n))  # of the covariances: what does not come from how demonstrations differ
        self._isotropic = np.zeros((self.n_modes, P, T, n, n))
        self._freedom = np.zeros(P)
        self._sizes = np.zeros(P, dtype=np.int64)
        for j, (name, deviations) in enumerate(self._shown.deviations.items()):
            manifold = model.frame_manifolds_[name]
            space, size = manifold.subset(range(1, manifold.dim)), deviations.shape[2]
            self._deviations[j, :, :, :size] = np.swapaxes(deviations, 0, 1)
            for k in range(self.n_modes):
                seen = self._shown.seen[j] & (self._shown.modes == k)[:, None]
                B, R = model.predictive(space, deviations, seen)
                self._isotropic[k, j, :, :size, :size] = B
                if k == 0:
                    self._more[j, :, :size, :size] = within[j, :, :size, :size] - R
            self._freedom[j], self._sizes[j] = model.block_size(space), size
        self._seen = np.ascontiguousarray(np.moveaxis(self._shown.seen, 2, 1))  # (P, T, m)
        self._grid = np.ascontiguousarray(next(iter(model.means_.values()))[:, 0])
        self._squares = np.zeros((T, m))
        self._is_fresh = np.zeros(T, dtype=np.bool_)
        self._begin(0)

    def _begin(self, mode: int) -> None:
        self.mode = mode
        self._counted = self._seen & (self._shown.modes == mode)
        self._is_fresh[:] = False

    def choose(self, mode: int | None) -> None:
        """Go a way, from 0; None: that of near situations, which is chosen where a movement begins."""
        self._set = mode
        if mode is not None and mode != self.mode:
            self._begin(mode)

    def situate(self, frames: Mapping[str, Frame]) -> None:
        """Take the places of frames over [time, data]."""
        here = self._shown.places(frames)
        known = np.flatnonzero(np.isfinite(here))
        self._squares[:] = 0.0
        if len(known):
            off = (self._shown.shown[:, :, known] - here[known]) / self._shown.scales[known]
            self._squares[:] = np.mean(off**2, axis=2).T
        self._is_fresh[:] = False

    def at(self, times: Array) -> None:
        """Make the steps that these times lie between those of the situation."""
        if self.n_modes > 1 and self._set is None and times[0] <= self._grid[1]:
            near = np.exp(-0.5 * (self._squares[0] - self._squares[0].min()))
            mode = int(np.argmax(np.bincount(self._shown.modes, near)))
            if mode != self.mode:
                self._begin(mode)
        localise(
            self._grid, times, self._squares, self._locality, self._strength, self._deviations, self._counted,
            self._isotropic[self.mode], self._more, self._freedom, self._sizes, *self._layout, *self._alike, *self._out,
            self._is_fresh,
        )  # fmt: skip

    def weights(self, step: int) -> Array:
        """How much each demonstration counts at a step, of those whose way is gone, (m,)."""
        w = np.empty(len(self._squares[step]))
        weigh(self._squares[step], self._locality, w)
        w *= self._shown.modes == self.mode
        return np.asarray(w / w.sum())


@compiled
def weigh(squares: Array, locality: float, out: Array) -> None:
    """Write weights (m,) of squared distances (m,), which sum to 1."""
    least, total = np.inf, 0.0
    for i in range(len(squares)):
        least = min(least, squares[i])
    for i in range(len(squares)):
        out[i] = math.exp(-0.5 * locality * (squares[i] - least))
        total += out[i]
    for i in range(len(squares)):
        out[i] /= total


@compiled
def localise(
    grid: Array, times: Array, squares: Array, locality: float, strength: float, deviations: Array, seen: Array,
    isotropic: Array, more: Array, freedom: Array, sizes: Array, view: Array, spheres: Array, points: Array,
    velocities: Array, within: Array, out_points: Array, out_velocities: Array, out_within: Array, is_fresh: Array,
) -> None:  # fmt: skip
    """Write the steps before and after each time, where they are not fresh.

    Parameters
    ----------
    grid, times
        (T,) and (H,), s
    squares
        (T, m), squared distances of the demonstrations' places
    locality, strength
        of the model; the strength of its prior
    deviations, seen
        (P, T, m, n), (P, T, m)
    isotropic, more
        (P, T, n, n): the prior's covariance, and what is added to that of the demonstrations
    freedom, sizes
        (P,), dimensions of the smallest block, and of each frame's view
    view, spheres
        layout of a view
    points, velocities, within
        where all demonstrations count alike
    out_points, out_velocities, out_within
        written
    is_fresh
        (T,), which steps are written already; written
    """
    P, T, m, n = deviations.shape
    shifts, of_step, w = np.zeros((3, n)), np.empty(m), np.empty(m)
    for h in range(len(times)):
        before = min(max(np.searchsorted(grid, times[h], side="right") - 1, 0), T - 2)
        for t in range(before, before + 2):
            if is_fresh[t]:
                continue
            is_fresh[t] = True
            for j in range(P):
                size = sizes[j]
                square = 0.0
                for side in range(3):
                    other = min(max(t + side - 1, 0), T - 1)
                    weigh(squares[other], locality, of_step)
                    total = 0.0
                    for i in range(m):
                        of_step[i] *= seen[j, other, i]
                        total += of_step[i]
                    for a in range(size):
                        shifts[side, a] = 0.0
                        if total > 0.0:
                            for i in range(m):
                                shifts[side, a] += of_step[i] / total * deviations[j, other, i, a]
                    if side == 1:
                        for i in range(m):
                            w[i] = of_step[i] / total if total > 0.0 else 0.0
                            square += w[i] * w[i]
                first, last = max(t - 1, 0), min(t + 1, T - 1)
                for a in range(size):
                    out_velocities[j, t, a] = velocities[j, t, a] + (shifts[2, a] - shifts[0, a]) / (
                        grid[last] - grid[first]
                    )
                copy(points[j, t], out_points[j, t])
                if square == 0.0:
                    copy_rows(within[j, t], out_within[j, t])
                    continue
                move(out_points[j, t], shifts[1, :size], view[:size], spheres)
                # as many demonstrations as have the same sum of squared weights, and at least a little of one more
                count = max(1.0 / square, 1.01)
                nu = freedom[j] * (count - 1.0)
                factor = (1.0 + 1.0 / count) * nu / max(nu - 2.0, min(nu, 1.0))
                share = (count - 1.0) / (count - 1.0 + strength)
                for a in range(size):
                    for b in range(size):
                        S = 0.0
                        for i in range(m):
                            S += (
                                w[i] * (deviations[j, t, i, a] - shifts[1, a]) * (deviations[j, t, i, b] - shifts[1, b])
                            )
                        S /= max(1.0 - square, 0.01)
                        out_within[j, t, a, b] = more[j, t, a, b] + factor * (
                            share * S + (1.0 - share) * isotropic[j, t, a, b]
                        )
