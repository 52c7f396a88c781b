# SPDX-License-Identifier: Apache-2.0
"""`disagreement`: why Gaussians contradict each other so much that they have no product, in words."""

from __future__ import annotations

import itertools
from collections.abc import Mapping
from typing import Protocol

import numpy as np

from tpgmm_core.common.text import shown
from tpgmm_core.common.types import Array
from tpgmm_core.geometry.coordinates import Sphere
from tpgmm_core.geometry.manifold import Manifold

FAR = 3.0
"""Standard deviations: orientations that are nearer do not contradict each other by themselves."""


class Located(Protocol):
    """What is needed of a Gaussian here; a protocol, since `gaussian.py` imports this module."""

    @property
    def mean(self) -> Array:
        """A point of the manifold, in ambient coordinates (D,)."""

    @property
    def covariance(self) -> Array:
        """Covariance in the tangent space at the mean, (n, n)."""

    @property
    def manifold(self) -> Manifold:
        """The space in which the mean lies."""


def disagreement(gaussians: Mapping[str, Located]) -> str:
    """Say which two of the Gaussians are farthest apart, in what, and how far compared with their standard deviations.

    The learned relation between place and orientation is linear. Far from where it was learned it asks for more than a
    whole turn, so that orientations have no product although they would agree if the places did.

    Parameters
    ----------
    gaussians
        at least two, on one manifold with S³ factors, by the names that the text uses for them

    Returns
    -------
    str
        one sentence
    """
    found: tuple[float, str] = (-1.0, "")
    for (first, a), (second, b) in itertools.combinations(gaussians.items(), 2):
        manifold = a.manifold
        step, spread = manifold.log(a.mean, b.mean), a.covariance + b.covariance
        for sphere in manifold.spheres:
            between = _between(first, second, step, spread, manifold, sphere)
            found = between if between[0] > found[0] else found
    return f"they contradict each other: {found[1]}"


def no_product(what: str, views: Mapping[str, Located]) -> ValueError:
    """Make the error for a product that did not converge.

    Parameters
    ----------
    what
        whose product it is
    views
        frame → its Gaussian in the common frame

    Returns
    -------
    ValueError
        the error, for the caller to raise
    """
    return ValueError(
        f"the frames do not agree on {what}; {disagreement(views)}. Bring the frames closer to demonstrated "
        "situations, or trust some of them less (weights)"
    )


def _between(
    first: str, second: str, step: Array, spread: Array, manifold: Manifold, sphere: Sphere
) -> tuple[float, str]:
    """How many standard deviations two poses are apart, and a sentence about it."""
    turn = sphere.tangent
    place = slice(turn.start - 3, turn.start)
    has_place = turn.start >= 3 and set(range(place.start, place.stop)) <= set(manifold.flat_tangent.tolist())
    turned, far_turned = np.degrees(np.linalg.norm(step[turn])), _deviations(step[turn], spread[turn, turn])
    both = f"what {shown(first)} and {shown(second)} expect"
    words = (
        f"{both} differs by {turned:.3g} deg in orientation, {far_turned:.1f} standard deviations of what was learned"
    )
    if not has_place:
        return far_turned, words
    apart, far = np.linalg.norm(step[place]), _deviations(step[place], spread[place, place])
    if far <= far_turned:
        return far_turned, words
    words = (
        f"{both} is {apart:.3g} m apart, {far:.1f} standard deviations of what was learned; over such a "
        "distance, the learned dependence of the orientation on the position leads to impossible turns"
    )
    if far_turned > FAR:
        words += f" (it also differs by {turned:.3g} deg in orientation)"
    return far, words


def _deviations(step: Array, covariance: Array) -> float:
    return float(np.sqrt(max(0.0, float(step @ np.linalg.pinv(covariance, hermitian=True) @ step))))
