# SPDX-License-Identifier: Apache-2.0
"""Where EM starts from: one component per sample, the same in all frames, so that components correspond.

The assignments are integers (N,): 0 to K - 1, or -1 for a sample that is left out of the start.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike, NDArray

from tpgmm_core.common.types import Array
from tpgmm_core.geometry.manifold import Manifold
from tpgmm_core.model.samples import Samples

Labels = NDArray[np.intp]


def assignments(
    samples: Samples,
    init: str | ArrayLike,
    n_components: int,
    random_state: int | np.random.Generator | None,
    n_starts: int = 5,
) -> Labels:
    """The component (N,) of each sample that `init` stands for.

    Parameters
    ----------
    samples
        what all frames saw
    init
        "time", "bins", "kmeans", or the labels themselves, integers (N,)
    n_components
        K
    random_state
        seed or generator for k-means
    n_starts
        number of starts of k-means

    Returns
    -------
    Labels
        the component of each sample, (N,); -1 for none

    Raises
    ------
    ValueError
        where a component has no samples, and for labels that do not fit
    """
    if not isinstance(init, str):
        labels = np.asarray(init)
        if labels.shape != (samples.n_samples,) or labels.dtype.kind not in "iu" or labels.max() >= n_components:
            raise ValueError(
                f"labels are integers ({samples.n_samples},) from 0 to {n_components - 1}, or -1 for none; "
                f"got {labels.dtype} {labels.shape}, the largest {labels.max(initial=-1)}"
            )
        labels = labels.astype(np.intp)
    elif init == "time":
        labels = time_bins(samples.times, n_components)
    elif init == "bins":
        labels = equal_bins(samples.lengths, n_components)
    elif init == "kmeans":
        points = joint_points(list(samples.manifolds.values()), list(samples.X.values()), samples.seen)
        labels = kmeans(points, n_components, random_state, n_starts)
    else:
        raise ValueError(f'init is "time", "bins", "kmeans" or an array of labels, got {init!r}')
    counts = np.bincount(labels[labels >= 0], minlength=n_components)
    if counts.min() == 0:
        raise ValueError(f"component {np.argmin(counts)} has no samples at the start: use fewer components")
    return labels


def time_bins(times: Array, n_components: int) -> Labels:
    """Bins of equal width between the first and the last time.

    They are half-open: samples at the last time are left out.

    Parameters
    ----------
    times
        shape (N,), s
    n_components
        number of bins

    Returns
    -------
    Labels
        the bin of each sample, (N,); -1 for none

    Raises
    ------
    ValueError
        when a bin has no sample
    """
    edges = np.linspace(times.min(), times.max(), n_components + 1)
    labels = bins_of(times, edges)
    empty = np.setdiff1d(np.arange(n_components), labels)
    if len(empty):
        k = empty[0]
        raise ValueError(
            f"time bin {k} of {n_components}, {edges[k]:.6g} to {edges[k + 1]:.6g} s, holds no sample: "
            'take fewer components, or init="bins" or "kmeans"'
        )
    return labels


def bins_of(times: Array, edges: Array) -> Labels:
    """The bin (N,) of each time (N,) between edges (K + 1,); -1 for those at the last edge."""
    labels = np.searchsorted(edges, times, side="right") - 1
    labels[times >= edges[-1]] = -1
    return labels


def equal_bins(lengths: Sequence[int], n_components: int) -> Labels:
    """Every demonstration, of `lengths` samples, cut into K parts of as equal counts as possible."""
    return np.concatenate([np.arange(n) * n_components // n for n in lengths])


def joint_points(manifolds: Sequence[Manifold], X: Sequence[Array], seen: NDArray[np.bool_]) -> Array:
    """All frames' views side by side, (N, sum of tangent dimensions), for a joint k-means.

    Every tangent dimension is scaled to unit variance, since seconds, metres and radians do not compare; a view that
    was not seen lies at the frame's mean.

    Parameters
    ----------
    manifolds
        space of each frame's view
    X
        per frame (N, D_j)
    seen
        shape (P, N)

    Returns
    -------
    Array
        shape (N, sum of tangent dimensions)
    """
    views = []
    for manifold, x, mask in zip(manifolds, X, seen, strict=True):
        view = manifold.log(manifold.mean(x[mask]), x)
        view[~mask] = 0.0
        spread = view[mask].std(axis=0)
        views.append(view / np.where(spread > 0.0, spread, 1.0))
    return np.concatenate(views, axis=1)


def kmeans(
    points: Array, n_components: int, random_state: int | np.random.Generator | None, n_starts: int = 5
) -> Labels:
    """k-means from several k-means++ starts; the assignment with the smallest sum of squared distances.

    Parameters
    ----------
    points
        shape (N, D)
    n_components
        number of clusters
    random_state
        seed or generator
    n_starts
        number of starts

    Returns
    -------
    Labels
        shape (N,)

    Raises
    ------
    ValueError
        when there are fewer distinct points than components
    """
    if len(np.unique(points, axis=0)) < n_components:
        raise ValueError(f"the data has fewer distinct samples than the {n_components} components")
    rng = np.random.default_rng(random_state)
    best_inertia, best = np.inf, np.zeros(len(points), dtype=np.intp)
    for _ in range(n_starts):
        centres = _plus_plus(points, n_components, rng)
        labels = np.full(len(points), -1)
        for _ in range(100):
            distances = _squared_distances(points, centres)
            new_labels = np.argmin(distances, axis=1)
            # a centre that lost all its points moves to the point that is farthest from its centre
            for k in np.setdiff1d(np.arange(n_components), new_labels):
                gaps = distances[np.arange(len(points)), new_labels]
                alone = np.bincount(new_labels, minlength=n_components)[new_labels] == 1
                new_labels[np.argmax(np.where(alone, -1.0, gaps))] = k
            if np.array_equal(labels, new_labels):
                break
            labels = new_labels
            centres = np.stack([points[labels == k].mean(axis=0) for k in range(n_components)])
        inertia = float(np.sum((points - centres[labels]) ** 2))
        if inertia < best_inertia:
            best_inertia, best = inertia, labels
    return best


def _plus_plus(points: Array, n_components: int, rng: np.random.Generator) -> Array:
    """Random starting centres (K, D), probably far apart (Arthur and Vassilvitskii, 2007)."""
    centres = points[rng.integers(len(points))][None]
    while len(centres) < n_components:
        nearest = _squared_distances(points, centres).min(axis=1)
        centres = np.vstack([centres, points[rng.choice(len(points), p=nearest / nearest.sum())]])
    return centres


def _squared_distances(points: Array, centres: Array) -> Array:
    return np.stack([np.sum((points - c) ** 2, axis=1) for c in centres], axis=1)


def moments(
    manifold: Manifold, x: Array, seen: NDArray[np.bool_], labels: Labels, n_components: int, reg_covar: float
) -> tuple[Array, Array]:
    """Means and unbiased covariances + reg_covar I of the samples of each label.

    A component of which the frame saw nothing starts from all that the frame saw.

    Parameters
    ----------
    manifold
        of the frame
    x
        samples, (N, D_j)
    seen
        which of them the frame saw, (N,)
    labels
        component of each sample, (N,)
    n_components
        K
    reg_covar
        in the squared units of x

    Returns
    -------
    tuple[Array, Array]
        means (K, D_j) and covariances (K, n, n)
    """
    means, covariances = [], []
    for k in range(n_components):
        chosen = x[seen & (labels == k)]
        if len(chosen) == 0:
            chosen = x[seen]
        mean = manifold.mean(chosen)
        d = manifold.log(mean, chosen)
        means.append(mean)
        covariances.append(d.T @ d / max(len(d) - 1, 1) + reg_covar * np.eye(manifold.tangent_dim))
    return np.stack(means), np.stack(covariances)
