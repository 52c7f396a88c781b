# SPDX-License-Identifier: Apache-2.0
"""`TPGMM`: the task-parameterized Gaussian mixture model, learned by EM over frames (Section 3)."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Self

import numpy as np
from numpy.typing import ArrayLike

from tpgmm_core.common.text import shown
from tpgmm_core.common.types import Array
from tpgmm_core.geometry.manifold import Manifold
from tpgmm_core.learning.covariance.structure import OPTIONS, Structure
from tpgmm_core.learning.estimation import initialization
from tpgmm_core.learning.estimation.compiled_em import (
    Estimate,
    MixtureParameters,
    expectation_maximisation,
    iterated,
)
from tpgmm_core.learning.estimation.covariance_prior import CovariancePrior
from tpgmm_core.learning.estimation.em import expectation
from tpgmm_core.learning.estimation.em_in_parts import PartedWorkspace, SampleParts, prior_of_parts, start_of_parts
from tpgmm_core.learning.estimation.emissions import Emissions
from tpgmm_core.learning.estimation.iteration import EmProgress
from tpgmm_core.learning.estimation.structured_em import fit_structure
from tpgmm_core.learning.learned_mixture import LearnedMixture
from tpgmm_core.learning.shared_bases import Bases, dimensions_of, transforms_of
from tpgmm_core.model.demonstration import Demonstration
from tpgmm_core.model.samples import Samples


@dataclass(eq=False, repr=False)
class TPGMM(LearnedMixture):
    """Gaussian mixture that is observed from several frames at once.

    What it can do once it is fitted is in `LearnedMixture`, the attributes that it has then are in `StoredMixture`.

    Parameters
    ----------
    n_components
        K
    init
        "time" (bins of equal width between the first and the last time), "bins" (every demonstration cut into K parts
        of equal counts), "kmeans" (k-means++ on all frames' views side by side), the component of every sample,
        integers (N,) (such as `DPMeans.labels_`), or a fitted model
    reg_covar
        added to the diagonal of the covariances, in squared units of the data
    tol
        EM stops when an iteration gains less, in log-likelihood per sample
    max_iter
        most iterations of EM
    random_state
        seed or generator for "kmeans" and for restarts
    manifold
        space of the data, e.g. "R1 x R3 x S3"; "euclidean" is R^D for any D, also different per frame
    regularization
        "add", or "prior", whose objective never falls: see `expectation_maximisation`
    n_init
        starts of EM, of which the one with the best objective (log-likelihood with `prior_strength`) is kept: the first
        from `init`, the others from random k-means
    covariance
        "full", or a structure with fewer parameters, for all components and frames: "diag", "spherical", "tied", "mfa",
        "mppca", "hddc", "semi_tied", "deep_mfa" (which divides the K components further)
    n_factors
        columns of the loadings of "mfa", "mppca" and "deep_mfa", for frames of more dimensions. For "mppca" also name →
        shape (K,), one number per frame and component, with labels as `init`: `DPMeans.dimensions_`
    covariance_options
        other fields of `tpgmm_core.learning.covariance.structure.Structure` by name, or None
    bases
        of "semi_tied": a model with semi-tied covariances, such as of another task, or name → transform (n_j, n_j).
        Its bases (synergies) are taken as they are for all frames of the data, and only the variances along them are
        learned. None: the bases are learned too
    prior_strength
        weight, in demonstrations, of an inverse-Wishart prior of the covariances whose scale the data give
        (`tpgmm_core.learning.estimation.covariance_prior`); 0: none. 3 is a good value for demonstrations of poses
    n_threads
        threads that share the samples in EM of full covariances. The result is the same, bit by bit, for any number.
        Worth it from some ten thousand samples on; more than 1 disturbs other processes on the same cores
    """

    n_components: int = 3
    init: str | ArrayLike | LearnedMixture = "time"
    reg_covar: float = 1e-4
    tol: float = 1e-5
    max_iter: int = 100
    random_state: int | np.random.Generator | None = 0
    manifold: str | Manifold = "euclidean"
    regularization: str = "add"
    n_init: int = 1
    covariance: str = "full"
    n_factors: int | Mapping[str, ArrayLike] = 1
    covariance_options: Mapping[str, Any] | None = None
    bases: Bases | None = None
    prior_strength: float = 0.0
    n_threads: int = 1

    def fit_parts(
        self, parts: Iterable[Sequence[Demonstration]], progress: EmProgress | None = None, jobs: int = 1
    ) -> Self:
        """Learn from more demonstrations than fit into the memory: as `fit`, but for the last digits.

        Each iteration goes through all parts. There may be one start, from "time", "bins" or a fitted model, of full
        covariances.

        Parameters
        ----------
        parts
            demonstrations, some at a time; gone through again and again: a list, or an object whose `__iter__` reads
            them anew, such as from bags
        progress
            called with (iteration, log-likelihood per sample)
        jobs
            processes, or what a backend of joblib's takes for them, that share the parts of an iteration; the result
            is the same, bit by bit, for any number

        Returns
        -------
        Self
            the same object, fitted

        Raises
        ------
        ValueError
            for an iterator, for demonstrations that do not agree in frames or dimensions, and for constructor arguments
            that need all samples at once
        """
        self.check_parts()
        init = self.init
        found = SampleParts(parts, self.manifold)
        if found.n_samples < self.n_components:
            raise ValueError(f"{self.n_components} components need at least as many samples, got {found.n_samples}")
        if isinstance(init, LearnedMixture):
            start = self._start_from(init, found.first)
        else:
            edges = np.linspace(found.earliest, found.latest, self.n_components + 1)

            def labelled(samples: Samples) -> initialization.Labels:
                if init == "time":
                    return initialization.bins_of(samples.times, edges)
                return initialization.equal_bins(samples.lengths, self.n_components)

            start = start_of_parts(found, labelled, self.n_components, self.reg_covar)
        prior = prior_of_parts(found, start, self.reg_covar, self.prior_strength) if self.prior_strength else None
        rules: dict[str, Any] = {"tol": self.tol, "max_iter": self.max_iter, "prior": prior, "progress": progress}
        state = PartedWorkspace(found, start, self.n_threads, jobs)
        estimate = iterated(state, reg_covar=self.reg_covar, regularization=self.regularization, **rules)
        self._learned(estimate, found.first.manifold)
        return self

    def check_parts(self) -> None:
        """Check that `fit_parts` can learn with these constructor arguments.

        Raises
        ------
        ValueError
            for those that need all samples at once, and for those that nothing can be learned with
        """
        self._check_parameters()
        init = self.init
        is_known = isinstance(init, LearnedMixture) or (isinstance(init, str) and init in ("time", "bins"))
        for name, is_possible, instead in (
            ("covariance", self.covariance == "full", '"full"'),
            ("n_init", self.n_init == 1, "1"),
            ("init", is_known, '"time", "bins" or a fitted model'),
        ):
            if not is_possible:
                given = shown(getattr(self, name))
                raise ValueError(f"{name} {given} needs all samples at once; to learn in parts, take {instead}")

    def _fit(self, samples: Samples, progress: EmProgress | None) -> Self:
        if samples.n_samples < self.n_components:
            raise ValueError(f"{self.n_components} components need at least as many samples, got {samples.n_samples}")
        estimates: list[tuple[Estimate, Emissions | None]] = []
        failure: ValueError | None = None
        for start in self._starts(samples):
            try:
                estimates.append(self._estimate(samples, start, progress))
            except ValueError as error:  # one start may end in a subspace, and another one not
                failure = error
        if not estimates:
            assert failure is not None
            raise failure
        # with a prior from the data, each start has its own, and objectives are not comparable
        best, emissions = max(
            estimates, key=lambda e: (e[0].log_likelihoods if self.prior_strength else e[0].objectives)[-1]
        )
        self._learned(best, samples.manifold, emissions)
        return self

    def _estimate(
        self, samples: Samples, start: MixtureParameters, progress: EmProgress | None
    ) -> tuple[Estimate, Emissions | None]:
        """Run EM from one start; returns the components as well where their structure is not full."""
        structure = self._structure()
        prior = self._prior(samples, start)
        rules: dict[str, Any] = {"tol": self.tol, "max_iter": self.max_iter, "prior": prior, "progress": progress}
        if structure.name == "full":
            regularization: dict[str, Any] = {"reg_covar": self.reg_covar, "regularization": self.regularization}
            return expectation_maximisation(samples, start, n_threads=self.n_threads, **regularization, **rules), None
        begun = (
            self.init.emissions_
            if isinstance(self.init, LearnedMixture) and start.priors is self.init.priors_
            else None
        )
        estimate = fit_structure(samples, structure, start, begun, self.random_state, self._given(samples), **rules)
        return estimate.with_dense_covariances(), estimate.emissions

    def _prior(self, samples: Samples, start: MixtureParameters) -> CovariancePrior | None:
        """The prior of the covariances, from the components that EM starts from."""
        if self.prior_strength == 0.0:
            return None
        full = Structure(reg_covar=self.reg_covar)
        emissions = Emissions.from_gaussians(
            full, samples, samples.n_samples * start.priors, start.means, start.covariances
        )
        responsibilities, _ = expectation(start.priors, emissions, samples)
        return CovariancePrior.of_data(samples, start.means, responsibilities, self.prior_strength)

    def _structure(self) -> Structure:
        options = dict(self.covariance_options or {})
        if not options.keys() <= set(OPTIONS):
            raise ValueError(f"covariance_options may hold {', '.join(OPTIONS)}, got {sorted(options)}")
        largest = 1 if isinstance(self.n_factors, Mapping) else self.n_factors
        settings = (self.covariance, largest, self.reg_covar, self.regularization)
        return Structure(*settings, **options, fixed_bases=self.bases is not None)

    def _given(self, samples: Samples) -> dict[str, Array] | None:
        """What `bases` or `n_factors` give of the covariances of the data's frames."""
        if self.bases is not None:
            return transforms_of(self.bases, samples.manifolds)
        if isinstance(self.n_factors, Mapping):
            return dimensions_of(self.n_factors, self.n_components, samples.manifolds)
        return None

    def _check_parameters(self) -> None:
        self._check_integers("n_components", "max_iter", "n_init", "n_threads")
        self._check_numbers("reg_covar", "tol", "prior_strength")
        self._structure()
        if isinstance(self.n_factors, Mapping) and (
            type(self) is not TPGMM or self.covariance != "mppca" or isinstance(self.init, str) or self.n_init > 1
        ):  # elsewhere components come, go, or change places
            raise ValueError('n_factors of each component are for TPGMM, covariance "mppca", and one start from labels')
        if isinstance(self.init, str) and self.init not in ("time", "bins", "kmeans"):
            raise ValueError(f'init is "time", "bins", "kmeans", labels or a fitted model, got {self.init!r}')

    @classmethod
    def _reads(cls, kind: str) -> bool:
        return cls is TPGMM or super()._reads(kind)

    def _starts(self, samples: Samples) -> Iterator[MixtureParameters]:
        """The start that `init` names, then starts from single runs of k-means, each with other random centres."""
        rng = np.random.default_rng(self.random_state)
        if isinstance(self.init, LearnedMixture):
            yield self._start_from(self.init, samples)
        else:
            yield self._start(samples, initialization.assignments(samples, self.init, self.n_components, rng))
        for _ in range(1, self.n_init):
            yield self._start(
                samples, initialization.assignments(samples, "kmeans", self.n_components, rng, n_starts=1)
            )

    def _start(self, samples: Samples, labels: initialization.Labels) -> MixtureParameters:
        K = self.n_components
        counts = np.bincount(labels[labels >= 0], minlength=K)
        means, covariances = {}, {}
        for (name, x), mask in zip(samples.X.items(), samples.seen, strict=True):
            means[name], covariances[name] = initialization.moments(
                samples.manifolds[name], x, mask, labels, K, self.reg_covar
            )
        return MixtureParameters(counts / counts.sum(), means, covariances)

    def _start_from(self, other: LearnedMixture, samples: Samples) -> MixtureParameters:
        other._check_fitted()
        shapes = {name: (self.n_components, x.shape[1]) for name, x in samples.X.items()}
        others = {name: mean.shape for name, mean in other.means_.items()}
        if shapes != others:
            raise ValueError(f"the model given as init has means of shapes {others}, the data asks for {shapes}")
        return MixtureParameters(other.priors_, other.means_, other.covariances_)
