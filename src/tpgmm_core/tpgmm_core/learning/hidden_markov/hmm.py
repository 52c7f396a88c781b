# SPDX-License-Identifier: Apache-2.0
"""`TPHMM`: a hidden Markov model whose states are Gaussians seen from several frames (Section 7)."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Self

import numpy as np
from numpy.typing import ArrayLike, NDArray

from tpgmm_core.common.types import Array
from tpgmm_core.geometry.manifold import Manifold
from tpgmm_core.learning.estimation.compiled_em import Estimate, MixtureParameters
from tpgmm_core.learning.estimation.em import expectation
from tpgmm_core.learning.estimation.emissions import Emissions
from tpgmm_core.learning.estimation.iteration import EmProgress, iterate
from tpgmm_core.learning.estimation.structured_em import start_emissions
from tpgmm_core.learning.hidden_markov.chain import Chain
from tpgmm_core.learning.hidden_markov.markov import MarkovChain
from tpgmm_core.learning.learned_mixture import LearnedMixture
from tpgmm_core.learning.tpgmm import TPGMM
from tpgmm_core.model.demonstration import Demonstration
from tpgmm_core.model.samples import Samples


@dataclass(frozen=True, slots=True, eq=False)
class ChainEstimate(Estimate):
    """Result of EM with states and chain; priors are the shares of the samples in each state."""

    chain: Chain
    emissions: Emissions


def fit_chain(
    samples: Samples,
    chain: Chain,
    emissions: Emissions,
    *,
    tol: float,
    max_iter: int,
    progress: EmProgress | None = None,
) -> ChainEstimate:
    """Baum-Welch over several demonstrations from the given start, with the rules of `fit_mixture`.

    The objective is the log-likelihood, less `Emissions.penalty`, plus the prior of the chain, per sample; with
    regularization "prior" it never falls on Euclidean data.

    Parameters
    ----------
    samples
        what all frames saw
    chain
        of the start
    emissions
        states of the start
    tol, max_iter, progress
        as for `fit_mixture`

    Returns
    -------
    ChainEstimate
        the parameters, and how the objective went

    Raises
    ------
    ValueError
        when a covariance is no longer positive definite, and for a demonstration that the chain cannot produce
    """
    N = samples.n_samples
    priors = np.zeros(emissions.n_components)

    def step() -> tuple[float, float]:
        nonlocal chain, emissions, priors
        found = chain.posteriors(emissions.log_density(samples), samples.lengths)
        objective = (found.log_likelihood - emissions.penalty() + chain.log_prior) / N
        priors = found.responsibilities.sum(axis=0)
        chain = chain.maximised(found)
        emissions = emissions.maximised(samples, found.responsibilities)
        return found.log_likelihood / N, objective

    course = iterate(step, tol=tol, max_iter=max_iter, progress=progress)
    parameters = MixtureParameters(priors / priors.sum(), emissions.means, emissions.covariances)
    return ChainEstimate(parameters, *course, chain=chain, emissions=emissions)


@dataclass(eq=False, repr=False)
class TPHMM(TPGMM):
    """Hidden Markov model that is observed from several frames at once.

    A sample of state k has the density prod_j N(x^(j); mu_k^(j), Sigma_k^(j)) over the frames that saw it, as a
    component of a TP-GMM; which state follows which is learned (Baum-Welch). Order comes from the transitions, so
    that the data need not hold time, and may come back to where it was before. Library only: programs learn `TPHSMM`,
    which also knows durations. Parameters and attributes that are not listed here are those of `TPGMM`.

    Parameters
    ----------
    n_components
        K, the number of states
    init
        as for `TPGMM`, "bins" by default; or a fitted model of this class, whose chain is used too
    transitions
        "left-right" (from the first state, each followed by the next), "ergodic" (any to any), or a start (K, K) of EM,
        in which zeros stay zero

    Attributes
    ----------
    start_probabilities_
        shape (K,), of the states at the first sample
    transitions_
        shape (K, K), probabilities from row to column
    priors_
        shape (K,), the share of the samples in each state
    """

    chain_: Chain = field(init=False)

    init: str | ArrayLike | LearnedMixture = "bins"
    transitions: str | ArrayLike = "left-right"

    def fit_projected(
        self,
        X: Mapping[str, ArrayLike],
        visible: Mapping[str, ArrayLike] | None = None,
        progress: EmProgress | None = None,
        lengths: Sequence[int] | None = None,
    ) -> Self:
        """Learn from data that was already observed from each frame.

        Parameters
        ----------
        X, visible, progress
            as for `TPGMM.fit_projected`
        lengths
            number of samples of each demonstration, which follow one another; None: they are one demonstration

        Returns
        -------
        Self
            itself, fitted

        Raises
        ------
        ValueError
            for shapes that do not fit
        """
        self._check_parameters()
        samples = Samples.from_projected(X, visible, self.manifold)
        if lengths is not None:
            if min(lengths, default=0) < 1 or sum(lengths) != samples.n_samples:
                raise ValueError(f"lengths are from 1 and sum to the {samples.n_samples} samples, got {lengths!r}")
            samples = replace(samples, lengths=list(lengths))
        return self._fit(samples, progress)

    @property
    def n_parameters_(self) -> int:
        """Free parameters of the states and of their chain."""
        self._check_fitted()
        return self.emissions_.n_parameters + self.chain_.n_parameters

    def most_likely_states(self, demonstrations: Sequence[Demonstration]) -> list[NDArray[np.intp]]:
        """The likeliest states (T,) of each demonstration (Viterbi)."""
        samples = self._samples(demonstrations)
        states, _ = self.chain_.most_likely(self.emissions_.log_density(samples), samples.lengths)
        return np.split(states, np.cumsum(samples.lengths)[:-1])

    def state_posteriors(self, demonstrations: Sequence[Demonstration]) -> list[Array]:
        """Probabilities (T, K) of the states of each demonstration, given all of its samples."""
        samples = self._samples(demonstrations)
        found = self.chain_.posteriors(self.emissions_.log_density(samples), samples.lengths)
        return np.split(found.responsibilities, np.cumsum(samples.lengths)[:-1])

    def score(self, demonstrations: Sequence[Demonstration]) -> float:
        """Log-likelihood per sample of demonstrations, summed over all sequences of states."""
        samples = self._samples(demonstrations)
        found = self.chain_.posteriors(self.emissions_.log_density(samples), samples.lengths)
        return found.log_likelihood / samples.n_samples

    def state_probabilities(self, n_steps: int) -> Array:
        """Probabilities (n_steps, K) of the states when nothing is observed.

        With the Gaussians of `adapt` they are a reference to track.

        Parameters
        ----------
        n_steps
            number of steps

        Returns
        -------
        Array
            shape (n_steps, K)
        """
        self._check_fitted()
        return self.chain_.state_probabilities(n_steps)

    def _estimate(
        self, samples: Samples, start: MixtureParameters, progress: EmProgress | None
    ) -> tuple[Estimate, Emissions | None]:
        chain, emissions = self._start_of_chain(samples, start)
        K = emissions.n_components
        begun = MixtureParameters(np.full(K, 1.0 / K), emissions.means, emissions.covariances)
        emissions = replace(emissions, prior=self._prior(samples, begun))
        estimate = fit_chain(samples, chain, emissions, tol=self.tol, max_iter=self.max_iter, progress=progress)
        return estimate, estimate.emissions

    def _start_of_chain(self, samples: Samples, start: MixtureParameters) -> tuple[Chain, Emissions]:
        if isinstance(self.init, type(self)) and start.priors is self.init.priors_:
            return self.init.chain_, self._begun(samples, start, self.init.emissions_)
        emissions = self._begun(samples, start, None)
        responsibilities, _ = expectation(start.priors, emissions, samples)
        if isinstance(self.transitions, str) and self.transitions == "left-right":
            # in the order in which a movement meets them
            phase = np.concatenate([np.linspace(0.0, 1.0, length) for length in samples.lengths])
            order = np.argsort(phase @ responsibilities / np.maximum(responsibilities.sum(axis=0), 1e-300))
            responsibilities = responsibilities[:, order]
            start = MixtureParameters(
                start.priors[order],
                {name: mean[order] for name, mean in start.means.items()},
                {name: covariance[order] for name, covariance in start.covariances.items()},
            )
            emissions = self._begun(samples, start, None)
        per_demonstration = np.add.reduceat(responsibilities, np.cumsum([0, *samples.lengths[:-1]]), axis=0)
        visits = np.maximum(np.minimum(per_demonstration, 1.0).sum(axis=0), 1e-300)
        return self._new_chain(per_demonstration.sum(axis=0) / visits, max(samples.lengths)), emissions

    def _begun(self, samples: Samples, start: MixtureParameters, before: Emissions | None) -> Emissions:
        return start_emissions(samples, self._structure(), start, before, self._given(samples))

    def _new_chain(self, mean_durations: Array, longest: int) -> Chain:
        """A chain to start EM from; mean_durations (K,) and the longest demonstration in samples."""
        return MarkovChain.of(self.transitions, mean_durations)

    def _learned(self, estimate: Estimate, manifold: Manifold, emissions: Emissions | None = None) -> None:
        super()._learned(estimate, manifold, emissions)
        if isinstance(estimate, ChainEstimate):
            self._learned_chain(estimate.chain)

    def _learned_chain(self, chain: Chain) -> None:
        self.chain_ = chain

    @property
    def start_probabilities_(self) -> Array:
        """Probabilities (K,) of the states at the first sample."""
        return self.chain_.start

    @property
    def transitions_(self) -> Array:
        """Probabilities (K, K), from row to column."""
        return self.chain_.transitions

    def _more_arrays(self) -> dict[str, Array]:
        return self.chain_.arrays()

    def _restore(self, arrays: Mapping[str, Array]) -> None:
        self._learned_chain(MarkovChain.from_arrays(arrays, len(self.priors_)))

    def _check_parameters(self) -> None:
        super()._check_parameters()
        if self.covariance == "deep_mfa":
            raise ValueError(
                '"deep_mfa" is only for mixtures, not for hidden Markov models: use "mfa" with more states'
            )
