# SPDX-License-Identifier: Apache-2.0
"""Learning a deep mixture of factor analyzers over frames, one layer at a time (Tang et al. 2012, Section 4)."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from tpgmm_core.common.types import Array
from tpgmm_core.learning.covariance.deep_mfa import DeepFactorAnalyzers, divided
from tpgmm_core.learning.covariance.factor_analyzers import FactorAnalyzers
from tpgmm_core.learning.covariance.structure import Structure
from tpgmm_core.learning.estimation import initialization
from tpgmm_core.learning.estimation.em import MixtureEstimate, expectation, fit_mixture
from tpgmm_core.learning.estimation.emissions import Emissions
from tpgmm_core.learning.estimation.initialization import Labels
from tpgmm_core.learning.estimation.iteration import EmProgress
from tpgmm_core.model.samples import Samples


def fit_deep_mixture(
    samples: Samples,
    priors: Array,
    emissions: Emissions,
    structure: Structure,
    *,
    tol: float,
    max_iter: int,
    random_state: int | np.random.Generator | None = 0,
    progress: EmProgress | None = None,
) -> MixtureEstimate:
    """The first layer, started from "mfa" emissions, then the `layers` of the structure.

    Each layer is learned by EM on the data's likelihood, in which only the topmost factors' Gaussians and priors move;
    on Euclidean data, the objective never falls within a layer. K is multiplied by the layers' numbers of components;
    log-likelihoods and objectives are those of the last layer.

    On S³ the factors of a component are coordinates in its tangent space, and each of its parts has a mean of its own
    where the manifold's exponential map leads. The parts keep the loadings of their parent as they are about the fixed
    axes: seen from a part's own mean they would be turned by half of the angle between the two, which is neglected.

    Parameters
    ----------
    samples
        what all frames saw
    priors
        shape (K,), of the start
    emissions
        components of the start
    structure
        settings, with the layers
    tol, max_iter
        of EM in each layer
    random_state
        seed or generator for dividing components
    progress
        called with (iteration, log-likelihood per sample)

    Returns
    -------
    MixtureEstimate
        of the last layer

    Raises
    ------
    ValueError
        for frames of so few dimensions that a layer has no factors
    """
    for name, manifold in samples.manifolds.items():
        d = manifold.tangent_dim
        for n_factors in (structure.n_factors, *(n_factors for _, n_factors in structure.layers[:-1])):
            d = min(n_factors, d - 1)
            if d < 1:
                n = manifold.tangent_dim
                raise ValueError(
                    f'frame {name!r} has too few dimensions ({n}) for the layers of "deep_mfa": each layer needs fewer '
                    "factors than the one before it; use fewer layers"
                )
    estimate = fit_mixture(samples, priors, emissions, tol=tol, max_iter=max_iter, progress=progress)
    rng = np.random.default_rng(random_state)
    for n_parts, n_factors in structure.layers:
        priors, emissions = _with_layer(samples, estimate, structure, n_parts, n_factors, rng)
        estimate = fit_mixture(samples, priors, emissions, tol=tol, max_iter=max_iter, progress=progress)
    return estimate


def _with_layer(
    samples: Samples,
    estimate: MixtureEstimate,
    structure: Structure,
    n_parts: int,
    n_factors: int,
    rng: np.random.Generator,
) -> tuple[Array, Emissions]:
    """Priors and emissions with each component's aggregated posterior divided into `n_parts`.

    The parts are found by k-means on the topmost factors of all frames side by side.
    """
    responsibilities, _ = expectation(estimate.priors, estimate.emissions, samples)
    parents = np.argmax(responsibilities, axis=1)
    frames: dict[str, FactorAnalyzers | DeepFactorAnalyzers] = {}
    factors, uncertain = {}, {}
    for name, seen in zip(samples.X, samples.seen, strict=True):
        frame = estimate.emissions.frames[name]
        assert isinstance(frame, FactorAnalyzers | DeepFactorAnalyzers)
        frames[name] = frame
        factors[name] = _expected_factors(samples, estimate.emissions, frame, name, parents) * seen[:, None]
        # the covariance of the topmost factors, given a sample: I - T^T Sigma^-1 T
        T = frame.top_loadings
        uncertain[name] = np.eye(T.shape[2]) - frame.regressions_of(T) @ T
    K = len(estimate.priors)
    parts = _parts(np.concatenate(list(factors.values()), axis=1), parents, K, n_parts, rng)
    labels = parents * n_parts + parts
    counts = np.bincount(labels, minlength=K * n_parts).astype(float)
    latent_structure = replace(structure, name="mfa", n_factors=n_factors, reg_covar=0.0)
    means, deeper = {}, {}
    for (name, z), seen in zip(factors.items(), samples.seen, strict=True):
        d = z.shape[1]
        nu, scatters = np.zeros((K * n_parts, d)), np.repeat(np.eye(d)[None], K * n_parts, axis=0)
        for k in range(K * n_parts):
            chosen = z[seen & (labels == k)]
            if len(chosen):
                nu[k] = chosen.mean(axis=0)
                scatters[k] = uncertain[name][k // n_parts] + np.cov(chosen, rowvar=False, bias=True).reshape(d, d)
        top = FactorAnalyzers.start(latent_structure, counts, scatters)
        T = np.repeat(frames[name].top_loadings, n_parts, axis=0)
        parents_means = np.repeat(estimate.emissions.means[name], n_parts, axis=0)
        means[name] = samples.manifolds[name].exp(parents_means, np.einsum("knd,kd->kn", T, nu))
        deeper[name] = divided(frames[name], structure, n_parts, top)
    within = np.maximum(counts, 1.0).reshape(K, n_parts)
    priors = (estimate.priors[:, None] * within / within.sum(axis=1, keepdims=True)).ravel()
    return priors, replace(
        estimate.emissions,
        structure=structure,
        means=means,
        frames=deeper,
        prior_scatter=estimate.emissions.prior_scatter / n_parts,
        prior=None if estimate.emissions.prior is None else estimate.emissions.prior.divided(n_parts),
    )


def _expected_factors(
    samples: Samples,
    emissions: Emissions,
    frame: FactorAnalyzers | DeepFactorAnalyzers,
    name: str,
    parents: Labels,
) -> Array:
    """Expectation (N, d) of the topmost factors of each sample's component, given the sample."""
    B = frame.regressions_of(frame.top_loadings)
    z = np.zeros((samples.n_samples, B.shape[1]))
    for k, mean in enumerate(emissions.means[name]):
        z[parents == k] = samples.manifolds[name].log(mean, samples.X[name][parents == k]) @ B[k].T
    return z


def _parts(z: Array, parents: Labels, K: int, n_parts: int, rng: np.random.Generator) -> Labels:
    """Part (N,) of each sample within its parent component, 0 to n_parts - 1."""
    parts = np.zeros(len(z), dtype=np.intp)
    for c in range(K):
        own = np.flatnonzero(parents == c)
        if len(np.unique(z[own], axis=0)) > n_parts:
            parts[own] = initialization.kmeans(z[own], n_parts, rng)
    return parts
