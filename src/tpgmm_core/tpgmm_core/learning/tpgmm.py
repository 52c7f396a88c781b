# SPDX-License-Identifier: Apache-2.0
"""`TPGMM`: the task-parameterized Gaussian mixture model, learned by EM over frames (Section 3)."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import fields
from os import PathLike
from typing import Any, ClassVar, Self

import numpy as np
from numpy.typing import ArrayLike

from tpgmm_core.common.types import Array
from tpgmm_core.geometry.frame import Frame
from tpgmm_core.geometry.manifold import Manifold
from tpgmm_core.geometry.mixture import GaussianMixture
from tpgmm_core.learning import model_file
from tpgmm_core.learning.covariance.classical import FullCovariances
from tpgmm_core.learning.covariance.structure import Structure
from tpgmm_core.learning.estimation import initialization
from tpgmm_core.learning.estimation.compiled_em import (
    Estimate,
    MixtureParameters,
    Workspace,
    expectation_maximisation,
)
from tpgmm_core.learning.estimation.covariance_prior import CovariancePrior
from tpgmm_core.learning.estimation.em import expectation
from tpgmm_core.learning.estimation.emissions import Emissions
from tpgmm_core.learning.estimation.iteration import Progress
from tpgmm_core.learning.estimation.structured_em import fit_structure
from tpgmm_core.learning.estimator import Estimator
from tpgmm_core.model.adaptation import Adapter
from tpgmm_core.model.demonstration import Demonstration
from tpgmm_core.model.learned import Learned
from tpgmm_core.model.samples import Samples, view_manifold


class TPGMM(Estimator):
    """Gaussian mixture that is observed from several frames at once.

    A model is a plain value: it may be copied, pickled, fitted again; `priors_`, `means_` and `covariances_` may be
    set by hand, and changed in place. All results follow from the numbers as they are at the time of the call.

    Parameters are stored unchanged, and checked by `fit`.

    Parameters
    ----------
    n_components
        K
    init
        "time" (bins of equal width between the first and the last time), "bins" (every demonstration cut into K parts
        of equal counts), "kmeans" (k-means++ on all frames' views side by side), the component of every sample,
        integers (N,) (such as `DPMeans.labels_`), or a fitted TPGMM
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
        columns of the loadings of "mfa", "mppca" and "deep_mfa", for frames of more dimensions
    covariance_options
        other fields of `tpgmm_core.learning.covariance.structure.Structure` by name, or None
    prior_strength
        weight, in demonstrations, of an inverse-Wishart prior of the covariances whose scale the data give
        (`tpgmm_core.learning.estimation.covariance_prior`); 0: none. 3 is a good value for demonstrations of poses
    n_threads
        threads that share the samples in EM of full covariances. The result is the same, bit by bit, for any number.
        Worth it from some ten thousand samples on; more than 1 disturbs other processes on the same cores

    Attributes
    ----------
    priors_
        shape (K,)
    means_
        name → shape (K, D_j)
    covariances_
        name → shape (K, n_j, n_j), in tangent dimensions
    emissions_
        the components with their covariance structure
    n_parameters_
        free parameters of the model
    log_likelihood_
        per sample, after the last iteration
    log_likelihoods_
        per sample, of every iteration
    objectives_
        what EM maximises, of every iteration
    n_iter_, converged_
        iterations that were made, and whether `tol` ended them
    frame_names_
        in the order of the demonstrations
    manifold_
        the space of the data; on R^D with frames that were projected elsewhere, the largest D_j
    dimensions_
        names of the data's dimensions, or None
    metadata_
        free texts and numbers by name
    """

    unused: ClassVar[frozenset[str]] = frozenset()
    """Constructor arguments that an estimator takes, but takes no notice of."""

    priors_: Array
    means_: dict[str, Array]
    covariances_: dict[str, Array]
    log_likelihood_: float
    log_likelihoods_: Array
    objectives_: Array
    n_iter_: int
    converged_: bool
    frame_names_: tuple[str, ...]
    manifold_: Manifold
    dimensions_: tuple[str, ...] | None
    metadata_: dict[str, str | float]
    _emissions: tuple[Learned, Emissions] | None = None  # as learned, with the numbers that they belong to

    def __init__(
        self,
        n_components: int = 3,
        init: str | ArrayLike | TPGMM = "time",
        reg_covar: float = 1e-4,
        tol: float = 1e-5,
        max_iter: int = 100,
        random_state: int | np.random.Generator | None = 0,
        manifold: str | Manifold = "euclidean",
        regularization: str = "add",
        n_init: int = 1,
        covariance: str = "full",
        n_factors: int = 1,
        covariance_options: Mapping[str, Any] | None = None,
        prior_strength: float = 0.0,
        n_threads: int = 1,
    ) -> None:
        self.n_components = n_components
        self.init = init
        self.reg_covar = reg_covar
        self.tol = tol
        self.max_iter = max_iter
        self.random_state = random_state
        self.manifold = manifold
        self.regularization = regularization
        self.n_init = n_init
        self.covariance = covariance
        self.n_factors = n_factors
        self.covariance_options = covariance_options
        self.prior_strength = prior_strength
        self.n_threads = n_threads

    def fit(self, demonstrations: Sequence[Demonstration], progress: Progress | None = None) -> Self:
        """Learn from demonstrations, projected into their frames by Eq. (4).

        Parameters
        ----------
        demonstrations
            one or more, with the same frames and dimensions
        progress
            called with (iteration, log-likelihood per sample)

        Returns
        -------
        Self
            the same object, fitted

        Raises
        ------
        ValueError
            for demonstrations that do not agree in dimensions or frames, and for data that the constructor arguments do
            not fit
        """
        self._check_parameters()
        return self._fit(Samples.from_demonstrations(demonstrations, self.manifold), progress)

    def fit_projected(
        self,
        X: Mapping[str, ArrayLike],
        visible: Mapping[str, ArrayLike] | None = None,
        progress: Progress | None = None,
    ) -> Self:
        """Learn from data that was already observed from each frame.

        For init="time" the time is the first dimension of the first frame; for "bins" all samples are one
        demonstration.

        Parameters
        ----------
        X
            name → shape (N, D_j)
        visible
            name → mask (N,), always seen where not named
        progress
            called with (iteration, log-likelihood per sample)

        Returns
        -------
        Self
            the same object, fitted

        Raises
        ------
        ValueError
            for shapes that do not fit
        """
        self._check_parameters()
        return self._fit(Samples.from_projected(X, visible, self.manifold), progress)

    def _fit(self, samples: Samples, progress: Progress | None) -> Self:
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
        self, samples: Samples, start: MixtureParameters, progress: Progress | None
    ) -> tuple[Estimate, Emissions | None]:
        """Run EM from one start; returns the components as well where their structure is not full."""
        structure = self._structure()
        prior = self._prior(samples, start)
        rules: dict[str, Any] = {"tol": self.tol, "max_iter": self.max_iter, "prior": prior, "progress": progress}
        if structure.name == "full":
            regularization: dict[str, Any] = {"reg_covar": self.reg_covar, "regularization": self.regularization}
            return expectation_maximisation(samples, start, n_threads=self.n_threads, **regularization, **rules), None
        begun = self.init.emissions_ if isinstance(self.init, TPGMM) and start.priors is self.init.priors_ else None
        estimate = fit_structure(samples, structure, start, begun, self.random_state, **rules)
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

    def _learned(self, estimate: Estimate, manifold: Manifold, emissions: Emissions | None = None) -> None:
        self.priors_ = estimate.parameters.priors
        self.means_ = dict(estimate.parameters.means)
        self.covariances_ = dict(estimate.parameters.covariances)
        self.log_likelihoods_ = estimate.log_likelihoods
        self.log_likelihood_ = float(estimate.log_likelihoods[-1])
        self.objectives_ = estimate.objectives
        self.n_iter_ = len(estimate.log_likelihoods)
        self.converged_ = estimate.converged
        self.frame_names_ = tuple(self.means_)
        self.manifold_ = manifold
        self.dimensions_ = None
        self.metadata_ = {}
        self._emissions = None if emissions is None else (Learned(self), emissions)

    @property
    def emissions_(self) -> Emissions:
        """The components; full ones are made on request.

        A structure is used as long as the means and covariances are as learned. Where they were changed by hand, these
        numbers are used, as full covariances.
        """
        self._check_fitted()
        if self._emissions is not None:
            learned, emissions = self._emissions
            if learned.is_of(self):
                return emissions
        structure = Structure("full", reg_covar=self.reg_covar, regularization=self.regularization)
        frames = {name: FullCovariances(structure, covariances) for name, covariances in self.covariances_.items()}
        return Emissions(structure, self.frame_manifolds_, self.means_, frames)

    @property
    def n_parameters_(self) -> int:
        """Free parameters: of the means and covariances in all frames, and the priors, which sum to 1."""
        return self.emissions_.n_parameters + len(self.priors_) - 1

    def _structure(self) -> Structure:
        options = dict(self.covariance_options or {})
        try:
            return Structure(self.covariance, self.n_factors, self.reg_covar, self.regularization, **options)
        except TypeError:
            known = [field.name for field in fields(Structure)][4:]
            raise ValueError(f"covariance_options may hold {', '.join(known)}, got {sorted(options)}") from None

    @property
    def frame_manifolds_(self) -> dict[str, Manifold]:
        """Name → space of the frame's view."""
        return {name: view_manifold(self.manifold_, mean.shape[1]) for name, mean in self.means_.items()}

    def _check_parameters(self) -> None:
        for name in ("n_components", "max_iter", "n_init", "n_threads"):
            value = getattr(self, name)
            if not isinstance(value, int | np.integer) or isinstance(value, bool) or value < 1:
                raise ValueError(f"{name} is an integer from 1, got {value!r}")
        for name in ("reg_covar", "tol", "prior_strength"):
            value = getattr(self, name)
            if not isinstance(value, int | float | np.number) or not (np.isfinite(value) and value >= 0.0):
                raise ValueError(f"{name} is a finite number from 0, got {value!r}")
        self._structure()
        if isinstance(self.init, str) and self.init not in ("time", "bins", "kmeans"):
            raise ValueError(f'init is "time", "bins", "kmeans", labels or a fitted TPGMM, got {self.init!r}')

    def _starts(self, samples: Samples) -> Iterator[MixtureParameters]:
        """The start that `init` names, then starts from single runs of k-means, each with other random centres."""
        rng = np.random.default_rng(self.random_state)
        if isinstance(self.init, TPGMM):
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

    def _start_from(self, other: TPGMM, samples: Samples) -> MixtureParameters:
        other._check_fitted()
        shapes = {name: (self.n_components, x.shape[1]) for name, x in samples.X.items()}
        others = {name: mean.shape for name, mean in other.means_.items()}
        if shapes != others:
            raise ValueError(f"the model given as init has means of shapes {others}, the data asks for {shapes}")
        return MixtureParameters(other.priors_, other.means_, other.covariances_)

    def _check_fitted(self) -> None:
        if not hasattr(self, "priors_"):
            raise ValueError(f"this {type(self).__name__} is not fitted yet: call fit or load first")

    def adapt(
        self,
        frames: Mapping[str, Frame],
        state: ArrayLike | None = None,
        weights: Mapping[str, float] | None = None,
    ) -> GaussianMixture:
        """The mixture in a new situation, by Eqs. (5) and (6).

        What does not depend on the frames is computed once and kept for the next call, as long as the model holds the
        same numbers: attributes may be set, and arrays changed in place, at any time. Calls in several threads at once
        have an `Adapter` each, and the mixture shares nothing with the model.

        Parameters
        ----------
        frames, state, weights
            as for `Adapter.adapt`

        Returns
        -------
        GaussianMixture
            over the frames' common space, with the model's priors

        Raises
        ------
        ValueError
            like `Adapter.adapt`, and for a model that is not fitted
        """
        self._check_fitted()
        idle: list[Adapter] = self.__dict__.setdefault("_adapters", [])
        try:
            adapter = idle.pop()  # no other call can use it until it is put back
        except IndexError:
            adapter = Adapter(self)
        if not adapter.learned.is_of(self):
            adapter = Adapter(self)
        try:
            return adapter.adapt(frames, state, weights)
        finally:
            idle.append(adapter)

    def score(self, demonstrations: Sequence[Demonstration]) -> float:
        """Log-likelihood per sample of demonstrations, also of those that the model was not fitted to.

        A frame that did not see a sample adds nothing for it.

        Parameters
        ----------
        demonstrations
            with the frames of the model

        Returns
        -------
        float
            nats

        Raises
        ------
        ValueError
            for demonstrations whose frames or dimensions are not those of the model
        """
        samples = self._samples(demonstrations)
        if self.emissions_.structure.name != "full":
            return expectation(self.priors_, self.emissions_, samples)[1] / samples.n_samples
        workspace = Workspace(samples, MixtureParameters(self.priors_, self.means_, self.covariances_))
        workspace.factorise()
        return workspace.expectation() / samples.n_samples

    def _samples(self, demonstrations: Sequence[Demonstration]) -> Samples:
        self._check_fitted()
        samples = Samples.from_demonstrations(demonstrations, self.manifold_, may_be_unseen=True)
        shapes = {name: x.shape[1] for name, x in samples.X.items()}
        known = {name: mean.shape[1] for name, mean in self.means_.items()}
        if shapes != known:
            raise ValueError(f"the model has frames of dimensions {known}, the demonstrations {shapes}")
        return samples

    def save(self, path: str | PathLike[str]) -> None:
        """Write a model file: see `model_file`.

        Parameters
        ----------
        path
            the file, which is replaced as a whole

        Raises
        ------
        ValueError
            for a model that is not fitted, and for metadata that are no texts or finite numbers
        OSError
            when the file cannot be written
        """
        self._check_fitted()
        settings = {k: v for k, v in self.get_params().items() if v is None or isinstance(v, str | int | float)}
        settings.pop("n_threads", None)  # says nothing about the model
        structure = self.emissions_.structure
        is_full = structure.name == "full"
        header = model_file.ModelHeader(
            kind=type(self).__name__,
            frames=self.frame_names_,
            manifold=self.manifold_,
            dimensions=self.dimensions_,
            converged=self.converged_,
            settings=settings | {"manifold": str(self.manifold)},
            metadata=self.metadata_,
            structure=None if is_full else structure,
        )
        contents = model_file.ModelContents(
            header=header,
            priors=self.priors_,
            means=self.means_,
            covariances=self.covariances_,
            log_likelihoods=self.log_likelihoods_,
            objectives=self.objectives_,
            frames=None if is_full else self.emissions_.frames,
            more=self._more_arrays(),
        )
        model_file.write(path, contents)

    @classmethod
    def load(cls, path: str | PathLike[str]) -> Self:
        """Read a model file.

        `TPGMM.load` reads all kinds of models, as the mixture of their components.

        Parameters
        ----------
        path
            the file

        Returns
        -------
        Self
            a fitted model

        Raises
        ------
        ModelFileError
            when it is damaged, is no model file, or holds another kind of model
        FileNotFoundError
            where there is none
        """
        return model_file.read_as(path, cls.from_contents)

    @classmethod
    def from_contents(cls, contents: model_file.ModelContents) -> Self:
        """Make the model that a file holds.

        Parameters
        ----------
        contents
            of the file

        Returns
        -------
        Self
            a fitted model

        Raises
        ------
        ModelFileError
            for another kind of model, and for arrays that do not fit it
        """
        header = contents.header
        if cls is not TPGMM and header.kind != cls.__name__:
            raise model_file.ModelFileError(f"holds a model of the kind {header.kind}, no {cls.__name__}")
        known = {k: v for k, v in header.settings.items() if k in cls._parameter_names()}
        parameters = MixtureParameters(contents.priors, contents.means, contents.covariances)
        model = cls(**known)  # type: ignore[arg-type]
        emissions = None
        if header.structure is not None and contents.frames is not None:
            options = {f.name: getattr(header.structure, f.name) for f in fields(Structure)[4:]}
            model.covariance_options = {k: v for k, v in options.items() if v != getattr(Structure(), k)} or None
            manifolds = {name: view_manifold(header.manifold, m.shape[1]) for name, m in contents.means.items()}
            emissions = Emissions(header.structure, manifolds, contents.means, contents.frames)
        model._learned(
            Estimate(parameters, contents.log_likelihoods, contents.objectives, header.converged),
            header.manifold,
            emissions,
        )
        model.dimensions_ = header.dimensions
        model.metadata_ = dict(header.metadata)
        if cls is not TPGMM:
            try:
                model._restore(contents.more)
            except (LookupError, ValueError, TypeError) as error:  # what arrays of any shape may lead to
                raise model_file.ModelFileError(str(error)) from error
        return model

    def _more_arrays(self) -> dict[str, Array]:
        """Arrays that a model file holds of this kind of model, beyond its components."""
        return {}

    def _restore(self, arrays: Mapping[str, Array]) -> None:
        """Read what `_more_arrays` wrote. Raises KeyError and ValueError for arrays that do not fit."""
