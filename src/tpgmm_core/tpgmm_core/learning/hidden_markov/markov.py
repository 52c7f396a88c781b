# SPDX-License-Identifier: Apache-2.0
"""Hidden chains of states over demonstrations: a Markov chain, and a semi-Markov chain with explicit durations."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from tpgmm_core.common.types import Array
from tpgmm_core.learning.hidden_markov import kernels_hmm, kernels_hsmm
from tpgmm_core.learning.hidden_markov.chain import Chain, Posteriors, checked_probabilities, logarithm, structure
from tpgmm_core.learning.hidden_markov.durations import Durations

MAX_TABLE = 2_000_000
"""Largest number of states times durations that a model file may ask for."""


@dataclass(frozen=True, slots=True, eq=False)
class MarkovChain(Chain):
    """Hidden Markov chain (Rabiner, 1989).

    Parameters
    ----------
    start
        shape (K,), sums to 1
    transitions
        shape (K, K), rows sum to 1. What is zero stays zero
    """

    @classmethod
    def of(cls, topology: str | ArrayLike, mean_durations: Array) -> MarkovChain:
        """A chain to start EM from.

        Parameters
        ----------
        topology
            see `chain.structure`
        mean_durations
            shape (K,), samples: they determine the probability of staying in a state

        Returns
        -------
        MarkovChain
            the chain
        """
        start, onwards = structure(topology, len(mean_durations))
        if not isinstance(topology, str):
            return cls(start, onwards + np.diag(1.0 - onwards.sum(axis=1)))
        ends = np.where(onwards.sum(axis=1) > 0.0, 1.0 / np.maximum(mean_durations, 2.0), 0.0)
        return cls(start, ends[:, None] * onwards + np.diag(1.0 - ends))

    @property
    def log_prior(self) -> float:
        """0: there is no prior."""
        return 0.0

    def maximised(self, found: Posteriors) -> MarkovChain:
        """M-step (Baum-Welch): probabilities in proportion to the expected numbers."""
        return MarkovChain(*self._most_probable(found))

    def state_probabilities(self, n_steps: int) -> Array:
        """Probabilities (n_steps, K) of the states at each step when nothing is observed."""
        probabilities = np.empty((n_steps, len(self.start)))
        p = self.start
        for t in range(n_steps):
            probabilities[t] = p
            p = p @ self.transitions
        return probabilities

    def arrays(self) -> dict[str, Array]:
        """The parameters, as a model file holds them."""
        return {"start": self.start, "transitions": self.transitions}

    @classmethod
    def from_arrays(cls, arrays: Mapping[str, Array], n_states: int) -> MarkovChain:
        """Make a chain of K states from what `arrays` gave."""
        start, transitions = checked_probabilities(arrays, n_states)
        return cls(start, transitions)

    def _forward_backward(
        self, logarithms: tuple[Array, ...], log_densities: Array, occupancy: Array, found: Posteriors
    ) -> float:
        result: float = kernels_hmm.posteriors(*logarithms, log_densities, occupancy, found.starts, found.transitions)
        return result

    def _viterbi(self, logarithms: tuple[Array, ...], log_densities: Array, path: NDArray[np.intp]) -> float:
        result: float = kernels_hmm.viterbi(*logarithms, log_densities, path)
        return result

    def _logarithms(self) -> tuple[Array, Array]:
        return logarithm(self.start), logarithm(self.transitions)


@dataclass(frozen=True, slots=True, eq=False)
class SemiMarkovChain(Chain):
    """Hidden semi-Markov chain with explicit durations (Yu, 2010).

    Parameters
    ----------
    start
        shape (K,), sums to 1
    transitions
        shape (K, K), zero diagonal, rows sum to 1, or to 0 for a state that nothing follows
    durations
        of the states' segments, the first and the last of a demonstration included
    """

    durations: Durations

    @classmethod
    def of(cls, topology: str | ArrayLike, mean_durations: Array, max_duration: int) -> SemiMarkovChain:
        """A chain to start EM from.

        Parameters
        ----------
        topology
            see `chain.structure`
        mean_durations
            shape (K,), samples
        max_duration
            longest duration of a state, samples

        Returns
        -------
        SemiMarkovChain
            the chain

        Raises
        ------
        ValueError
            for transitions that do not fit, and those from a state to itself
        """
        start, onwards = structure(topology, len(mean_durations))
        if np.diagonal(onwards).any():
            raise ValueError("a semi-Markov chain models durations: the diagonal of its transitions must be 0")
        return cls(start, onwards, Durations.around(mean_durations, max_duration))

    @property
    def log_prior(self) -> float:
        """Logarithm of the prior of the durations."""
        return self.durations.log_prior

    @property
    def n_parameters(self) -> int:
        """Free probabilities, and two for each duration."""
        return self._free_probabilities() + self.durations.natural.size

    def maximised(self, found: Posteriors) -> SemiMarkovChain:
        """M-step: probabilities in proportion to the expected numbers, durations by `Durations.maximised`."""
        return SemiMarkovChain(*self._most_probable(found), self.durations.maximised(found.durations))

    def state_probabilities(self, n_steps: int) -> Array:
        """Probabilities (n_steps, K) of the states when nothing is observed; a state that nothing follows goes on."""
        K, L = self.durations.natural.shape[0], self.durations.max_duration
        p = np.exp(self.durations.log_probabilities)
        begins = np.zeros((n_steps + 1, K))
        begins[0] = self.start
        lasts = np.exp(self.durations.log_survival)
        probabilities = np.zeros((n_steps, K))
        for t in range(n_steps):
            ages = np.arange(min(L, t + 1))
            probabilities[t] = np.sum(begins[t - ages] * lasts[:, ages].T, axis=0)
            begins[t + 1] = np.sum(begins[t - ages] * p[:, ages].T, axis=0) @ self.transitions
        final = self.transitions.sum(axis=1) == 0.0
        probabilities[:, final] = np.cumsum(begins[:-1, final], axis=0)
        return probabilities

    def arrays(self) -> dict[str, Array]:
        """The parameters, as a model file holds them."""
        durations = self.durations
        return {
            "start": self.start,
            "transitions": self.transitions,
            "durations": durations.natural,
            "max_duration": np.array([float(durations.max_duration)]),
            "duration_prior_moments": durations.prior_moments,
        }

    @classmethod
    def from_arrays(cls, arrays: Mapping[str, Array], n_states: int) -> SemiMarkovChain:
        """Make a chain of K states from what `arrays` gave.

        Raises
        ------
        ValueError
            for arrays that are no chain of K states
        """
        start, transitions = checked_probabilities(arrays, n_states)
        natural, prior_moments = arrays["durations"], arrays["duration_prior_moments"]
        longest = float(arrays["max_duration"].item())
        if not natural.shape == prior_moments.shape == (n_states, 2) or not 1.0 <= longest <= MAX_TABLE / n_states:
            raise ValueError(
                f"durations of {n_states} states are of shape {(n_states, 2)} and 1 to {MAX_TABLE // n_states} samples "
                f"long, got {natural.shape}, {prior_moments.shape}, {longest}"
            )
        return cls(start, transitions, Durations(natural, int(longest), prior_moments))

    def _no_durations(self, n_states: int) -> Array:
        return np.zeros((n_states, self.durations.max_duration))

    def _forward_backward(
        self, logarithms: tuple[Array, ...], log_densities: Array, occupancy: Array, found: Posteriors
    ) -> float:
        result: float = kernels_hsmm.posteriors(
            *logarithms, log_densities, occupancy, found.starts, found.transitions, found.durations
        )
        return result

    def _viterbi(self, logarithms: tuple[Array, ...], log_densities: Array, path: NDArray[np.intp]) -> float:
        result: float = kernels_hsmm.viterbi(*logarithms, log_densities, path)
        return result

    def _logarithms(self) -> tuple[Array, Array, Array]:
        return logarithm(self.start), logarithm(self.transitions), self.durations.log_probabilities
