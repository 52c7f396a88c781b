# SPDX-License-Identifier: Apache-2.0
"""Leave-one-out over demonstrations: what a model says of one that it was not learned from.

The samples of one demonstration are correlated: a model that has seen some of them knows the others. What is
left out is therefore a whole demonstration (Stone 1974; Arlot and Celisse 2010, Section 8.1).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from copy import deepcopy
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np

from tpgmm_core.common.types import Array
from tpgmm_core.model.demonstration import Demonstration


class SelectableEstimator(Protocol):
    """What a candidate has to offer: `TPGMM` does, and every estimator that is fitted like it."""

    priors_: Array

    def get_params(self, deep: bool = True) -> dict[str, Any]:
        """Constructor arguments by name."""

    def fit(self, demonstrations: Sequence[Demonstration]) -> Any:
        """Learn from demonstrations."""

    def score(self, demonstrations: Sequence[Demonstration]) -> float:
        """Log-likelihood of demonstrations, per sample."""

    @property
    def n_parameters_(self) -> int:
        """Free parameters."""


FoldProgress = Callable[[int, int], None]


@dataclass(frozen=True, slots=True, eq=False)
class HeldOutLikelihood:
    """Log-likelihood of demonstrations under models of the others.

    Parameters
    ----------
    per_demonstration
        shape (M,), per sample of each
    lengths
        shape (M,), samples of each
    """

    per_demonstration: Array
    lengths: Array

    @property
    def per_sample(self) -> float:
        """Mean log-likelihood over all samples."""
        return float(np.average(self.per_demonstration, weights=self.lengths))

    @property
    def standard_error(self) -> float:
        """Standard error of the mean over demonstrations, which are what was drawn independently."""
        return float(np.std(self.per_demonstration, ddof=1) / np.sqrt(len(self.lengths)))


def leave_one_out(
    estimator: SelectableEstimator, demonstrations: Sequence[Demonstration], progress: FoldProgress | None = None
) -> HeldOutLikelihood:
    """Log-likelihood of each demonstration under a model of all others.

    Parameters
    ----------
    estimator
        its constructor arguments say how to fit; it is not changed
    demonstrations
        at least two
    progress
        called with (folds done, folds)

    Returns
    -------
    HeldOutLikelihood
        log-likelihoods per sample, by demonstration

    Raises
    ------
    ValueError
        for fewer than two demonstrations, and what `fit` raises, with the fold
    """
    demonstrations = list(demonstrations)
    if len(demonstrations) < 2:
        raise ValueError(f"leave-one-out needs at least two demonstrations, got {len(demonstrations)}: record more")
    scores = []
    for i, left_out in enumerate(demonstrations):
        try:
            model = unfitted(estimator)
            model.fit(demonstrations[:i] + demonstrations[i + 1 :])
        except ValueError as error:
            raise ValueError(f"without demonstration {i}: {error}") from error
        scores.append(model.score([left_out]))
        if progress is not None:
            progress(i + 1, len(demonstrations))
    return HeldOutLikelihood(np.array(scores), np.array([len(demonstration.times) for demonstration in demonstrations]))


def unfitted(estimator: SelectableEstimator) -> SelectableEstimator:
    """Make an estimator with the same constructor arguments that has not learned anything."""
    return type(estimator)(**deepcopy(estimator.get_params()))
