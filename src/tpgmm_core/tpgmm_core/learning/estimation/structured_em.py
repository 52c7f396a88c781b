# SPDX-License-Identifier: Apache-2.0
"""From full covariances, or from components that were learned before, to components of a structure."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from tpgmm_core.common.types import Array
from tpgmm_core.learning.covariance.structure import Structure
from tpgmm_core.learning.estimation.compiled_em import MixtureParameters
from tpgmm_core.learning.estimation.covariance_prior import CovariancePrior
from tpgmm_core.learning.estimation.deep_em import fit_deep_mixture
from tpgmm_core.learning.estimation.em import MixtureEstimate, fit_mixture
from tpgmm_core.learning.estimation.emissions import Emissions
from tpgmm_core.learning.estimation.iteration import EmProgress
from tpgmm_core.model.samples import Samples


def fit_structure(
    samples: Samples,
    structure: Structure,
    start: MixtureParameters,
    begun: Emissions | None,
    random_state: int | np.random.Generator | None,
    given: Mapping[str, Array] | None = None,
    *,
    tol: float,
    max_iter: int,
    prior: CovariancePrior | None = None,
    progress: EmProgress | None = None,
) -> MixtureEstimate:
    """EM with this structure, with the rules of `fit_mixture`.

    Parameters
    ----------
    samples
        what all frames saw
    structure
        of the covariances
    start
        parameters of K components with full covariances
    begun
        components of `start` as an earlier fit left them. Where their structure is the same EM continues from them,
        else from the covariances of this structure that are nearest to those of `start`
    random_state
        seed or generator for dividing the components of "deep_mfa"
    given
        as for `Emissions.from_gaussians`
    tol, max_iter
        as for `fit_mixture`
    prior
        of the covariances, besides the regularisation
    progress
        as for `fit_mixture`

    Returns
    -------
    MixtureEstimate
        the parameters, and how the objective went
    """
    is_deep = structure.name == "deep_mfa"
    first = replace(structure, name="mfa") if is_deep else structure
    emissions = replace(start_emissions(samples, first, start, begun, given), prior=prior)
    if is_deep:
        return fit_deep_mixture(
            samples, start.priors, emissions, structure,
            tol=tol, max_iter=max_iter, random_state=random_state, progress=progress,
        )  # fmt: skip
    return fit_mixture(samples, start.priors, emissions, tol=tol, max_iter=max_iter, progress=progress)


def start_emissions(
    samples: Samples,
    structure: Structure,
    start: MixtureParameters,
    begun: Emissions | None,
    given: Mapping[str, Array] | None = None,
) -> Emissions:
    """The components that EM starts from.

    Parameters
    ----------
    samples, structure, start, begun, given
        as for `fit_structure`

    Returns
    -------
    Emissions
        of this structure
    """
    counts = samples.n_samples * start.priors
    emissions = Emissions.from_gaussians(structure, samples, counts, start.means, start.covariances, given)
    if begun is None or given is not None:  # which is the part of `begun`, or ought to replace it
        return emissions
    if (begun.structure.name, begun.structure.n_factors) != (structure.name, structure.n_factors):
        return emissions
    frames = {name: replace(frame, structure=structure) for name, frame in begun.frames.items()}  # type: ignore[type-var]
    return replace(emissions, frames=frames)
