# SPDX-License-Identifier: Apache-2.0
"""The loop of every EM here: one step after another, until a step gains too little."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from tpgmm_core.common.types import Array

MIN_ITERATIONS = 5  # the gain of the first iterations may be small on a plateau

EmProgress = Callable[[int, float], None]
"""Called with the number of the iteration and the log-likelihood per sample."""


class IterationHistory(NamedTuple):
    """What the iterations came to, one number for each; converged : whether the last one gained too little."""

    log_likelihoods: Array
    objectives: Array
    converged: bool


def iterate(
    step: Callable[[], tuple[float, float]], *, tol: float, max_iter: int, progress: EmProgress | None = None
) -> IterationHistory:
    """Iterate until a step gains less than `tol`, at the earliest after 5 steps.

    Parameters
    ----------
    step : callable
        Expectation and maximisation; returns the log-likelihood and the objective before its M-step, both per sample.
    tol : float
        Least gain of the objective.
    max_iter : int
        Most steps.
    progress : callable, optional
        Called after each step.

    Returns
    -------
    IterationHistory
        Both numbers of each step.
    """
    log_likelihoods: list[float] = []
    objectives: list[float] = []
    converged = False
    for iteration in range(1, max_iter + 1):
        log_likelihood, objective = step()
        log_likelihoods.append(log_likelihood)
        objectives.append(objective)
        if progress is not None:
            progress(iteration, log_likelihood)
        if iteration >= MIN_ITERATIONS and objectives[-1] - objectives[-2] < tol:
            converged = True
            break
    return IterationHistory(np.array(log_likelihoods), np.array(objectives), converged)
