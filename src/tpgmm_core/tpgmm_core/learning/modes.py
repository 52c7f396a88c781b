# SPDX-License-Identifier: Apache-2.0
"""Ways in which demonstrations do the same thing, such as past an obstacle on the left or on the right.

A mean of two ways is none of them. What no frame explains tells them apart: with all demonstrations in one model, at
each step a demonstration is off by r_i(t) from the product of the frames' Gaussians, as seen from the frame that is
surest there. Where demonstrations do one thing, these scatter about zero; where they do two, they fall into two groups
with nothing between. At each step they are divided in two by average linkage. The division with the largest silhouette
(Rousseeuw 1987) is taken for two ways if, for a tenth of the time at least, it is found as it is, is CLEAR, and parts
the groups by APART of the length of the movement. Each group may consist of several ways again.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import scipy
from numpy.typing import NDArray

from tpgmm_core.common.types import Array
from tpgmm_core.geometry.manifold import Manifold
from tpgmm_core.learning.estimation.initialization import Labels
from tpgmm_core.model.demonstration import Demonstration

FEWEST = 3
"""Demonstrations of each way: of fewer, any one that is a little off would be a way of its own."""
CLEAR = 0.7
"""Least mean silhouette: 1 for groups that are points, 0 for none."""
APART = 0.05
LEAST = 1e-9
"""Share of the largest variance that any direction has at least: of demonstrations that are the same."""
LASTING = 0.1
"""Share of the time that ways differ for, at least."""


def find_modes(
    centres: Sequence[Array], within: Sequence[Array], demonstrations: Sequence[Demonstration], space: Manifold
) -> Labels:
    """Which way each demonstration goes.

    Parameters
    ----------
    centres, within
        of each frame, means (T, D) and covariances (T, n, n) at the time steps, of all demonstrations together
    demonstrations
        over [time, data]
    space
        of the data, without time

    Returns
    -------
    Labels
        shape (m,), numbers of the ways from 0, the one of most demonstrations
    """
    m = len(demonstrations)
    labels = np.zeros(m, dtype=np.int64)
    names = list(demonstrations[0].frames)
    flat = space.flat_ambient
    if m < 2 * FEWEST or not len(flat) or any(c.shape[1] != space.dim for c in centres):
        return labels
    means = [c[:, flat] for c in centres]
    covariances = [S[:, space.flat_tangent[:, None], space.flat_tangent] for S in within]
    left = [_unexplained(shown, names, means, covariances, flat) for shown in demonstrations]
    lengths = [np.linalg.norm(np.diff(shown.data[:, 1 + flat], axis=0), axis=1).sum() for shown in demonstrations]
    groups = _divided(np.stack(left), np.arange(m), APART * float(np.median(lengths)))
    for k, group in enumerate(sorted(groups, key=lambda g: (-len(g), g[0]))):
        labels[group] = k
    return labels


def _unexplained(
    shown: Demonstration,
    names: Sequence[str],
    means: Sequence[Array],
    covariances: Sequence[Array],
    flat: NDArray[np.intp],
) -> Array:
    """What is left over of one demonstration, r (T, d): places alone, in the axes of the frame that is surest."""
    T = len(means[0])
    t = shown.times
    steps = np.abs(t[:, None] - np.linspace(t[0], t[-1], T)).argmin(axis=0)
    precision, weighted = np.zeros((T, len(flat), len(flat))), np.zeros((T, len(flat)))
    turns = []
    for name, mean, S in zip(names, means, covariances, strict=True):
        frame = shown.frames[name]
        A = np.broadcast_to(frame.A, (len(t), *frame.A.shape[-2:]))[steps][:, 1 + flat[:, None], 1 + flat]
        b = np.broadcast_to(frame.b, (len(t), frame.b.shape[-1]))[steps][:, 1 + flat]
        seen = shown.is_visible(name)[steps].astype(float)
        spread = A @ S @ np.swapaxes(A, 1, 2)
        floor = LEAST * max(float(np.trace(spread, axis1=1, axis2=2).max()), LEAST)
        P = seen[:, None, None] * np.linalg.inv(spread + floor * np.eye(len(flat)))
        precision += P
        weighted += np.einsum("tij,tj->ti", P, np.einsum("tij,tj->ti", A, mean) + b)
        turns.append(A)
    known = precision.any(axis=(1, 2))
    precision[~known] = np.eye(len(flat))
    expected = np.linalg.solve(precision, weighted[:, :, None])[:, :, 0]
    surest = np.argmin([np.trace(S, axis1=1, axis2=2) for S in covariances], axis=0)
    A = np.stack(turns)[surest, np.arange(T)]
    off = (shown.data[steps][:, 1 + flat] - expected) * known[:, None]
    return np.linalg.solve(A, off[:, :, None])[:, :, 0]


def _divided(left: Array, members: Labels, apart: float) -> list[Labels]:
    """Groups of members (indices) by what was left over, (m, T, d)."""
    T = left.shape[1]
    found: dict[bytes, list[tuple[float, Labels]]] = {}
    if len(members) >= 2 * FEWEST:
        for t in range(T):
            off = left[members, t]
            distances = np.linalg.norm(off[:, None] - off[None], axis=2)
            if distances.max() < apart:
                continue
            pairs = scipy.spatial.distance.squareform(distances, checks=False)
            halves = scipy.cluster.hierarchy.fcluster(scipy.cluster.hierarchy.linkage(pairs, "average"), 2, "maxclust")
            first = halves == halves[0]
            if min(first.sum(), (~first).sum()) < FEWEST:
                continue
            gap = np.linalg.norm(off[first].mean(axis=0) - off[~first].mean(axis=0))
            clear = _silhouette(distances, first)
            if clear >= CLEAR and gap >= apart:
                found.setdefault(first.tobytes(), []).append((clear, first.astype(np.int64)))
    lasting = [steps for steps in found.values() if len(steps) >= LASTING * T]
    if not lasting:
        return [members]
    first = max(lasting, key=lambda steps: np.mean([clear for clear, _ in steps]))[0][1].astype(bool)
    return [*_divided(left, members[first], apart), *_divided(left, members[~first], apart)]


def _silhouette(distances: Array, first: NDArray[np.bool_]) -> float:
    """Mean over all of (b - a) / max(a, b): a mean distance to the own group, b to the other one."""
    own = np.where(first[:, None] == first[None], distances, 0.0).sum(axis=1)
    size = np.where(first, first.sum(), (~first).sum())
    a = own / np.maximum(size - 1, 1)
    b = np.where(first[:, None] != first[None], distances, 0.0).sum(axis=1) / (len(first) - size)
    return float(np.mean((b - a) / np.maximum(np.maximum(a, b), 1e-300)))
