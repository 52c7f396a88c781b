# SPDX-License-Identifier: Apache-2.0
"""`OnlineTPGMM`: a TP-GMM that takes in new demonstrations without the old ones (incremental EM)."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Self

import numpy as np

from tpgmm_core.common.types import Array
from tpgmm_core.learning.estimation import initialization
from tpgmm_core.learning.estimation.covariance_prior import CovariancePrior
from tpgmm_core.learning.estimation.em import MixtureEstimate, expectation
from tpgmm_core.learning.estimation.emissions import Emissions
from tpgmm_core.learning.estimation.iteration import EmProgress
from tpgmm_core.learning.incremental.component_birth import new_components
from tpgmm_core.learning.incremental.sufficient_statistics import SufficientStatistics, fit_cells
from tpgmm_core.learning.tpgmm import TPGMM
from tpgmm_core.model.demonstration import Demonstration
from tpgmm_core.model.samples import Samples

HALVINGS = 30  # of the weight of demonstrations that contradict the others, until they are left out


@dataclass(eq=False, repr=False)
class OnlineTPGMM(TPGMM):
    """TP-GMM that keeps sufficient statistics, so that learning goes on without the old data.

    `fit` learns as `TPGMM` does, and keeps the moments of every `cell_size` samples that follow each other.
    `partial_fit` is incremental EM (Neal and Hinton, 1998; for streams see Cappé and Moulines, 2009) on the new
    samples and on these cells, whose samples share their responsibilities: see `SufficientStatistics`. Its objective
    never falls (regularization "prior").

    How it compares with learning from all demonstrations at once: the objective is a lower bound of that of
    `TPGMM`, and equal to it with one component, with cells of one sample, and wherever the samples of each cell
    belong to one component. The search starts from the model as it was, so that it may end in another maximum.

    Few demonstrations are points in a subspace: a model that began with no more of them than a frame has dimensions
    takes directions in which they happen to agree for certain, and whatever comes later for something new. As long as
    it began with so few, `partial_fit` starts anew from the cells of all demonstrations, as `fit` starts from their
    samples (by their place in the demonstration where `init` is "time"), with `n_components`. So it is as good as
    learning from all at once, up to the cells, when it has seen more demonstrations than dimensions, and goes on from
    there. Labels and models as `init` are a start for the first demonstrations alone: then it always goes on.

    What it forgets: `retained_` is a lower bound of the log-likelihood of all data so far, known without the
    data. With `max_loss`, new demonstrations lower it by at most that much.

    Parameters and attributes that are not listed here are those of `TPGMM`.

    Parameters
    ----------
    cell_size
        samples in a cell. A cell needs as much memory as about (n + 3) / 2 samples of n dimensions
    max_cells
        when there are more cells, neighbours are joined, so that memory is bounded
    growth_threshold
        samples of new demonstrations that are farther from all components, in mean squares of standard deviations per
        dimension, start new ones: see `new_components`. None: the number of components stays
    max_loss
        nats per sample by which `partial_fit` may lower the likelihood of what was learned before: new demonstrations
        that contradict it get less weight. None: no limit; a few old demonstrations then yield to new ones, as they do
        in learning from all at once. As long as each call starts anew there is no limit: what so few agreed in is not
        yet known
    prior_strength
        as for `TPGMM`; with 3, ten demonstrations that came one by one are learned from as well as all at once

    Attributes
    ----------
    cells_
        `SufficientStatistics` of all data so far
    began_with_
        number of demonstrations that the present components were started from
    retained_
        the mean log-likelihood per sample of all data so far is at least this, each demonstration counted by the
        influence that it was given
    influence_
        weight of the last demonstrations, 1 where `max_loss` did not limit it, 0 if they were left out
    log_likelihoods_, objectives_
        of the last call, per sample; old samples enter `partial_fit` by their bound
    """

    cells_: SufficientStatistics = field(init=False)
    retained_: float = field(init=False)
    influence_: float = field(init=False)
    began_with_: int = field(init=False)

    cell_size: int = 5
    max_cells: int = 2000
    growth_threshold: float | None = 16.0
    max_loss: float | None = None

    def partial_fit(self, demonstrations: Sequence[Demonstration], progress: EmProgress | None = None) -> Self:
        """Learn from new demonstrations in addition; the first call is `fit`.

        Parameters
        ----------
        demonstrations
            the new ones, with the frames of the model
        progress
            called with (iteration, log-likelihood per sample)

        Returns
        -------
        Self
            the same object

        Raises
        ------
        ValueError
            for demonstrations whose frames or dimensions are not those of the model
        """
        if not hasattr(self, "cells_"):
            return self.fit(demonstrations, progress)
        self._check_parameters()
        samples = self._samples(demonstrations)
        if self._is_provisional:
            cells = self.cells_.followed_by(SufficientStatistics.of(samples).coarser(self.cell_size))
            self.influence_, self.began_with_ = 1.0, cells.n_demonstrations
            self._keep(cells, self._anew(cells, progress))
            return self
        lowest = -np.inf
        if self.max_loss is not None:
            lowest = self.cells_.bound(self.priors_, self.emissions_) - self.max_loss * self.cells_.n_samples
        # with less and less weight the old cells lose less and less, since the objective never falls
        for weight in 0.5 ** np.arange(HALVINGS):
            cells = self.cells_.followed_by(SufficientStatistics.of(samples, weight))
            estimate = self._continued(samples, cells, weight, progress)
            if self.cells_.bound(estimate.priors, estimate.emissions) >= lowest:
                self.influence_ = float(weight)
                new = SufficientStatistics.of(samples, weight).coarser(self.cell_size)
                self._keep(self.cells_.followed_by(new), estimate)
                return self
        self.influence_ = 0.0
        return self

    @property
    def _is_provisional(self) -> bool:
        """Whether the components were started from too few demonstrations to go on from."""
        dimensions = max(manifold.tangent_dim for manifold in self.frame_manifolds_.values())
        return isinstance(self.init, str) and self.began_with_ <= dimensions

    def _anew(self, cells: SufficientStatistics, progress: EmProgress | None) -> MixtureEstimate:
        """EM on cells from the start that `fit` takes, with each cell in place of its samples."""
        samples, rng = cells.as_samples(), np.random.default_rng(self.random_state)
        assert isinstance(self.init, str)  # `_is_provisional`
        init = "bins" if self.init == "time" else self.init
        labels = initialization.assignments(samples, init, self.n_components, rng)
        start = self._start(samples, labels)
        emissions = Emissions.from_gaussians(
            self._structure(),
            samples,
            cells.n_samples * start.priors,
            start.means,
            start.covariances,
            self._given(samples),
        )
        chosen = np.eye(self.n_components)[labels]
        counts = chosen.T @ cells.counts
        emissions = self._with_priors(emissions, counts / counts.sum(), cells)
        emissions = emissions.updated(cells.moments(emissions, chosen))
        return fit_cells(
            cells, counts / counts.sum(), emissions, tol=self.tol, max_iter=self.max_iter, progress=progress
        )

    def _with_priors(self, emissions: Emissions, priors: Array, cells: SufficientStatistics) -> Emissions:
        """Components with what is known of their covariances besides these cells, in proportion to the cells."""
        if self.regularization == "prior":
            scatter = self.reg_covar * cells.n_samples / emissions.n_components
            emissions = replace(emissions, prior_scatter=scatter)
        if self.prior_strength:
            samples = cells.as_samples()
            responsibilities, _ = expectation(priors, emissions, samples)
            strength = self.prior_strength * cells.n_samples / samples.n_samples
            emissions = replace(
                emissions, prior=CovariancePrior.of_data(samples, emissions.means, responsibilities, strength)
            )
        return emissions

    def _continued(
        self, samples: Samples, cells: SufficientStatistics, weight: float, progress: EmProgress | None
    ) -> MixtureEstimate:
        """EM on all cells from the present model, and components for what is new."""
        priors, emissions = self.priors_, self.emissions_
        more = None
        if self.growth_threshold is not None:
            more = new_components(emissions, priors, samples, self.growth_threshold)
        if more is not None:
            covariances = emissions.covariances
            counts = np.concatenate([self.cells_.n_samples * priors, weight * more.counts])
            priors = counts / counts.sum()
            emissions = Emissions.from_gaussians(
                emissions.structure,
                samples,
                counts,
                {name: np.concatenate([mean, more.means[name]]) for name, mean in emissions.means.items()},
                {name: np.concatenate([covariances[name], C]) for name, C in more.covariances.items()},
                self._given(samples),
            )
        emissions = self._with_priors(emissions, priors, cells)
        # the old samples hardly change: the new ones determine the gain
        tol = self.tol * weight * samples.n_samples / cells.n_samples
        return fit_cells(cells, priors, emissions, tol=tol, max_iter=self.max_iter, progress=progress)

    def _fit(self, samples: Samples, progress: EmProgress | None) -> Self:
        super()._fit(samples, progress)
        self.influence_, self.began_with_ = 1.0, len(samples.lengths)
        self.cells_ = self._bounded(SufficientStatistics.of(samples).coarser(self.cell_size))
        self.retained_ = self.cells_.bound(self.priors_, self.emissions_) / self.cells_.n_samples
        return self

    def _keep(self, cells: SufficientStatistics, estimate: MixtureEstimate) -> None:
        dimensions, metadata = self.dimensions_, self.metadata_
        self._learned(estimate.with_dense_covariances(), self.manifold_, estimate.emissions)
        self.dimensions_, self.metadata_ = dimensions, metadata
        self.cells_ = self._bounded(cells)
        self.retained_ = self.cells_.bound(self.priors_, self.emissions_) / self.cells_.n_samples

    def _more_arrays(self) -> dict[str, Array]:
        numbers = {"influence": self.influence_, "began_with": float(self.began_with_)}
        return {**self.cells_.arrays(), **{name: np.array([number]) for name, number in numbers.items()}}

    def _restore(self, arrays: Mapping[str, Array]) -> None:
        self.cells_ = SufficientStatistics.from_arrays(arrays, self.frame_manifolds_)
        self.influence_ = float(arrays["influence"].item())
        known = arrays.get("began_with")  # files of earlier versions do not say
        self.began_with_ = self.cells_.n_demonstrations if known is None else int(known.item())
        self.retained_ = self.cells_.bound(self.priors_, self.emissions_) / self.cells_.n_samples

    def _bounded(self, cells: SufficientStatistics) -> SufficientStatistics:
        """At most `max_cells`, or one for each demonstration."""
        while len(cells.counts) > self.max_cells:
            fewer = cells.coarser(2)
            if len(fewer.counts) == len(cells.counts):
                break
            cells = fewer
        return cells

    def _check_parameters(self) -> None:
        super()._check_parameters()
        if self.covariance == "deep_mfa":
            raise ValueError(
                '"deep_mfa" components are not Gaussians, so moments are not sufficient: learn from all data'
            )
        self._check_integers("cell_size", "max_cells")
        for name in ("growth_threshold", "max_loss"):
            value = getattr(self, name)
            if value is not None and not (isinstance(value, int | float | np.number) and value > 0.0):
                raise ValueError(f"{name} is a number above 0, or None, got {value!r}")
