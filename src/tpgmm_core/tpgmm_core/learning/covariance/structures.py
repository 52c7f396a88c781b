# SPDX-License-Identifier: Apache-2.0
"""Which class implements which covariance structure."""

from __future__ import annotations

from tpgmm_core.learning.covariance.classical import (
    DiagonalCovariances,
    FullCovariances,
    SphericalCovariances,
    TiedCovariances,
)
from tpgmm_core.learning.covariance.deep_mfa import DeepFactorAnalyzers
from tpgmm_core.learning.covariance.factor_analyzers import (
    FactorAnalyzers,
    PrincipalComponentAnalyzers,
    SubspaceCovariances,
)
from tpgmm_core.learning.covariance.semi_tied import SemiTiedCovariances
from tpgmm_core.learning.covariance.structure import Covariances, Structure

_CLASSES: dict[str, type[Covariances]] = {
    "full": FullCovariances,
    "diag": DiagonalCovariances,
    "spherical": SphericalCovariances,
    "tied": TiedCovariances,
    "mfa": FactorAnalyzers,
    "mppca": PrincipalComponentAnalyzers,
    "hddc": SubspaceCovariances,
    "semi_tied": SemiTiedCovariances,
    "deep_mfa": DeepFactorAnalyzers,
}


def covariances_class(structure: Structure) -> type[Covariances]:
    """The class that starts, stores and restores covariances of this structure."""
    return _CLASSES[structure.name]
