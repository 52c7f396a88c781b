# SPDX-License-Identifier: Apache-2.0
"""Dirichlet process mixture over task-parameterized components: as many components as the data ask for.

Variational inference with truncated stick breaking (Blei and Jordan, Bayesian Analysis 1(1), 2006), and a
Normal-Wishart distribution for each component and frame (Bishop 2006, Section 10.2). What the frames have in
common is the component that a sample comes from, as in EM over frames.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Self

import numpy as np
from numpy.typing import ArrayLike
from scipy.special import betaln, digamma, gammaln

from tpgmm_core.common.types import Array
from tpgmm_core.geometry.manifold import Manifold
from tpgmm_core.learning.estimation import initialization
from tpgmm_core.learning.estimation.compiled_em import Estimate, MixtureParameters, Workspace
from tpgmm_core.learning.estimation.iteration import EmProgress, iterate
from tpgmm_core.learning.learned_mixture import LearnedMixture
from tpgmm_core.model.samples import Samples

DELETION_ITERATIONS = 10  # after which a model without the component must be better
FORGOTTEN = -1e9  # instead of the logarithm of 0
LOG_2, LOG_PI, LOG_2PI = np.log(2.0), np.log(np.pi), np.log(2.0 * np.pi)


@dataclass(eq=False, repr=False)
class DirichletTPGMM(LearnedMixture):
    """TP-GMM with a Dirichlet process prior: `n_components` is the most that there may be, not how many there are.

    Parameters and attributes that are not listed here mean what they mean in `TPGMM` and `StoredMixture`. Library
    only: no program learns it.

    Parameters
    ----------
    n_components
        where the stick breaking is truncated, T
    concentration
        of the Dirichlet process: the larger, the more components are expected
    spread
        expected standard deviation of a component, as a share of that of all data, per dimension
    mean_precision
        how many samples the prior on a component's mean, at the mean of all data, counts for
    reg_covar
        added to the expected covariance, in squared units of the data
    tol
        inference stops when an iteration raises the evidence lower bound, per sample, by less

    Attributes
    ----------
    priors_
        shape (K,), expected weights of the K components that account for at least one sample
    means_, covariances_
        their means and inverse expected precisions
    weights_
        shape (T,), expected weights of all components
    objectives_
        evidence lower bound per sample, which never falls on Euclidean data (on S³ the update of the means is made in
        one tangent space, so that this holds approximately)
    log_likelihood_
        of the model with K components
    """

    weights_: Array = field(init=False)

    n_components: int = 20
    concentration: float = 1.0
    spread: float = 0.1
    mean_precision: float = 1.0
    init: str | ArrayLike = "kmeans"
    reg_covar: float = 1e-6
    tol: float = 1e-5
    max_iter: int = 500
    random_state: int | np.random.Generator | None = 0
    manifold: str | Manifold = "euclidean"

    def _check_parameters(self) -> None:
        self._check_integers("n_components", "max_iter")
        self._check_numbers("reg_covar", "tol")
        self._check_numbers("concentration", "spread", "mean_precision", positive=True)
        if isinstance(self.init, LearnedMixture):
            raise ValueError('init is "time", "bins", "kmeans" or labels, not a fitted model')

    def _fit(self, samples: Samples, progress: EmProgress | None) -> Self:
        T = self.n_components
        if samples.n_samples < T:
            raise ValueError(f"{T} components need at least as many samples, got {samples.n_samples}")
        labels = initialization.assignments(samples, self.init, T, self.random_state)
        posterior = _Posterior(self, samples, labels)
        objectives: list[float] = []
        converged = self._climb(posterior, objectives, self.max_iter, progress)
        while converged and self._delete(posterior, objectives):
            converged = self._climb(posterior, objectives, self.max_iter - len(objectives), progress)
        kept = posterior.workspace.counts[-1] >= 1.0
        weights = posterior.weights()
        estimate = posterior.workspace.parameters()
        parameters = MixtureParameters(
            weights[kept] / weights[kept].sum(),
            {name: means[kept] for name, means in estimate.means.items()},
            {name: covariances[kept] for name, covariances in estimate.covariances.items()},
        )
        workspace = Workspace(samples, parameters)
        workspace.factorise()
        log_likelihood = workspace.expectation() / samples.n_samples
        self._learned(
            Estimate(parameters, np.array([log_likelihood]), np.array(objectives), converged), samples.manifold
        )
        self.n_iter_ = len(objectives)
        self.weights_ = weights
        return self

    def _climb(
        self, posterior: _Posterior, objectives: list[float], max_iter: int, progress: EmProgress | None
    ) -> bool:
        """Iterate until the bound hardly rises; its course is added to objectives. Returns whether it came to that."""
        before = len(objectives)

        def step() -> tuple[float, float]:
            bound = posterior.iterate()
            return bound, bound

        def told(iteration: int, bound: float) -> None:
            if progress is not None:
                progress(before + iteration, bound)

        course = iterate(step, tol=self.tol, max_iter=max_iter, progress=told)
        objectives += course.objectives.tolist()
        return course.converged

    def _delete(self, posterior: _Posterior, objectives: list[float]) -> bool:
        """Remove one component where the bound is higher without it (Hughes and Sudderth, NeurIPS 2013).

        Small components that fit a few samples tightly are local optima that no update leaves. Returns whether one was
        removed.
        """
        counts = posterior.workspace.counts[-1].copy()
        for k in np.argsort(counts):
            if counts[k] < 1.0 or counts[k] > 0.5 * counts.sum():
                continue
            before = posterior.snapshot()
            posterior.forget(k)
            for _ in range(DELETION_ITERATIONS):
                bound = posterior.iterate()
                if bound > objectives[-1] + self.tol:
                    objectives.append(bound)
                    return True
            posterior.restore(before)
        return False


@dataclass(frozen=True, slots=True, eq=False)
class _Snapshot:
    """Copies of arrays, the arrays that they are copies of, and the numbers beside them."""

    copies: list[Array]
    arrays: list[Array]
    a: Array
    b: Array
    divergence: float


class _Posterior:
    """Variational distributions: Beta(a_k, b_k) over the sticks, Normal-Wishart over means and precisions.

    Frame j and component k: mu given Lambda ~ N(m, (beta Lambda)^-1), Lambda ~ W(Psi^-1, nu). The workspace
    holds m as means and Psi / nu as covariances, so that the compiled E-step gives, with normalisations that
    take the expectation over mu and log|Lambda|, the optimal responsibilities.
    """

    def __init__(self, model: DirichletTPGMM, samples: Samples, labels: initialization.Labels) -> None:
        T = model.n_components
        self.concentration, self.beta_0 = model.concentration, model.mean_precision
        self.manifolds = list(samples.manifolds.values())
        self.m_0: list[Array] = []
        self.Psi_0: list[Array] = []
        means, covariances, counts = {}, {}, []
        for (name, manifold), seen in zip(samples.manifolds.items(), samples.seen, strict=True):
            x = samples.X[name]
            mean = manifold.mean(x[seen])
            variances = np.mean(manifold.log(mean, x[seen]) ** 2, axis=0)
            expected = model.spread**2 * variances + model.reg_covar
            if expected.min() <= (np.finfo(float).eps * np.abs(x).max()) ** 2:
                raise ValueError(
                    f"dimension {np.argmin(expected)} of frame {name!r} is constant: give a reg_covar above 0"
                )
            self.m_0.append(mean)
            self.Psi_0.append(manifold.tangent_dim * np.diag(expected))
            means[name], covariances[name] = initialization.moments(manifold, x, seen, labels, T, 0.0)
            counts.append(np.bincount(labels[seen & (labels >= 0)], minlength=T))
        total = np.bincount(labels[labels >= 0], minlength=T)
        self.workspace = work = Workspace(samples, MixtureParameters(total / total.sum(), means, covariances))
        work.counts[:] = [*counts, total]
        for j, (name, manifold) in enumerate(samples.manifolds.items()):
            n = manifold.tangent_dim
            work.second[j, :, :n, :n] = np.maximum(counts[j] - 1, 0)[:, None, None] * covariances[name]
        self.beta = np.zeros(work.log_norms.shape)
        self._update()

    def iterate(self) -> float:
        """E-step, the evidence lower bound per sample, and the update of all other distributions."""
        log_evidence = self.workspace.expectation()
        bound = log_evidence - self.divergence
        self._update()
        return bound / self.workspace.X.shape[1]

    def forget(self, k: int) -> None:
        """Make the next E-step give no sample to component k; the bound remains a bound."""
        self.workspace.log_priors[k] = FORGOTTEN

    def snapshot(self) -> _Snapshot:
        """All that changes over the iterations."""
        work = self.workspace
        arrays = [work.log_priors, work.means, work.covariances, work.factors, work.log_norms, work.counts, self.beta]
        return _Snapshot([array.copy() for array in arrays], arrays, self.a, self.b, self.divergence)

    def restore(self, snapshot: _Snapshot) -> None:
        """Go back to the values of the snapshot."""
        for array, former in zip(snapshot.arrays, snapshot.copies, strict=True):
            array[:] = former
        self.a, self.b, self.divergence = snapshot.a, snapshot.b, snapshot.divergence

    def weights(self) -> Array:
        """Expected weights (T,) of the components."""
        share = self.a / (self.a + self.b)
        return np.append(share, 1.0) * np.append(1.0, np.cumprod(1.0 - share))

    def _update(self) -> None:
        """All distributions but the responsibilities, and their divergence from the prior."""
        self._order()
        self._sticks()
        self.workspace.covariances[:] = 0.0
        updates = [self._normal_wishart(j) for j in range(len(self.manifolds))]
        self.workspace.factorise()
        for j, (log_determinant, divergence) in enumerate(updates):
            n = self.manifolds[j].tangent_dim
            self.workspace.log_norms[j] = 0.5 * (log_determinant - n * LOG_2PI - n / self.beta[j])
            self.divergence += divergence

    def _order(self) -> None:
        """Larger components first, where that raises the bound: the sticks are not exchangeable."""
        counts = self.workspace.counts[-1]
        order = np.argsort(-counts, kind="stable")
        if self._stick_evidence(counts[order]) > self._stick_evidence(counts):
            for array, axis in (
                (self.workspace.counts, 1), (self.workspace.first, 1), (self.workspace.second, 1),
                (self.workspace.means, 0),
            ):  # fmt: skip
                array[:] = np.take(array, order, axis=axis)

    def _stick_parameters(self, counts: Array) -> tuple[Array, Array]:
        """a_k = 1 + N_k, b_k = concentration + sum of N_l over l > k, for the first T - 1 sticks."""
        rest = np.cumsum(counts[::-1])[::-1][1:]
        return 1.0 + counts[:-1], self.concentration + rest

    def _stick_evidence(self, counts: Array) -> float:
        return float(np.sum(betaln(*self._stick_parameters(counts))))

    def _sticks(self) -> None:
        a, b = self.a, self.b = self._stick_parameters(self.workspace.counts[-1])
        log_share = digamma(a) - digamma(a + b)
        log_rest = digamma(b) - digamma(a + b)
        self.workspace.log_priors[:] = np.append(log_share, 0.0) + np.append(0.0, np.cumsum(log_rest))
        # of Beta(a, b) from Beta(1, concentration)
        divergence = betaln(1.0, self.concentration) - betaln(a, b)
        divergence = divergence + (a - 1.0) * log_share + (b - self.concentration) * log_rest
        self.divergence = float(np.sum(divergence))

    def _normal_wishart(self, j: int) -> tuple[Array, float]:
        """Update frame j by Bishop (2006), Eqs. 10.60 to 10.63, from the moments about the former means.

        Returns E[log|Lambda|] (T,) and the sum of the divergences from the prior.
        """
        work, manifold = self.workspace, self.manifolds[j]
        row, n = work.layout[j]
        counts, first = work.counts[j], work.first[j, :, :n]
        lower = np.tril(work.second[j, :, :n, :n])
        second = lower + np.swapaxes(np.tril(lower, -1), 1, 2)
        means = work.means[:, row : row + manifold.dim]

        beta = self.beta[j] = self.beta_0 + counts
        nu = n + counts
        prior = manifold.log(means, self.m_0[j])
        shift = (self.beta_0 * prior + first) / beta[:, None]
        share = (1.0 / np.maximum(counts, np.finfo(float).tiny))[:, None]
        gap = np.where(
            counts[:, None] > 0.0, first * share - prior, 0.0
        )  # from the prior's mean to that of the samples
        scatter = second - np.einsum("ki,kj->kij", first, first * share)
        pull = self.beta_0 * counts / beta
        Psi = self.Psi_0[j] + scatter + pull[:, None, None] * np.einsum("ki,kj->kij", gap, gap)
        work.means[:, row : row + manifold.dim] = manifold.exp(means, shift)
        work.covariances[j, :, :n, :n] = Psi / nu[:, None, None]

        return _divergence(n, prior - shift, self.beta_0, beta, self.Psi_0[j], Psi, nu)


def _divergence(
    n: int, offset: Array, beta_0: float, beta: Array, Psi_0: Array, Psi: Array, nu: Array
) -> tuple[Array, float]:
    """Expectations E[log|Lambda|] (T,), and the summed divergence of Normal-Wishart distributions from their prior.

    n is nu of the prior; offset (T, n) leads from the means to the prior's mean.
    """
    i = np.arange(n)
    log_Psi = np.linalg.slogdet(Psi)[1]
    log_determinant = digamma(0.5 * (nu[:, None] - i)).sum(axis=1) + n * LOG_2 - log_Psi
    solved = np.linalg.solve(Psi, np.broadcast_to(Psi_0, Psi.shape))
    distance = np.einsum("ki,ki->k", offset, np.linalg.solve(Psi, offset[..., None])[..., 0])
    normal = 0.5 * (n * (beta_0 / beta - 1.0 - np.log(beta_0 / beta)) + beta_0 * nu * distance)

    def log_normaliser(log_Psi: Array, nu: Array) -> Array:
        """Logarithm of B(Psi^-1, nu) of Bishop (2006), Eq. B.79."""
        gammas = gammaln(0.5 * (nu[..., None] - i)).sum(axis=-1)
        return np.asarray(0.5 * nu * log_Psi - 0.5 * nu * n * LOG_2 - 0.25 * n * (n - 1) * LOG_PI - gammas)

    prior = log_normaliser(np.linalg.slogdet(Psi_0)[1], np.array(float(n)))
    wishart = log_normaliser(log_Psi, nu) - prior + 0.5 * (nu - n) * log_determinant
    wishart = wishart + 0.5 * nu * (np.trace(solved, axis1=1, axis2=2) - n)
    return log_determinant, float(np.sum(normal + wishart))
