# SPDX-License-Identifier: Apache-2.0
"""The target of a task is known: its object. So the mean that a frame saw is a deviation from it.

In a frame of a task that gave way, the mean is a deviation towards the side on which objects happened to be out of
reach in the demonstrations. As the mean of the model it would become the target, and would be the more certain the less
objects varied; on other paths it would pull aside a task of higher priority. The same demonstrations mirrored, or on
other paths, would have another mean. Their second moment about the object is what they have in common.
"""

from __future__ import annotations

from collections.abc import Collection

import numpy as np

from tpgmm_core.learning.learned_mixture import LearnedMixture


def target_object_origins(model: LearnedMixture, frames: Collection[str], over_time: bool = False) -> None:
    """Make the origins of some frames the targets of a fitted model.

    Each component's mean there becomes zero, and its former mean counts as deviation, Sigma + mu mu^T. For one Gaussian
    this is the maximum of the likelihood with that mean.

    Parameters
    ----------
    model
        is changed
    frames
        whose origins are targets
    over_time
        whether the first dimension is time, which keeps its mean and its variance; deviations then do not depend on it
        within a component

    Raises
    ------
    ValueError
        for frames that the model does not have, and a model whose covariances have a structure
    """
    unknown = sorted(set(frames) - set(model.frame_names_))
    if unknown:
        raise ValueError(f"the model has no frames {unknown}; it has {list(model.frame_names_)}")
    structure = model.emissions_.structure.name
    if structure != "full":
        raise ValueError(f"object targets need a model with full covariances; this one has {structure!r}")
    data = slice(1 if over_time else 0, None)
    for name in frames:
        means, covariances = model.means_[name].copy(), model.covariances_[name].copy()
        mu = means[:, data]
        covariances[:, data, data] += mu[:, :, None] * mu[:, None, :]
        if over_time:
            covariances[:, 0, 1:] = covariances[:, 1:, 0] = 0.0
        means[:, data] = np.zeros_like(mu)
        model.means_[name], model.covariances_[name] = means, covariances
