# SPDX-License-Identifier: Apache-2.0
"""`Chain`: what a Markov chain and a semi-Markov chain of hidden states have in common.

Both give the states of samples (`posteriors`, `most_likely`), the M-step from that (`maximised`), and how they go on
without observations (`state_probabilities`). They know nothing of Gaussians: samples come as log-densities (N, K),
demonstrations one after the other, with their lengths.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Self

import numpy as np
from numpy.typing import ArrayLike, NDArray

from tpgmm_core.common.types import Array

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
class Chain(ABC):
    """A hidden chain of states.

    Parameters
    ----------
    start
        shape (K,), sums to 1
    transitions
        shape (K, K). What is zero stays zero
    """

    start: Array
    transitions: Array

    @property
    @abstractmethod
    def log_prior(self) -> float:
        """Logarithm of the prior of the parameters."""

    @property
    def n_parameters(self) -> int:
        """Free probabilities: those that are not zero, less one of each distribution."""
        return self._free_probabilities()

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
        found = Posteriors(0.0, np.empty((N, K)), np.zeros(K), np.zeros((K, K)), self._no_durations(K))
        total, logarithms = 0.0, self._logarithms()
        for i, part in enumerate(_parts(lengths)):
            log_likelihood = self._forward_backward(
                logarithms, log_densities[part], found.responsibilities[part], found
            )
            _check_possible(log_likelihood, i)
            total += log_likelihood
        return replace(found, log_likelihood=total)

    def most_likely(self, log_densities: Array, lengths: Sequence[int]) -> tuple[NDArray[np.intp], float]:
        """The likeliest states (N,) (Viterbi), and the logarithm of their joint density with the samples."""
        states, total, logarithms = np.empty(len(log_densities), dtype=np.intp), 0.0, self._logarithms()
        for i, part in enumerate(_parts(lengths)):
            value = self._viterbi(logarithms, log_densities[part], states[part])
            _check_possible(value, i)
            total += value
        return states, total

    @abstractmethod
    def maximised(self, found: Posteriors) -> Self:
        """M-step: the most probable parameters, given the expected states."""

    @abstractmethod
    def state_probabilities(self, n_steps: int) -> Array:
        """Probabilities (n_steps, K) of the states at each step when nothing is observed."""

    @abstractmethod
    def arrays(self) -> dict[str, Array]:
        """The parameters, as a model file holds them."""

    @classmethod
    @abstractmethod
    def from_arrays(cls, arrays: Mapping[str, Array], n_states: int) -> Self:
        """Make a chain from what `arrays` gave.

        Parameters
        ----------
        arrays
            by name
        n_states
            K

        Returns
        -------
        Self
            the chain

        Raises
        ------
        ValueError
            for arrays that are no chain of K states
        """

    def _no_durations(self, n_states: int) -> Array:
        """Zeros for the expected durations."""
        return np.zeros((n_states, 0))

    @abstractmethod
    def _logarithms(self) -> tuple[Array, ...]:
        """Logarithms of all probabilities, as the kernels take them."""

    @abstractmethod
    def _forward_backward(
        self, logarithms: tuple[Array, ...], log_densities: Array, occupancy: Array, found: Posteriors
    ) -> float:
        """Of one sequence: writes occupancy (T, K), adds the expected numbers; returns the log-likelihood."""

    @abstractmethod
    def _viterbi(self, logarithms: tuple[Array, ...], log_densities: Array, path: NDArray[np.intp]) -> float:
        """Of one sequence: writes path (T,); returns the logarithm of the joint density."""

    def _free_probabilities(self) -> int:
        return free_probabilities(self.start[None]) + free_probabilities(self.transitions)

    def _most_probable(self, found: Posteriors) -> tuple[Array, Array]:
        """Start and transitions in proportion to the expected numbers (Baum-Welch)."""
        return shares(found.starts[None], self.start[None])[0], shares(found.transitions, self.transitions)


def structure(topology: str | ArrayLike, K: int) -> tuple[Array, Array]:
    """Start and transitions from a state to others.

    Parameters
    ----------
    topology
        "left-right": from the first state, each followed by the next. "ergodic": any start, any order. An array
        (K, K): these transitions, from any start, where zeros mean never, and a row of zeros that nothing follows
    K
        number of states

    Returns
    -------
    tuple[Array, Array]
        start (K,) and transitions (K, K)

    Raises
    ------
    ValueError
        for an unknown name, and an array of another shape or with negative numbers
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


def checked_probabilities(arrays: Mapping[str, Array], K: int) -> tuple[Array, Array]:
    """Start and transitions from the arrays of a model file.

    Parameters
    ----------
    arrays
        "start" and "transitions"
    K
        number of states

    Returns
    -------
    tuple[Array, Array]
        start (K,) and transitions (K, K)

    Raises
    ------
    ValueError
        for other shapes, and numbers that are no probabilities
    """
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


def shares(numbers: Array, former: Array) -> Array:
    """Rows of expected numbers as probabilities; rows of nothing stay as they were."""
    sums = numbers.sum(axis=1, keepdims=True)
    return np.where(sums > NEVER, numbers / np.maximum(sums, NEVER), former)


def free_probabilities(probabilities: Array) -> int:
    """Number of probabilities that are not zero, less one of each row."""
    return int(np.sum(np.maximum(np.count_nonzero(probabilities, axis=1) - 1, 0)))


def logarithm(probabilities: Array) -> Array:
    """Logarithms, -inf for 0."""
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
