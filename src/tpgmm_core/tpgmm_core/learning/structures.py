# SPDX-License-Identifier: Apache-2.0
"""Which class keeps the covariances of which structure."""

from __future__ import annotations

from tpgmm_core.learning.classical import (
    DiagonalCovariances,
    FullCovariances,
    SphericalCovariances,
    TiedCovariances,
)
from tpgmm_core.learning.structure import Covariances, Structure

_CLASSES: dict[str, type[Covariances]] = {
    "full": FullCovariances,
    "diag": DiagonalCovariances,
    "spherical": SphericalCovariances,
    "tied": TiedCovariances,
}


def covariances_class(structure: Structure) -> type[Covariances]:
    """The class that starts, keeps and restores covariances of this structure."""
    return _CLASSES[structure.name]
