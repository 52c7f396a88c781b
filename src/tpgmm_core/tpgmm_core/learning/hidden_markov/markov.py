# SPDX-License-Identifier: Apache-2.0
"""Hidden chains of states over demonstrations: a Markov chain, and a semi-Markov chain with explicit durations.

Both offer the same: the states of given samples (`posteriors`, `most_likely`), the M-step from that
(`maximised`), and how they go on by themselves (`state_probabilities`). They know nothing of Gaussians: samples
come as log-densities (N, K), demonstrations one after the other, with their lengths.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike, NDArray

from tpgmm_core.common.types import Array
from tpgmm_core.learning.hidden_markov import kernels_hmm, kernels_hsmm
from tpgmm_core.learning.hidden_markov.durations import Durations

MAX_TABLE = 2_000_000
"""Largest number of states times durations that a model file may ask for."""
NEVER = 1e-10  # states that are expected less often than this keep their probabilities


@dataclass(frozen=True, slots=True, eq=False)
class Posteriors:
    """Expected states: what the M-steps need.

    Parameters
    ----------
    log_likelihood
        sum over the demonstrations
    responsibilities
        shape (N, K)
    starts
        shape (K,), expected numbers
    transitions
        shape (K, K), expected numbers
    durations
        shape (K, L), expected numbers; (K, 0) for a Markov chain
    """

    log_likelihood: float
    responsibilities: Array
    starts: Array
    transitions: Array
    durations: Array


@dataclass(frozen=True, slots=True, eq=False)
class MarkovChain:
    """Hidden Markov chain (Rabiner, 1989).

    Parameters
    ----------
    start
        shape (K,), sums to 1
    transitions
        shape (K, K), rows sum to 1. What is zero stays zero
    """

    start: Array
    transitions: Array

    @classmethod
    def of(cls, topology: str | ArrayLike, mean_durations: Array) -> MarkovChain:
        """A chain to start EM from.

        Parameters
        ----------
        topology
            see `_structure`
        mean_durations
            shape (K,), samples: they determine the probability of staying in a state

        Returns
        -------
        MarkovChain
            the chain
        """
        start, onwards = _structure(topology, len(mean_durations))
        if not isinstance(topology, str):
            return cls(start, onwards + np.diag(1.0 - onwards.sum(axis=1)))
        ends = np.where(onwards.sum(axis=1) > 0.0, 1.0 / np.maximum(mean_durations, 2.0), 0.0)
        return cls(start, ends[:, None] * onwards + np.diag(1.0 - ends))

    @property
    def log_prior(self) -> float:
        """0: there is no prior."""
        return 0.0

    @property
    def n_parameters(self) -> int:
        """Free probabilities: those that are not zero, less one of each distribution."""
        return _free(self.start[None]) + _free(self.transitions)

    def posteriors(self, log_densities: Array, lengths: Sequence[int]) -> Posteriors:
        """E-step by forward-backward.

        Parameters
        ----------
        log_densities
            shape (N, K)
        lengths
            number of samples of each demonstration

        Returns
        -------
        Posteriors
            probabilities of the states and expected numbers, added up over the sequences

        Raises
        ------
        ValueError
            for a demonstration that the chain cannot produce
        """
        N, K = log_densities.shape
        found = Posteriors(0.0, np.empty((N, K)), np.zeros(K), np.zeros((K, K)), np.zeros((K, 0)))
        total = 0.0
        for i, part in enumerate(_parts(lengths)):
            log_likelihood = kernels_hmm.posteriors(
                *self._logarithms(), log_densities[part], found.responsibilities[part], found.starts, found.transitions
            )
            _check_possible(log_likelihood, i)
            total += log_likelihood
        return replace(found, log_likelihood=total)

    def maximised(self, found: Posteriors) -> MarkovChain:
        """M-step (Baum-Welch): probabilities in proportion to the expected numbers."""
        return MarkovChain(
            _shares(found.starts[None], self.start[None])[0], _shares(found.transitions, self.transitions)
        )

    def most_likely(self, log_densities: Array, lengths: Sequence[int]) -> tuple[NDArray[np.intp], float]:
        """The likeliest states (N,) (Viterbi), and the logarithm of their joint density with the samples."""
        states, total = np.empty(len(log_densities), dtype=np.intp), 0.0
        for i, part in enumerate(_parts(lengths)):
            value = kernels_hmm.viterbi(*self._logarithms(), log_densities[part], states[part])
            _check_possible(value, i)
            total += value
        return states, total

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
        """Make a chain from the arrays that `arrays` gave.

        Parameters
        ----------
        arrays
            by name
        n_states
            K

        Returns
        -------
        MarkovChain
            the chain

        Raises
        ------
        ValueError
            for arrays that are no chain of K states
        """
        start, transitions = _checked_probabilities(arrays, n_states)
        return cls(start, transitions)

    def _logarithms(self) -> tuple[Array, Array]:
        return _log(self.start), _log(self.transitions)


@dataclass(frozen=True, slots=True, eq=False)
class SemiMarkovChain:
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

    start: Array
    transitions: Array
    durations: Durations

    @classmethod
    def of(cls, topology: str | ArrayLike, mean_durations: Array, max_duration: int) -> SemiMarkovChain:
        """A chain to start EM from.

        Parameters
        ----------
        topology
            see `_structure`
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
        start, onwards = _structure(topology, len(mean_durations))
        if np.diagonal(onwards).any():
            raise ValueError(
                "the states of a semi-Markov chain last by themselves: give transitions without a diagonal"
            )
        return cls(start, onwards, Durations.around(mean_durations, max_duration))

    @property
    def log_prior(self) -> float:
        """Logarithm of the prior of the durations."""
        return self.durations.log_prior

    @property
    def n_parameters(self) -> int:
        """Free probabilities, and two for each duration."""
        return _free(self.start[None]) + _free(self.transitions) + self.durations.natural.size

    def posteriors(self, log_densities: Array, lengths: Sequence[int]) -> Posteriors:
        """E-step by forward-backward with durations.

        Parameters
        ----------
        log_densities
            shape (N, K)
        lengths
            number of samples of each demonstration

        Returns
        -------
        Posteriors
            probabilities of the states and expected numbers, added up over the sequences

        Raises
        ------
        ValueError
            for a demonstration that the chain cannot produce
        """
        N, K = log_densities.shape
        counts = np.zeros((K, self.durations.max_duration))
        found = Posteriors(0.0, np.empty((N, K)), np.zeros(K), np.zeros((K, K)), counts)
        total, logarithms = 0.0, self._logarithms()
        for i, part in enumerate(_parts(lengths)):
            log_likelihood = kernels_hsmm.posteriors(
                *logarithms, log_densities[part],
                found.responsibilities[part], found.starts, found.transitions, found.durations,
            )  # fmt: skip
            _check_possible(log_likelihood, i)
            total += log_likelihood
        return replace(found, log_likelihood=total)

    def maximised(self, found: Posteriors) -> SemiMarkovChain:
        """M-step: probabilities in proportion to the expected numbers, durations by `Durations.maximised`."""
        return SemiMarkovChain(
            _shares(found.starts[None], self.start[None])[0],
            _shares(found.transitions, self.transitions),
            self.durations.maximised(found.durations),
        )

    def most_likely(self, log_densities: Array, lengths: Sequence[int]) -> tuple[NDArray[np.intp], float]:
        """The likeliest states (N,) (Viterbi), and the logarithm of their joint density with the samples."""
        states, total, logarithms = np.empty(len(log_densities), dtype=np.intp), 0.0, self._logarithms()
        for i, part in enumerate(_parts(lengths)):
            value = kernels_hsmm.viterbi(*logarithms, log_densities[part], states[part])
            _check_possible(value, i)
            total += value
        return states, total

    def state_probabilities(self, n_steps: int) -> Array:
        """Probabilities of the states when nothing is observed; a state that nothing follows goes on.

        Parameters
        ----------
        n_steps
            number of steps

        Returns
        -------
        Array
            shape (n_steps, K)
        """
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
        """Make a chain from the arrays that `arrays` gave.

        Parameters
        ----------
        arrays
            by name
        n_states
            K

        Returns
        -------
        SemiMarkovChain
            the chain

        Raises
        ------
        ValueError
            for arrays that are no chain of K states
        """
        start, transitions = _checked_probabilities(arrays, n_states)
        natural, prior_moments = arrays["durations"], arrays["duration_prior_moments"]
        longest = float(arrays["max_duration"].item())
        if not natural.shape == prior_moments.shape == (n_states, 2) or not 1.0 <= longest <= MAX_TABLE / n_states:
            raise ValueError(
                f"durations of {n_states} states are of shape {(n_states, 2)} and 1 to {MAX_TABLE // n_states} samples "
                f"long, got {natural.shape}, {prior_moments.shape}, {longest}"
            )
        return cls(start, transitions, Durations(natural, int(longest), prior_moments))

    def _logarithms(self) -> tuple[Array, Array, Array]:
        return _log(self.start), _log(self.transitions), self.durations.log_probabilities


