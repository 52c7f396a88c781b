# SPDX-License-Identifier: Apache-2.0
"""Information criteria: what a model's parameters cost it. The smaller, the better.

Both treat neighbouring samples as independent, which those of a trajectory are not: they count each sample as new
evidence, and so choose too many components. Leave-one-out over demonstrations (`tpgmm_core.learning.selection`) does
not.
"""

from __future__ import annotations

import math


def bic(log_likelihood: float, n_parameters: int, n_samples: int) -> float:
    """Bayesian information criterion, -2 log L + n_parameters log N (Schwarz, 1978).

    Parameters
    ----------
    log_likelihood
        of all samples together, log L
    n_parameters
        free parameters of the model
    n_samples
        N

    Returns
    -------
    float
        the smaller, the better

    Raises
    ------
    ValueError
        for N < 1
    """
    if n_samples < 1:
        raise ValueError(f"a criterion needs at least one sample, got {n_samples}")
    return -2.0 * log_likelihood + n_parameters * math.log(n_samples)


def aic(log_likelihood: float, n_parameters: int) -> float:
    """Akaike's information criterion, -2 log L + 2 n_parameters (Akaike, 1974).

    Parameters
    ----------
    log_likelihood
        of all samples together, log L
    n_parameters
        free parameters of the model

    Returns
    -------
    float
        the smaller, the better
    """
    return -2.0 * log_likelihood + 2.0 * n_parameters
