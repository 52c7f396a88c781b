# SPDX-License-Identifier: Apache-2.0
"""The region of a Gaussian that holds a given share of it."""

from __future__ import annotations

from functools import lru_cache

from scipy.special import chdtri

__all__ = ["squared_radius"]


@lru_cache
def squared_radius(share: float, dimensions: int) -> float:
    """Squared Mahalanobis distance within which a share of a Gaussian lies: the quantile of chi-square.

    From `scipy.special`: importing `scipy.stats` would take every node a quarter of a second longer to start.

    Parameters
    ----------
    share
        of the Gaussian's mass, 0 to 1
    dimensions
        n of the Gaussian, which are the degrees of freedom of chi-square

    Returns
    -------
    float
        not negative; infinite for a share of 1
    """
    return float(chdtri(dimensions, 1.0 - share))
