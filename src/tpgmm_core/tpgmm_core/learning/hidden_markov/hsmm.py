# SPDX-License-Identifier: Apache-2.0
"""`TPHSMM`: a hidden semi-Markov model whose states have explicit durations, seen from several frames (Section 7)."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from tpgmm_core.common.types import Array
from tpgmm_core.learning.hidden_markov.hmm import TPHMM
from tpgmm_core.learning.hidden_markov.markov import SemiMarkovChain


@dataclass(eq=False, repr=False)
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

    chain_: SemiMarkovChain = field(init=False)

    max_duration: int | None = None

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
        if self.max_duration is not None:
            self._check_integers("max_duration")

    def _new_chain(self, mean_durations: Array, longest: int) -> SemiMarkovChain:
        return SemiMarkovChain.of(self.transitions, mean_durations, int(self.max_duration or longest))

    def _restore(self, arrays: Mapping[str, Array]) -> None:
        self._learned_chain(SemiMarkovChain.from_arrays(arrays, len(self.priors_)))
