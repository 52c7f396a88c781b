# SPDX-License-Identifier: Apache-2.0
"""`FittedModel`: what adaptation needs of a model, whatever learned it."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Protocol

from tpgmm_core.common.text import listed
from tpgmm_core.common.types import Array
from tpgmm_core.geometry.manifold import Manifold


class FittedModel(Protocol):
    """Gaussians as seen from frames (Section 3); every estimator of `tpgmm_core.learning` is one.

    It is defined here so that adaptation does not depend on learning.
    """

    @property
    def priors_(self) -> Array:
        """Priors of the components, (K,)."""

    @property
    def means_(self) -> Mapping[str, Array]:
        """Frame → means, (K, D_j)."""

    @property
    def covariances_(self) -> Mapping[str, Array]:
        """Frame → covariances in tangent coordinates, (K, n_j, n_j)."""

    @property
    def manifold_(self) -> Manifold:
        """The space of the demonstrations."""

    @property
    def frame_names_(self) -> tuple[str, ...]:
        """Names of the frames, in the order of the model."""

    @property
    def frame_manifolds_(self) -> Mapping[str, Manifold]:
        """Frame → space of what the frame sees."""


def check_fitted(model: FittedModel) -> None:
    """Raise an error for a model that has learned nothing yet.

    Parameters
    ----------
    model
        such as `TPGMM`

    Raises
    ------
    ValueError
        where an attribute of `FittedModel` is missing
    """
    missing = [name for name in ATTRIBUTES if not hasattr(model, name)]
    if missing:
        raise ValueError(
            f"this {type(model).__name__} is not fitted, it lacks {listed(missing)}: call fit or load first"
        )


ATTRIBUTES = tuple(name for name, item in vars(FittedModel).items() if isinstance(item, property))
