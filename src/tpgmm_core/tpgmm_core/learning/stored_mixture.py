# SPDX-License-Identifier: Apache-2.0
"""The numbers that a fit leaves, as attributes, and the file that holds them: one kind for all estimators."""

from __future__ import annotations

from collections.abc import Mapping
from os import PathLike
from typing import Any, Self

from tpgmm_core.common.types import Array
from tpgmm_core.geometry.manifold import Manifold
from tpgmm_core.learning import model_file
from tpgmm_core.learning.covariance.classical import FullCovariances
from tpgmm_core.learning.covariance.factor_analyzers import PrincipalComponentAnalyzers
from tpgmm_core.learning.covariance.structure import OPTIONS, Structure
from tpgmm_core.learning.estimation.compiled_em import Estimate, MixtureParameters
from tpgmm_core.learning.estimation.emissions import Emissions
from tpgmm_core.learning.estimator import Estimator
from tpgmm_core.model.learned import Learned
from tpgmm_core.model.samples import view_manifold


class StoredMixture(Estimator):
    """Mixture of Gaussians in several frames, which can be saved and read.

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

    manifold: str | Manifold
    reg_covar: float
    regularization: str = "add"
    covariance_options: Mapping[str, Any] | None = None
    bases: Any = None
    n_factors: Any = 1

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

    @property
    def frame_manifolds_(self) -> dict[str, Manifold]:
        """Name → space of the frame's view."""
        return {name: view_manifold(self.manifold_, mean.shape[1]) for name, mean in self.means_.items()}

    def _check_fitted(self) -> None:
        if not hasattr(self, "priors_"):
            raise ValueError(f"this {type(self).__name__} is not fitted yet: call fit or load first")

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
        """Read a model file; `TPGMM.load` reads all kinds of models, as the mixture of their components.

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
        if not cls._reads(header.kind):
            raise model_file.ModelFileError(f"holds a model of the kind {header.kind}, no {cls.__name__}")
        known = {k: v for k, v in header.settings.items() if k in cls._parameter_names()}
        parameters = MixtureParameters(contents.priors, contents.means, contents.covariances)
        model = cls(**known)
        emissions = None
        if header.structure is not None and contents.frames is not None:
            options = {name: getattr(header.structure, name) for name in OPTIONS}
            model.covariance_options = {k: v for k, v in options.items() if v != getattr(Structure(), k)} or None
            if header.structure.fixed_bases:  # so that it goes on to learn with them
                model.bases = {name: frame.arrays()["transform"] for name, frame in contents.frames.items()}
            if header.structure.name == "mppca" and "n_factors" not in known:  # one number per component
                model.n_factors = {
                    name: frame.dimensions
                    for name, frame in contents.frames.items()
                    if isinstance(frame, PrincipalComponentAnalyzers)
                }
            manifolds = {name: view_manifold(header.manifold, m.shape[1]) for name, m in contents.means.items()}
            emissions = Emissions(header.structure, manifolds, contents.means, contents.frames)
        model._learned(
            Estimate(parameters, contents.log_likelihoods, contents.objectives, header.converged),
            header.manifold,
            emissions,
        )
        model.dimensions_ = header.dimensions
        model.metadata_ = dict(header.metadata)
        try:
            model._restore(contents.more)
        except (LookupError, ValueError, TypeError) as error:  # what arrays of any shape may lead to
            raise model_file.ModelFileError(str(error)) from error
        return model

    @classmethod
    def _reads(cls, kind: str) -> bool:
        """Whether a file of this kind of model can be read as this class."""
        return kind == cls.__name__

    def _more_arrays(self) -> dict[str, Array]:
        """Arrays that a model file holds of this kind of model, beyond its components."""
        return {}

    def _restore(self, arrays: Mapping[str, Array]) -> None:
        """Read what `_more_arrays` wrote. Raises KeyError and ValueError for arrays that do not fit."""
