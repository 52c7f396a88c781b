# SPDX-License-Identifier: Apache-2.0
"""Whether references are as exact as they say: coverage on what was left out, and a scale that mends it.

A Gaussian of n dimensions says that the squared distance d^2, in units of its covariance, is below the p-quantile of
chi^2_n for a share p of all observations: its coverage of p. What learned covariances leave out (how uncertain means
are, frames that a mixture cannot follow, paces that differ) shows in a coverage that is too low. One scale for all
covariances, d^2 at 90 % over chi^2_n at 90 %, mends the mean of it (split conformal prediction: Vovk et al. 2005; Lei
et al., JASA 2018). Distances come from demonstrations that the model has not seen, and each demonstration counts alike.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from tpgmm_core.choice.reproducing import reproduce_gaussians
from tpgmm_core.common.types import Array
from tpgmm_core.geometry.manifold import Manifold
from tpgmm_core.geometry.region import squared_radius
from tpgmm_core.learning.learned_mixture import LearnedMixture
from tpgmm_core.model.demonstration import Demonstration
from tpgmm_core.retrieval.encodings import VelocityEncoding, encoding_of

LEVELS = (0.5, 0.9, 0.95)
"""Shares whose coverage is told."""
CALIBRATED_AT = 0.9


@dataclass(frozen=True, slots=True)
class Calibration:
    """How well the covariances of a method fit what was left out.

    Parameters
    ----------
    scale
        what its covariances are to be multiplied by
    coverage
        level → share of what was left out inside the region of this level, as the model says it
    scaled_coverage
        the same with covariances scaled, by the scale of all demonstrations but the one that is looked at; as they are
        where there is one demonstration only
    """

    scale: float
    coverage: Mapping[float, float]
    scaled_coverage: Mapping[float, float]

    @classmethod
    def of(cls, distances: Sequence[Array], dimensions: int) -> Calibration:
        """From squared distances.

        Parameters
        ----------
        distances
            of each demonstration left out, (T_i,), as of `squared_distances`
        dimensions
            n of the Gaussians

        Returns
        -------
        Calibration
            one scale for all of them

        Raises
        ------
        ValueError
            where there are no distances
        """
        known = [d[np.isfinite(d)] for d in distances]
        known = [d for d in known if len(d)]
        if not known:
            raise ValueError("calibration needs at least one demonstration that was left out and reproduced")
        scales = [_scale(known[:i] + known[i + 1 :] or known, dimensions) for i in range(len(known))]
        scaled = [d / s for d, s in zip(known, scales, strict=True)] if len(known) > 1 else known
        return cls(_scale(known, dimensions), coverage(known, dimensions), coverage(scaled, dimensions))


def squared_distances(
    model: LearnedMixture, left_out: Demonstration, manifold: Manifold, method: str | None = None
) -> Array:
    """How far a demonstration is from what a model, that has not seen it, does in its situation.

    Parameters
    ----------
    model
        as for `reproduce_gaussians`
    left_out
        [time, point]
    manifold
        of the points, without time
    method
        as for `reproduce_gaussians`

    Returns
    -------
    Array
        squared distances (T,) in units of the covariances; NaN where there is none
    """
    means, covariances = reproduce_gaussians(model, left_out, method)
    return squared_distances_of(means, covariances, left_out.data[:, 1:], manifold, knows_time(model))


def knows_time(model: LearnedMixture) -> bool:
    """Whether a model says when it is where: those of velocities over places do not."""
    return not isinstance(encoding_of(model), VelocityEncoding)


def squared_distances_of(
    means: Array, covariances: Array, points: Array, manifold: Manifold, at_same_time: bool = True
) -> Array:
    """Squared distances of points from Gaussians, in units of the covariances.

    Parameters
    ----------
    means
        (T, D)
    covariances
        (T, n, n)
    points
        (T, D)
    manifold
        of the points
    at_same_time
        whether each point is compared with the Gaussian of its time, or with the one that it is nearest to

    Returns
    -------
    Array
        (T,); NaN where a covariance is not known
    """
    if not at_same_time:
        known = np.flatnonzero(np.isfinite(covariances).all(axis=(1, 2)))
        to_each = [_from_gaussian(means[i], covariances[i], points, manifold) for i in known]
        return np.min(to_each, axis=0) if to_each else np.full(len(points), np.nan)
    steps = manifold.log(means, points)
    found = np.full(len(means), np.nan)
    is_known = np.isfinite(covariances).all(axis=(1, 2))
    if is_known.any():
        whitened = np.linalg.solve(covariances[is_known], steps[is_known][:, :, None])[:, :, 0]
        found[is_known] = np.einsum("ti,ti->t", steps[is_known], whitened)
    return found


def _from_gaussian(mean: Array, covariance: Array, points: Array, manifold: Manifold) -> Array:
    steps = manifold.log(mean, points)
    return np.einsum("ti,it->t", steps, np.linalg.solve(covariance, steps.T))


def coverage(distances: Sequence[Array], dimensions: int) -> dict[float, float]:
    """Level → share of squared distances, of several demonstrations, that lie inside the region of this level.

    Parameters
    ----------
    distances
        (T_i,) of each demonstration, which all count alike
    dimensions
        n of the Gaussians

    Returns
    -------
    dict[float, float]
        for all LEVELS
    """
    return {
        level: float(np.mean([np.mean(d <= squared_radius(level, dimensions)) for d in distances])) for level in LEVELS
    }


def _scale(distances: Sequence[Array], dimensions: int) -> float:
    """The factor that brings as many of the distances inside the region of CALIBRATED_AT as should be there."""
    everything = np.concatenate(distances)
    weights = np.concatenate([np.full(len(d), 1.0 / len(d)) for d in distances])
    order = np.argsort(everything)
    share = np.cumsum(weights[order]) / weights.sum()
    found = everything[order][np.searchsorted(share, CALIBRATED_AT)]
    return float(max(found, 1e-12) / squared_radius(CALIBRATED_AT, dimensions))
