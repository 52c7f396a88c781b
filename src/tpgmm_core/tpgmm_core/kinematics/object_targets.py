# SPDX-License-Identifier: Apache-2.0
"""What a task aims at is known: its object. So what a frame saw of it is a deviation, also where that has a mean.

Of a task that gave way, a frame sees a mean deviation: towards the side on which objects happened to be out of reach
in the demonstrations. As a mean of the model it would become the aim, and would be the more certain the less objects
varied; on other paths it pulls aside what had priority. The same demonstrations seen from the mirror, or on other
paths, would have another mean. Their second moment about the object is what they have in common.
"""

from __future__ import annotations

from collections.abc import Collection

import numpy as np

from tpgmm_core.learning.tpgmm import TPGMM


def target_object_origins(model: TPGMM, frames: Collection[str], over_time: bool = False) -> None:
    """Let a fitted model aim at the origins of some frames: each component's mean there becomes zero, and what it
    was is counted as deviation, Sigma + mu mu^T. Of one Gaussian this is the maximum of the likelihood with that mean.

    Parameters
    ----------
    over_time
        the first dimension is time, which keeps its mean and its variance; deviations then do not depend on it within a
        component

    Raises
    ------
    ValueError
        for frames that the model has not, and a model whose covariances have a structure
    """
    unknown = sorted(set(frames) - set(model.frame_names_))
    if unknown:
        raise ValueError(f"the model has no frames {unknown}; it has {list(model.frame_names_)}")
    if model.covariance != "full":
        raise ValueError(f"means go into full covariances only, the model's are {model.covariance!r}")
    data = slice(1 if over_time else 0, None)
    for name in frames:
        means, covariances = model.means_[name].copy(), model.covariances_[name].copy()
        mu = means[:, data]
        covariances[:, data, data] += mu[:, :, None] * mu[:, None, :]
        if over_time:
            covariances[:, 0, 1:] = covariances[:, 1:, 0] = 0.0
        means[:, data] = np.zeros_like(mu)
        model.means_[name], model.covariances_[name] = means, covariances
