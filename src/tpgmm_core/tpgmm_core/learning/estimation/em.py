# SPDX-License-Identifier: Apache-2.0
"""EM of a mixture over `Emissions`: any covariance structure, with the rules of `compiled_em`."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from tpgmm_core.common.types import Array
from tpgmm_core.learning.estimation.compiled_em import Estimate, MixtureParameters
from tpgmm_core.learning.estimation.compiled_moments import CompiledMoments
from tpgmm_core.learning.estimation.emissions import Emissions, Moments
from tpgmm_core.learning.estimation.iteration import EmProgress, iterate
from tpgmm_core.model.samples import Samples


@dataclass(frozen=True, slots=True, eq=False)
class MixtureEstimate:
    """Result of EM.

    Parameters
    ----------
    priors
        shape (K,)
    emissions
        the K components
    log_likelihoods, objectives
        per sample, of every iteration
    converged
        whether the objective stopped rising before the last iteration that was allowed
    """

    priors: Array
    emissions: Emissions
    log_likelihoods: Array
    objectives: Array
    converged: bool

    def with_dense_covariances(self) -> Estimate:
        """The same in the form that EM of full covariances returns."""
        parameters = MixtureParameters(self.priors, self.emissions.means, self.emissions.covariances)
        return Estimate(parameters, self.log_likelihoods, self.objectives, self.converged)


def expectation(priors: Array, emissions: Emissions, samples: Samples) -> tuple[Array, float]:
    """E-step.

    Parameters
    ----------
    priors
        shape (K,)
    emissions
        the Gaussians
    samples
        N of them

    Returns
    -------
    tuple[Array, float]
        responsibilities (N, K) and the log-likelihood of all samples together
    """
    log_joint = emissions.log_density(samples)
    log_joint += np.log(np.maximum(priors, np.finfo(float).tiny))
    top = log_joint.max(axis=1)  # log-sum-exp in place: this is the largest array
    log_joint -= top[:, None]
    joint = np.exp(log_joint, out=log_joint)
    total = joint.sum(axis=1)
    joint /= total[:, None]
    return joint, float(top.sum() + np.log(total).sum())


def fit_mixture(
    samples: Samples,
    priors: Array,
    emissions: Emissions,
    *,
    tol: float,
    max_iter: int,
    progress: EmProgress | None = None,
) -> MixtureEstimate:
    """EM from the given start until an iteration gains less than `tol`, at the earliest after 5 iterations.

    The objective is the log-likelihood less `Emissions.penalty`, per sample, computed before each M-step.

    Parameters
    ----------
    samples
        what all frames saw
    priors
        shape (K,), of the start
    emissions
        components of the start
    tol
        in objective per sample
    max_iter
        most iterations
    progress
        called with (iteration, log-likelihood per sample)

    Returns
    -------
    MixtureEstimate
        the parameters, and how the objective went

    Raises
    ------
    ValueError
        when a covariance is no longer positive definite
    """

    def by_numpy(priors: Array, emissions: Emissions) -> tuple[float, Array, dict[str, Moments]]:
        responsibilities, log_likelihood = expectation(priors, emissions, samples)
        return log_likelihood, responsibilities.sum(axis=0), emissions.moments(samples, responsibilities)

    gathered = CompiledMoments(samples, priors, emissions) if CompiledMoments.suits(emissions) else by_numpy
    N = samples.n_samples

    def step() -> tuple[float, float]:
        nonlocal priors, emissions
        log_likelihood, counts, moments = gathered(priors, emissions)
        penalty, priors, emissions = emissions.penalty(), counts / N, emissions.updated(moments)
        return log_likelihood / N, (log_likelihood - penalty) / N

    course = iterate(step, tol=tol, max_iter=max_iter, progress=progress)
    return MixtureEstimate(priors, emissions, *course)
