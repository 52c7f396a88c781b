# SPDX-License-Identifier: Apache-2.0
"""EM over frames (Section 3): stacks samples and parameters for the compiled iteration, and decides when to stop."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from tpgmm_core.common.types import Array
from tpgmm_core.learning.estimation import kernels_em, kernels_expectation
from tpgmm_core.learning.estimation.covariance_prior import CovariancePrior
from tpgmm_core.learning.estimation.iteration import Progress, iterate
from tpgmm_core.model.samples import Samples


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
    progress: Progress | None = None,
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

    Returns
    -------
    Estimate
        the parameters, and how the objective went

    Raises
    ------
    ValueError
        when a covariance is no longer positive definite
    """
    state = Workspace(samples, start)
    K = len(start.priors)
    added = reg_covar if regularization == "add" else 0.0
    if regularization == "prior":
        state.prior_scatters[:] = reg_covar * samples.n_samples / K * np.eye(state.prior_scatters.shape[-1])
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
    """Samples and parameters in the arrangement of `kernels_em`, for all algorithms that iterate over them."""

    def __init__(self, samples: Samples, start: MixtureParameters) -> None:
        self.names = list(samples.X)
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
        self.prior_count, self.prior_scatters = 0.0, np.zeros((P, K, n, n))

    def add_prior(self, prior: CovariancePrior) -> None:
        """Take a prior of the covariances into account."""
        self.prior_count += prior.count
        for j, name in enumerate(self.names):
            n = self.layout[j, 1]
            self.prior_scatters[j, :, :n, :n] += prior.count * prior.scales[name]

    def iterate(self, added: float) -> tuple[float, float, int]:
        """Make one EM iteration in place: see `kernels_em.em_iteration`, whose results it returns."""
        result: tuple[float, float, int] = kernels_em.em_iteration(
            self.X, self.seen, self.layout, self.flat, self.spheres, self.log_priors, self.means,
            self.covariances, self.factors, self.log_norms, self.counts, self.first, self.second,
            self.responsibilities, added, self.prior_count, self.prior_scatters,
        )  # fmt: skip
        return result

    def expectation(self) -> float:
        """Make the E-step alone, with the present factors and normalisations; returns the total log-likelihood."""
        result: float = kernels_expectation.expectation(
            self.X, self.seen, self.layout, self.flat, self.spheres, self.log_priors, self.means,
            self.factors, self.log_norms, self.counts, self.first, self.second, self.responsibilities,
        )  # fmt: skip
        return result

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
