# SPDX-License-Identifier: Apache-2.0
"""Where new samples need new components: a threshold as in DP-means (Kulis and Jordan, ICML 2012)."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from tpgmm_core.common.types import Array
from tpgmm_core.learning.estimation.emissions import Emissions
from tpgmm_core.learning.estimation.initialization import Labels
from tpgmm_core.model.samples import Samples

MAX_SWEEPS = 1000


@dataclass(frozen=True, slots=True, eq=False)
class NewComponents:
    """Components to add.

    Parameters
    ----------
    counts
        shape (L,), number of samples of each
    means
        name → shape (L, D_j)
    covariances
        name → shape (L, n_j, n_j)
    """

    counts: Array
    means: Mapping[str, Array]
    covariances: Mapping[str, Array]


def new_components(emissions: Emissions, priors: Array, samples: Samples, threshold: float) -> NewComponents | None:
    """New components for samples that are far from all existing ones; None where no samples are.

    A sample is far when its squared Mahalanobis distance to each component, over all frames that saw it, is more
    than `threshold` times the number of its dimensions, which is what one expects of a sample of the component.
    Far samples are clustered by DP-means with the same threshold, in the metric of the components' mean
    covariance (weighted by the priors), which the new components also start from. Clusters with no more
    samples than a frame has dimensions are outliers: too few for a covariance.

    Parameters
    ----------
    emissions
        the existing components
    priors
        shape (K,)
    samples
        the new ones
    threshold
        see above

    Returns
    -------
    NewComponents | None
        None where no samples are far enough, or where all of them are outliers
    """
    sizes = np.array([manifold.tangent_dim for manifold in samples.manifolds.values()])
    dimensions = np.maximum(sizes @ samples.seen, 1)
    distances = np.zeros((samples.n_samples, emissions.n_components))
    for (name, x), seen in zip(samples.X.items(), samples.seen, strict=True):
        manifold, frame = samples.manifolds[name], emissions.frames[name]
        for k, mean in enumerate(emissions.means[name]):
            distances[:, k] += seen * frame.squared_distances(k, manifold.log(mean, x))
    far = np.flatnonzero(distances.min(axis=1) > threshold * dimensions)
    if len(far) == 0:
        return None
    pooled = {name: np.average(C, axis=0, weights=priors) for name, C in emissions.covariances.items()}
    points, weights = [], []
    for (name, x), seen in zip(samples.X.items(), samples.seen, strict=True):
        manifold = samples.manifolds[name]
        d = manifold.log(manifold.mean(x[far]), x[far])
        points.append(np.linalg.solve(np.linalg.cholesky(pooled[name]), d.T).T)
        weights.append(np.repeat(seen[far, None].astype(float), manifold.tangent_dim, axis=1))
    labels = _dp_means(np.hstack(points), np.hstack(weights), threshold)
    members = np.bincount(labels)
    kept = np.flatnonzero(members > sizes.max())
    if len(kept) == 0:
        return None
    means, covariances = {}, {}
    for (name, x), seen in zip(samples.X.items(), samples.seen, strict=True):
        manifold = samples.manifolds[name]
        chosen = [x[far][(labels == k) & seen[far]] for k in kept]
        means[name] = np.stack([manifold.mean(c if len(c) else x[far]) for c in chosen])
        covariances[name] = np.repeat(pooled[name][None], len(kept), axis=0)
    return NewComponents(members[kept].astype(float), means, covariances)


def _dp_means(points: Array, weights: Array, threshold: float) -> Labels:
    """Clusters (N,) of points (N, D) of which only entries of weight 1 were seen; no cluster is empty.

    A point that is farther than the threshold, per dimension seen, from all centres starts its own cluster.
    """
    dimensions = np.maximum(weights.sum(axis=1), 1.0)
    centres = _centre(points, weights)[None]
    labels: Labels = np.zeros(len(points), dtype=np.intp)
    for _ in range(MAX_SWEEPS):
        distances = np.stack([np.sum(weights * (points - c) ** 2, axis=1) / dimensions for c in centres], axis=1)
        new = np.argmin(distances, axis=1)
        if np.array_equal(
            new, labels
        ):  # only then: a point may be far from where its centre was, and near where it goes
            nearest = distances.min(axis=1)
            if nearest.max() <= threshold:
                break
            new[np.argmax(nearest)] = len(centres)
        labels = np.unique(new, return_inverse=True)[1]
        centres = np.stack([_centre(points[labels == k], weights[labels == k]) for k in range(labels.max() + 1)])
    return labels


def _centre(points: Array, weights: Array) -> Array:
    return np.asarray((weights * points).sum(axis=0) / np.maximum(weights.sum(axis=0), 1.0))