def _structure(topology: str | ArrayLike, K: int) -> tuple[Array, Array]:
    """Start (K,) and transitions (K, K) from a state to others.

    "left-right": from the first state, each followed by the next. "ergodic": any start, any order. An array
    (K, K): these transitions, from any start, where zeros mean never, and a row of zeros that nothing follows.
    """
    if isinstance(topology, str):
        if topology == "left-right":
            return np.eye(K)[0], np.eye(K, k=1)
        if topology == "ergodic":
            return np.full(K, 1.0 / K), (np.ones((K, K)) - np.eye(K)) / max(K - 1, 1)
        raise ValueError(f'transitions are "left-right", "ergodic" or an array ({K}, {K}), got {topology!r}')
    array = np.array(topology, dtype=float)
    if array.shape != (K, K) or not np.all(np.isfinite(array)) or array.min() < 0.0:
        raise ValueError(f"transitions are probabilities of shape {(K, K)}, got {topology!r}")
    sums = array.sum(axis=1, keepdims=True)
    return np.full(K, 1.0 / K), np.divide(array, sums, out=array, where=sums > 0.0)


def _checked_probabilities(arrays: Mapping[str, Array], K: int) -> tuple[Array, Array]:
    start, transitions = arrays["start"], arrays["transitions"]
    if start.shape != (K,) or transitions.shape != (K, K):
        raise ValueError(
            f"a chain of {K} states has {(K,)} and {(K, K)} numbers, got {start.shape}, {transitions.shape}"
        )
    for rows in (start[None], transitions):
        sums = rows.sum(axis=1)
        if rows.min() < 0.0 or not np.all(np.isclose(sums, 1.0, atol=1e-6) | (sums == 0.0)):
            raise ValueError("the probabilities of a chain are from 0 and sum to 1")
    return start, transitions


def _shares(numbers: Array, former: Array) -> Array:
    """Rows of expected numbers as probabilities; rows of nothing stay as they were."""
    sums = numbers.sum(axis=1, keepdims=True)
    return np.where(sums > NEVER, numbers / np.maximum(sums, NEVER), former)


def _free(probabilities: Array) -> int:
    return int(np.sum(np.maximum(np.count_nonzero(probabilities, axis=1) - 1, 0)))


def _log(probabilities: Array) -> Array:
    with np.errstate(divide="ignore"):
        return np.log(probabilities)


def _parts(lengths: Sequence[int]) -> Iterator[slice]:
    ends = np.cumsum(lengths)
    return (slice(end - length, end) for end, length in zip(ends, lengths, strict=True))


def _check_possible(log_likelihood: float, i: int) -> None:
    if not log_likelihood > -np.inf:
        raise ValueError(
            f"demonstration {i} has likelihood {log_likelihood}: no sequence of states fits it; "
            "check the transitions, and that max_duration times the states covers the demonstration"
        )
