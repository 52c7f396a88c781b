# SPDX-License-Identifier: Apache-2.0
"""What every estimator does, however it learns: take demonstrations, adapt to a situation, judge demonstrations."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, Self

from numpy.typing import ArrayLike

from tpgmm_core.geometry.frame import Frame
from tpgmm_core.geometry.mixture import GaussianMixture
from tpgmm_core.learning.estimation.compiled_em import MixtureParameters, Workspace
from tpgmm_core.learning.estimation.em import expectation
from tpgmm_core.learning.estimation.iteration import EmProgress
from tpgmm_core.learning.stored_mixture import StoredMixture
from tpgmm_core.model.adaptation import Adapter
from tpgmm_core.model.demonstration import Demonstration
from tpgmm_core.model.samples import Samples


class LearnedMixture(StoredMixture):
    """Mixture of Gaussians that is learned from demonstrations, seen from several frames at once.

    A model is a plain value: it may be copied, pickled, fitted again; `priors_`, `means_` and `covariances_` may be
    set by hand, and changed in place. All results follow from the numbers as they are at the time of the call.

    Attributes are those of `StoredMixture`. A subclass is a dataclass of the parameters of its fit, which are stored
    unchanged and checked by `_check_parameters`; `_fit` learns, and calls `_learned` with what it found.
    """

    prior_strength: float = 0.0

    def __init__(self, **parameters: Any) -> None:  # a subclass names them
        raise NotImplementedError

    def fit(self, demonstrations: Sequence[Demonstration], progress: EmProgress | None = None) -> Self:
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
        progress: EmProgress | None = None,
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

    def _check_parameters(self) -> None:
        """Raise ValueError for constructor arguments that no fit can do with."""
        raise NotImplementedError

    def _fit(self, samples: Samples, progress: EmProgress | None) -> Self:
        raise NotImplementedError

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
