# SPDX-License-Identifier: Apache-2.0
"""What one frame saw of demonstrations at the same shares of their time; which of its dimensions are of one thing."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tpgmm_core.common.types import Array
from tpgmm_core.geometry.manifold import Manifold
from tpgmm_core.model.samples import Samples


@dataclass(frozen=True, slots=True, eq=False)
class ShownToFrame:
    """What one frame saw, at the same shares of the time of each demonstration.

    Parameters
    ----------
    space
        of the points, without time
    times
        (T,), of the steps, s: between the mean begin and the mean end
    points
        (m, T, D)
    visible
        (m, T), whether the frame saw them
    everything
        (N, D), all samples that the frame saw
    """

    space: Manifold
    times: Array
    points: Array
    visible: NDArray[np.bool_]
    everything: Array

    @classmethod
    def of(cls, manifold: Manifold, x: Array, seen: Array, samples: Samples, n_steps: int) -> ShownToFrame:
        """Resample what one frame was shown.

        Parameters
        ----------
        manifold
            of [time, point]
        x
            the frame's view, (N, D)
        seen
            (N,), where it was visible
        samples
            that x and seen are of, with their demonstrations
        n_steps
            T, the time steps of each demonstration

        Returns
        -------
        ShownToFrame
            points at the time steps
        """
        space = manifold.subset(range(1, manifold.dim))
        shares = np.linspace(0.0, 1.0, n_steps)
        points, visible, spans = [], [], []
        first = 0
        for length in samples.lengths:
            own = slice(first, first + length)
            first += length
            t = samples.times[own]
            asked = t[0] + shares * (t[-1] - t[0])
            points.append(resampled(space, t, x[own, 1:], asked))
            visible.append(seen[own][np.abs(t[:, None] - asked).argmin(axis=0)])
            spans.append((t[0], t[-1]))
        begin, end = np.mean(spans, axis=0)
        return cls(space, begin + shares * (end - begin), np.stack(points), np.stack(visible), x[seen, 1:])

    def held(self) -> Array:
        """Points of the demonstrations that the frame saw, which stay where it last saw or first sees them.

        So a demonstration of which a part was hidden is a whole path too.

        Returns
        -------
        Array
            shape (m', T, D)
        """
        steps = np.arange(self.points.shape[1])
        held = []
        for points, visible in zip(self.points, self.visible, strict=True):
            seen = np.flatnonzero(visible)
            if len(seen):
                held.append(points[seen[np.abs(steps[:, None] - seen).argmin(axis=1)]])
        return np.stack(held)


def isotropic(space: Manifold, S: Array) -> Array:
    """B (n, n) of the module: the same variance in all directions of a place, and of a turn, as S has on average."""
    B = np.zeros_like(S)
    for block in isotropic_blocks(space):
        size = block.stop - block.start
        B[block, block] = np.trace(S[block, block]) / size * np.eye(size)
    return B


def isotropic_blocks(space: Manifold) -> list[slice]:
    """The tangent dimensions that are places, or turns, of one thing: those of each factor of the space."""
    blocks, first = [], 0
    for kind, size in space.factors:
        n = size if kind == "R" else 3
        blocks.append(slice(first, first + n))
        first += n
    return blocks


def resampled(space: Manifold, times: Array, points: Array, asked: Array) -> Array:
    """Points at times, on the way between the samples.

    Parameters
    ----------
    space
        of the points
    times
        (N,), increasing
    points
        (N, D), the samples
    asked
        (T,), in the units of `times`; before the first and after the last, these last

    Returns
    -------
    Array
        (T, D)
    """
    i = np.clip(np.searchsorted(times, asked, side="right") - 1, 0, len(times) - 2)
    share = np.clip((asked - times[i]) / (times[i + 1] - times[i]), 0.0, 1.0)
    return np.stack(
        [space.exp(p, s * space.log(p, q)) for p, q, s in zip(points[i], points[i + 1], share, strict=True)]
    )
