# SPDX-License-Identifier: Apache-2.0
"""EM over frames (Section 3): stacks samples and parameters for the compiled iteration, and decides when to stop."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np

from tpgmm_core.common.types import Array
from tpgmm_core.learning.estimation import kernels_em, kernels_expectation
from tpgmm_core.learning.estimation.covariance_prior import CovariancePrior
from tpgmm_core.learning.estimation.iteration import EmProgress, iterate
from tpgmm_core.model.samples import Samples

PARTS_OF_A_THREAD = 4
"""A thread that has fewer parts costs more than it saves."""


@dataclass(frozen=True, slots=True, eq=False)
class MixtureParameters:
    """Parameters of a TP-GMM.

    Parameters
    ----------
    priors
        shape (K,)
    means
        name → shape (K, D_j)
    covariances
        name → shape (K, n_j, n_j)
    """

    priors: Array
    means: Mapping[str, Array]
    covariances: Mapping[str, Array]


@dataclass(frozen=True, slots=True, eq=False)
class Estimate:
    """Result of EM.

    Parameters
    ----------
    parameters
        after the last iteration
    log_likelihoods, objectives
        per sample, of every iteration
    converged
        whether the objective stopped rising before the last iteration that was allowed
    """

    parameters: MixtureParameters
    log_likelihoods: Array
    objectives: Array
    converged: bool


def expectation_maximisation(
    samples: Samples,
    start: MixtureParameters,
    *,
    reg_covar: float,
    regularization: str,
    tol: float,
    max_iter: int,
    prior: CovariancePrior | None = None,
    progress: EmProgress | None = None,
    n_threads: int = 1,
) -> Estimate:
    """EM from `start` until an iteration gains less than `tol`, at the earliest after 5 iterations.

    regularization "add": reg_covar I is added to every covariance, and the objective is the log-likelihood
    (which then may fall in its last digits). "prior": a prior exp(-1/2 tr(Psi Sigma^-1)) with Psi =
    reg_covar N / K I on every covariance, which counts like reg_covar I for a component with its share N /
    K of the samples; the objective is the penalised log-likelihood, and never falls on Euclidean data. On
    S³ the M-step takes the mean of the tangent vectors, which is the maximum for isotropic rotations and
    close to it otherwise.

    Parameters
    ----------
    samples
        what all frames saw
    start
        parameters of K components
    reg_covar, regularization
        see above
    tol
        in log-likelihood per sample
    max_iter
        most iterations
    prior
        of the covariances, besides the regularisation; its part of the objective is penalised likewise
    progress
        called with (iteration, log-likelihood per sample)
    n_threads
        that share the samples; the result is the same, bit by bit, for any number

    Returns
    -------
    Estimate
        the parameters, and how the objective went

    Raises
    ------
    ValueError
        when a covariance is no longer positive definite
    """
    return iterated(
        Workspace(samples, start, n_threads),
        reg_covar=reg_covar,
        regularization=regularization,
        tol=tol,
        max_iter=max_iter,
        prior=prior,
        progress=progress,
    )


def iterated(
    state: Workspace,
    *,
    reg_covar: float,
    regularization: str,
    tol: float,
    max_iter: int,
    prior: CovariancePrior | None = None,
    progress: EmProgress | None = None,
) -> Estimate:
    """EM from the parameters of a workspace: see `expectation_maximisation`.

    Parameters
    ----------
    state
        samples and start; changed
    reg_covar, regularization, tol, max_iter, prior, progress
        as there

    Returns
    -------
    Estimate
        the parameters, and how the objective went

    Raises
    ------
    ValueError
        when a covariance is no longer positive definite
    """
    K = len(state.log_priors)
    added = reg_covar if regularization == "add" else 0.0
    if regularization == "prior":
        state.prior_scatters[:] = reg_covar * state.n_samples / K * np.eye(state.prior_scatters.shape[-1])
    if prior is not None:
        state.add_prior(prior)
    state.factorise()

    def step() -> tuple[float, float]:
        log_likelihood, objective, failed = state.iterate(added)
        state.check(failed)
        return log_likelihood, objective

    course = iterate(step, tol=tol, max_iter=max_iter, progress=progress)
    return Estimate(state.parameters(), *course)


class Workspace:
    """Samples and parameters in the arrangement of `kernels_em`, for all algorithms that iterate over them.

    Sums over samples are made in parts of a fixed size, which are added in order. Threads share the parts, so that
    results do not depend on their number.
    """

    def __init__(self, samples: Samples, start: MixtureParameters, n_threads: int = 1) -> None:
        self.names, self.n_samples = list(samples.X), samples.n_samples
        self.manifolds = [samples.manifolds[name] for name in self.names]
        P, K, N = len(self.names), len(start.priors), samples.n_samples
        n = max(manifold.tangent_dim for manifold in self.manifolds)
        self.X = np.ascontiguousarray(np.concatenate([samples.X[name].T for name in self.names]))
        self.seen = samples.seen.astype(float)
        rows = np.cumsum([0] + [manifold.dim for manifold in self.manifolds])
        self.layout = np.array([[row, m.tangent_dim] for row, m in zip(rows, self.manifolds, strict=False)])
        self.flat = np.full((P, n), -1)
        spheres = []
        for j, manifold in enumerate(self.manifolds):
            self.flat[j, : manifold.tangent_dim] = manifold.ambient_of_tangent
            spheres += [[j, *start] for start in manifold.sphere_starts]
        self.spheres = np.array(spheres, dtype=np.int64).reshape(-1, 3)
        self.log_priors = np.log(np.maximum(start.priors, np.finfo(float).tiny))
        self.means = np.concatenate([start.means[name] for name in self.names], axis=1)
        self.covariances = np.zeros((P, K, n, n))
        for j, name in enumerate(self.names):
            size = self.layout[j, 1]
            self.covariances[j, :, :size, :size] = start.covariances[name]
        self.factors = np.zeros((P, K, n, n))
        self.log_norms = np.zeros((P, K))
        self.counts = np.zeros((P + 1, K))
        self.first = np.zeros((P, K, n))
        self.second = np.zeros((P, K, n, n))
        self.responsibilities = np.zeros((K, N) if spheres else (0, 0))
        S = -(-N // kernels_expectation.PART)
        self._part_counts, self._part_first = np.zeros((S, P + 1, K)), np.zeros((S, P, K, n))
        self._part_second, self._log_likelihoods = np.zeros((S, P, K, n, n)), np.zeros(S)
        self._n_threads = max(1, min(n_threads, S // PARTS_OF_A_THREAD))
        self._threads = ThreadPoolExecutor(self._n_threads - 1) if self._n_threads > 1 else None
        self.prior_count, self.prior_scatters = 0.0, np.zeros((P, K, n, n))

    def add_prior(self, prior: CovariancePrior) -> None:
        """Take a prior of the covariances into account."""
        self.prior_count += prior.count
        for j, name in enumerate(self.names):
            n = self.layout[j, 1]
            self.prior_scatters[j, :, :n, :n] += prior.count * prior.scales[name]

    def iterate(self, added: float) -> tuple[float, float, int]:
        """Make one EM iteration in place: E-step, then M-step, then the factors of the new covariances.

        Parameters
        ----------
        added
            added to the diagonals of the covariances

        Returns
        -------
        tuple[float, float, int]
            the log-likelihood and the penalised log-likelihood per sample, both before the M-step, and what
            `kernels_expectation.factorise` returns
        """
        log_likelihood, N = self.expectation(), self.n_samples
        penalty = kernels_em.prior_penalty(self.layout, self.factors, self.prior_count, self.prior_scatters)
        self.recentre()
        kernels_em.maximisation(
            self.layout, self.flat, self.spheres, self.log_priors, self.means, self.covariances, self.counts,
            self.first, self.second, added, self.prior_count, self.prior_scatters,
        )  # fmt: skip
        failed = kernels_expectation.factorise(self.layout, self.covariances, self.factors, self.log_norms)
        return log_likelihood / N, (log_likelihood - penalty) / N, failed

    def expectation(self) -> float:
        """Make the E-step alone, with the present factors and normalisations; returns the total log-likelihood."""
        self._in_parts(
            kernels_expectation.expectation, self.X, self.seen, self.layout, self.flat, self.spheres, self.log_priors,
            self.means, self.factors, self.log_norms, self._part_counts, self._part_first, self._part_second,
            self.responsibilities, self._log_likelihoods,
        )  # fmt: skip
        self._sum_parts()
        return float(self._log_likelihoods.sum())

    def recentre(self) -> None:
        """Move the means by the first moments and take the moments about them, where there are S³ factors."""
        if len(self.spheres):
            kernels_em.move_means(self.layout, self.flat, self.spheres, self.means, self.counts, self.first)
            self.moments_about_means()

    def moments_about_means(self) -> None:
        """Take the moments about the present means, with the responsibilities of the last E-step."""
        self._in_parts(
            kernels_em.moments_about, self.X, self.seen, self.layout, self.flat, self.spheres, self.means,
            self.responsibilities, self._part_first, self._part_second,
        )  # fmt: skip
        self._sum_parts()

    def _in_parts(self, kernel: Callable[..., None], *arguments: Any) -> None:
        """Call a kernel, which releases the interpreter's lock, for all parts, a share of them in each thread."""
        S = len(self._log_likelihoods)
        if self._threads is None:
            kernel(*arguments, 0, S)
            return
        shares = [S * i // self._n_threads for i in range(self._n_threads + 1)]
        others = [self._threads.submit(kernel, *arguments, *share) for share in pairwise(shares[1:])]
        kernel(*arguments, 0, shares[1])
        for other in others:
            other.result()

    def _sum_parts(self) -> None:
        S = len(self._log_likelihoods)
        for parts, out in (
            (self._part_counts, self.counts), (self._part_first, self.first), (self._part_second, self.second),
        ):  # fmt: skip
            kernels_expectation.sum_parts(parts.reshape(S, -1), out.reshape(-1))

    def factorise(self) -> None:
        """Compute the factors and normalisations of the covariances.

        Raises
        ------
        ValueError
            for one that is not positive definite
        """
        self.check(kernels_expectation.factorise(self.layout, self.covariances, self.factors, self.log_norms))

    def check(self, failed: int) -> None:
        """Raise the error for what `kernels_expectation.factorise` returned, if it found one.

        Parameters
        ----------
        failed
            -1, or K j + k of frame j and component k

        Raises
        ------
        ValueError
            for a covariance that is not positive definite
        """
        if failed >= 0:
            j, k = divmod(failed, len(self.log_priors))
            raise ValueError(
                f"the covariance of component {k} in frame {self.names[j]!r} is not positive definite: "
                "its samples lie in a subspace; give a larger reg_covar, or take fewer components"
            )

    def parameters(self) -> MixtureParameters:
        """The present parameters as copies, by the names of the frames."""
        priors = np.exp(self.log_priors)
        means, covariances = {}, {}
        for j, (name, manifold) in enumerate(zip(self.names, self.manifolds, strict=True)):
            row, n = self.layout[j]
            means[name] = self.means[:, row : row + manifold.dim].copy()
            covariances[name] = self.covariances[j, :, :n, :n].copy()
        return MixtureParameters(priors / priors.sum(), means, covariances)
