# SPDX-License-Identifier: Apache-2.0
"""`Calibrated`: a movement whose covariances are scaled by what was found on demonstrations that were left out."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace

from tpgmm_core.common.text import shown
from tpgmm_core.common.types import Array
from tpgmm_core.geometry.frame import Frame
from tpgmm_core.geometry.gaussian import Gaussian
from tpgmm_core.learning.learned_mixture import LearnedMixture
from tpgmm_core.model.adaptation import UNCONSTRAINED_VARIANCE
from tpgmm_core.model.reference import Reference
from tpgmm_core.retrieval.interface import Retrieval
from tpgmm_core.retrieval.wrapped import Wrapped


def scale_key(method: str) -> str:
    """Key in a model's metadata of the scale for a retrieval method."""
    return f"covariance_scale.{method}"


def covariance_scale(model: LearnedMixture, method: str) -> float:
    """What the covariances of a method's references are to be multiplied by.

    Parameters
    ----------
    model
        with metadata
    method
        the name of the retrieval method

    Returns
    -------
    float
        1 for a model that was not calibrated for this method

    Raises
    ------
    ValueError
        for metadata that hold no positive number there
    """
    scale = model.metadata_.get(scale_key(method), 1.0)
    if not isinstance(scale, int | float) or not (math.isfinite(scale) and scale > 0.0):
        raise ValueError(f"the model's metadata say {scale_key(method)} = {shown(scale)}; expected a number above 0")
    return float(scale)


class Calibrated(Wrapped):
    """A `Retrieval` with the references of another one, whose covariances are scaled.

    A direction that no frame constrains is not known in any way: there, covariances do not become less. `mixture` is
    the model itself, as learned.

    Parameters
    ----------
    retrieval
        the movement
    scale
        of its covariances, above 0
    """

    def __init__(self, retrieval: Retrieval, scale: float) -> None:
        super().__init__(retrieval)
        self._scale = scale

    def step(
        self,
        time_ns: int,
        frames: Mapping[str, Frame],
        state: Array | None = None,
        weights: Mapping[str, float] | None = None,
    ) -> Reference:
        """The reference at a time: see `Retrieval.step`."""
        reference = self._retrieval.step(time_ns, frames, state, weights)
        return replace(
            reference,
            gaussian=self._scaled(reference.gaussian),
            horizon=tuple(map(self._scaled, reference.horizon)),
        )

    def horizon(self, n: int, dt: float) -> list[Gaussian]:
        """The next n Gaussians, dt (s) apart: see `Retrieval.horizon`."""
        return [self._scaled(gaussian) for gaussian in self._retrieval.horizon(n, dt)]

    def _scaled(self, gaussian: Gaussian) -> Gaussian:
        is_free = float(gaussian.covariance.max()) > 0.5 * UNCONSTRAINED_VARIANCE
        scale = max(self._scale, 1.0) if is_free else self._scale
        return Gaussian._made(gaussian.mean, scale * gaussian.covariance, gaussian.manifold)
