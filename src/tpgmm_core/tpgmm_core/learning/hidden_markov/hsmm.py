# SPDX-License-Identifier: Apache-2.0
"""`TPHSMM`: a hidden semi-Markov model whose states have explicit durations, seen from several frames (Section 7)."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from tpgmm_core.common.types import Array
from tpgmm_core.geometry.manifold import Manifold
from tpgmm_core.learning.hidden_markov.hmm import TPHMM
from tpgmm_core.learning.hidden_markov.markov import SemiMarkovChain
from tpgmm_core.learning.tpgmm import TPGMM


class TPHSMM(TPHMM):
    """Hidden semi-Markov model that is observed from several frames at once (Yu, 2010).

    As `TPHMM`, but how long a state lasts is learned explicitly, log-normal (see `Durations`); in a Markov chain
    every duration is geometric, whose most probable value is one sample. The first state begins with the demonstration,
    and the last one ends with it. Parameters and attributes that are not listed here are those of `TPHMM`.

    Parameters
    ----------
    transitions
        as for `TPHMM`, without a diagonal: a state is followed by another one
    max_duration
        longest duration of a state, in samples; None: the longest demonstration. Cost grows with it

    Attributes
    ----------
    mean_durations_, std_durations_
        shape (K,), samples
    chain_
        the `SemiMarkovChain`, whose `durations` are the whole distributions
    """

    chain_: SemiMarkovChain

    def __init__(
        self,
        n_components: int = 3,
        init: str | ArrayLike | TPGMM = "bins",
        reg_covar: float = 1e-4,
        tol: float = 1e-5,
        max_iter: int = 100,
        random_state: int | np.random.Generator | None = 0,
        manifold: str | Manifold = "euclidean",
        regularization: str = "add",
        n_init: int = 1,
        covariance: str = "full",
        n_factors: int = 1,
        covariance_options: Mapping[str, Any] | None = None,
        transitions: str | ArrayLike = "left-right",
        max_duration: int | None = None,
        prior_strength: float = 0.0,
    ) -> None:
        super().__init__(
            n_components, init, reg_covar, tol, max_iter, random_state, manifold, regularization, n_init,
            covariance, n_factors, covariance_options, transitions, prior_strength,
        )  # fmt: skip
        self.max_duration = max_duration

    @property
    def mean_durations_(self) -> Array:
        """Expected durations of the states, (K,), samples."""
        return self.chain_.durations.means

    @property
    def std_durations_(self) -> Array:
        """Standard deviations (K,) of the durations, samples."""
        return self.chain_.durations.standard_deviations

    def likeliest_course(self, n_steps: int) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
        """The most probable states and their durations of a movement.

        The maximum of the forward variable when nothing is observed (Yu 2010; Calinon et al., ICRA 2011). The movement
        ends in a state that nothing follows, where there is one.

        Parameters
        ----------
        n_steps
            length of the movement, samples

        Returns
        -------
        tuple[NDArray[np.intp], NDArray[np.intp]]
            states and durations in samples, both (S,)

        Raises
        ------
        ValueError
            when no sequence of states lasts that long
        """
        self._check_fitted()
        K = len(self.priors_)
        log_densities = np.zeros((n_steps, K))
        goes_on = self.transitions_.any(axis=1)
        if not goes_on.all():
            log_densities[-1:, goes_on] = -np.inf
        try:
            states, _ = self.chain_.most_likely(log_densities, [n_steps])
        except ValueError:
            raise ValueError(
                f"no sequence of the {K} states lasts {n_steps} samples: transitions give their order, and each lasts "
                "1 to max_duration samples"
            ) from None
        begins = np.flatnonzero(np.diff(states, prepend=-1))
        return states[begins], np.diff(begins, append=n_steps)

    def _check_parameters(self) -> None:
        super()._check_parameters()
        L = self.max_duration
        if L is not None and (not isinstance(L, int | np.integer) or isinstance(L, bool) or L < 1):
            raise ValueError(f"max_duration is a number of samples from 1, or None, got {L!r}")

    def _new_chain(self, mean_durations: Array, longest: int) -> SemiMarkovChain:
        return SemiMarkovChain.of(self.transitions, mean_durations, int(self.max_duration or longest))

    def _restore(self, arrays: Mapping[str, Array]) -> None:
        self._learned_chain(SemiMarkovChain.from_arrays(arrays, len(self.priors_)))
