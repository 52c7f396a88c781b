# SPDX-License-Identifier: Apache-2.0
"""Which frames matter in a model: how many directions of configuration space each of them determines."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from tpgmm_core.geometry.frame import Frame
from tpgmm_core.geometry.mixture import GaussianMixture
from tpgmm_core.learning.learned_mixture import LearnedMixture


def directions_determined(
    model: LearnedMixture, frames: Mapping[str, Frame], time: float | None = None, component: int = 0
) -> dict[str, float]:
    """How many of the n directions each frame determines: the trace of H^-1 H_j.

    H_j = M_j^T Lambda_j M_j is the precision of frame j in configuration space (Eq. 5), H their sum (Eq. 6). It has no
    unit, so that frames over joints, positions and turns can be compared, and adds up to n, or to the number of
    directions that any frame constrains.

    Parameters
    ----------
    model
        over configurations, with or without time
    frames
        over configurations, without time
    time
        of a model over time, s; the Gaussians are then those of regression in each frame
    component
        of a model without time

    Returns
    -------
    dict[str, float]
        name → 0 to n
    """
    precisions = {}
    for name, frame in frames.items():
        if time is None:
            seen = np.linalg.inv(model.covariances_[name][component])
        else:
            mixture = GaussianMixture(model.priors_, model.means_[name], model.covariances_[name])
            seen = mixture.condition([0], [time]).precision
        M = np.linalg.pinv(frame.A) if frame.inverse is None else frame.inverse
        precisions[name] = M.T @ seen @ M
    # directions without any constraint count for no frame
    inverse = np.linalg.pinv(np.sum(list(precisions.values()), axis=0), rcond=1e-12, hermitian=True)
    return {name: float(np.trace(inverse @ H)) for name, H in precisions.items()}
