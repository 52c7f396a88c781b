# SPDX-License-Identifier: Apache-2.0
"""EM over demonstrations that do not fit into the memory together: sums over samples are made part by part, and merged.

The E- and M-steps are those of `compiled_em`; only the order in which sums are made differs, in their last digits. Each
iteration goes through all parts once, and twice where there are S³ factors, whose moments are about the new means.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import replace
from functools import partial

import numpy as np

from tpgmm_core.common.side_by_side import side_by_side
from tpgmm_core.common.types import Array
from tpgmm_core.geometry.manifold import Manifold
from tpgmm_core.learning.covariance.structure import Structure
from tpgmm_core.learning.estimation import kernels_em
from tpgmm_core.learning.estimation.compiled_em import MixtureParameters, Workspace
from tpgmm_core.learning.estimation.covariance_prior import CovariancePrior
from tpgmm_core.learning.estimation.em import expectation
from tpgmm_core.learning.estimation.emissions import Emissions
from tpgmm_core.learning.estimation.initialization import Labels
from tpgmm_core.model.demonstration import Demonstration
from tpgmm_core.model.samples import Samples

_CENTRED = 1e-13


class SampleParts:
    """What all frames saw, part by part, as often as it is gone through; one part is in the memory at a time.

    Parameters
    ----------
    parts
        demonstrations, some at a time; gone through again and again: a list, or an object whose `__iter__` reads them
        anew
    manifold
        space of their data, or its text

    Attributes
    ----------
    first
        the first part
    n_samples
        of all parts
    earliest, latest
        times of their samples, s

    Raises
    ------
    ValueError
        there is no part, `parts` can be gone through only once, or parts do not agree in frames and dimensions.
    """

    def __init__(self, parts: Iterable[Sequence[Demonstration]], manifold: Manifold | str) -> None:
        if iter(parts) is parts:
            raise ValueError(
                "the parts are read several times, and an iterator can be read only once: give a list, or an object "
                "whose __iter__ starts again"
            )
        self._parts, self._manifold = parts, manifold
        self._points: dict[str, Array] = {}
        self.n_samples, self.earliest, self.latest = 0, np.inf, -np.inf
        first: Samples | None = None
        for number, samples in enumerate(self._projected()):
            shapes = {name: x.shape[1] for name, x in samples.X.items()}
            first = first or samples
            known = {name: x.shape[1] for name, x in first.X.items()}
            if shapes != known:
                raise ValueError(f"part {number} has frames of dimensions {shapes}, part 0 has {known}")
            for (name, x), seen in zip(samples.X.items(), samples.seen, strict=True):
                if seen.any() and name not in self._points:
                    self._points[name] = x[seen][0]
            self.n_samples += samples.n_samples
            self.earliest = min(self.earliest, float(samples.times.min()))
            self.latest = max(self.latest, float(samples.times.max()))
        if first is None:
            raise ValueError("fit_parts needs at least one part with a demonstration")
        unseen = [name for name in first.X if name not in self._points]
        if unseen:
            raise ValueError(f"frame {unseen[0]!r} was never seen: leave it out")
        self.first = self._filled(first)

    def __iter__(self) -> Iterator[Samples]:
        """Parts in their order."""
        return map(self._filled, self._projected())

    def _projected(self) -> Iterator[Samples]:
        for part in self._parts:
            yield Samples.from_demonstrations(part, self._manifold, may_be_unseen=True)

    def _filled(self, samples: Samples) -> Samples:
        """In the order of the frames of the first part; what a frame did not see in a whole part is any point."""
        names = list(self._points)
        order = [list(samples.X).index(name) for name in names]
        seen = samples.seen[order]
        X = {}
        for name, mask in zip(names, seen, strict=True):
            x = samples.X[name]
            X[name] = x if mask.any() else np.tile(self._points[name], (len(x), 1))
        return replace(samples, X=X, seen=seen, manifolds={name: samples.manifolds[name] for name in names})


def start_of_parts(
    parts: SampleParts, labelled: Callable[[Samples], Labels], n_components: int, reg_covar: float
) -> MixtureParameters:
    """The parameters that hard assignments give, as `initialization.moments` of all samples.

    Parameters
    ----------
    parts
        of the samples
    labelled
        the component of each sample of a part, (N,); -1 for none
    n_components
        K
    reg_covar
        added to the diagonals, in squared units of the data

    Returns
    -------
    MixtureParameters
        of K components

    Raises
    ------
    ValueError
        a component has no samples.
    """
    K, names, manifolds = n_components, list(parts.first.X), parts.first.manifolds
    everything = K  # number of the group of all that a frame saw: a component of which it saw nothing starts from that

    def groups() -> Iterator[tuple[str, int, Array]]:
        for samples in parts:
            labels = labelled(samples)
            for name, seen in zip(names, samples.seen, strict=True):
                for k in range(K + 1):
                    yield name, k, samples.X[name][seen if k == everything else seen & (labels == k)]

    counts = np.sum([np.bincount(found[found >= 0], minlength=K) for found in map(labelled, parts)], axis=0)
    if counts.min() == 0:
        raise ValueError(f"component {np.argmin(counts)} has no samples at the start: use fewer components")
    numbers = {name: np.zeros(K + 1) for name in names}
    means = {name: np.zeros((K + 1, manifolds[name].dim)) for name in names}
    axes = {name: np.zeros((K + 1, manifolds[name].dim, manifolds[name].dim)) for name in names}
    for name, k, x in groups():
        numbers[name][k] += len(x)
        means[name][k] += x.sum(axis=0)
        axes[name][k] += x.T @ x
    for name, manifold in manifolds.items():
        means[name] /= np.maximum(numbers[name], 1.0)[:, None]
        for s in manifold.spheres:  # the main axis does not depend on signs, and lies near the mean
            means[name][:, s.ambient] = np.linalg.eigh(axes[name][:, s.ambient, s.ambient])[1][:, :, -1]
    has_spheres = any(manifold.spheres for manifold in manifolds.values())
    for _ in range(50 if has_spheres else 0):
        steps = {name: np.zeros((K + 1, manifolds[name].tangent_dim)) for name in names}
        for name, k, x in groups():
            steps[name][k] += manifolds[name].log(means[name][k], x).sum(axis=0)
        for name, manifold in manifolds.items():
            steps[name] /= np.maximum(numbers[name], 1.0)[:, None]
            means[name] = np.stack([manifold.exp(m, d) for m, d in zip(means[name], steps[name], strict=True)])
        if max(np.abs(step).max() for step in steps.values()) < _CENTRED:
            break
    scatters = {name: np.zeros((K + 1, *[manifolds[name].tangent_dim] * 2)) for name in names}
    for name, k, x in groups():
        d = manifolds[name].log(means[name][k], x)
        scatters[name][k] += d.T @ d
    taken = {name: np.where(numbers[name][:K] > 0, np.arange(K), everything) for name in names}
    covariances = {
        name: scatters[name][taken[name]] / np.maximum(numbers[name] - 1.0, 1.0)[taken[name], None, None]
        + reg_covar * np.eye(manifolds[name].tangent_dim)
        for name in names
    }
    return MixtureParameters(counts / counts.sum(), {name: means[name][taken[name]] for name in names}, covariances)


def prior_of_parts(parts: SampleParts, start: MixtureParameters, reg_covar: float, strength: float) -> CovariancePrior:
    """The prior of the covariances that all samples give, see `covariance_prior`.

    Parameters
    ----------
    parts
        of the samples
    start
        parameters of K components
    reg_covar
        see `TPGMM`, in squared units of the data
    strength
        in demonstrations, from 0

    Returns
    -------
    CovariancePrior
        one for each component and frame
    """
    emissions = Emissions.from_gaussians(
        Structure(reg_covar=reg_covar), parts.first, parts.n_samples * start.priors, start.means, start.covariances
    )
    return CovariancePrior.of_parts(
        lambda: ((samples, expectation(start.priors, emissions, samples)[0]) for samples in parts),
        start.means,
        strength,
    )


class PartedWorkspace(Workspace):
    """`Workspace` whose sums are those of all parts, which are added in their order.

    Parameters
    ----------
    parts
        of the samples
    start
        parameters of K components
    n_threads
        that share the samples of a part
    jobs
        processes that share the parts, see `side_by_side`; the result is the same, bit by bit, for any number
    """

    def __init__(self, parts: SampleParts, start: MixtureParameters, n_threads: int = 1, jobs: int = 1) -> None:
        super().__init__(parts.first, start, n_threads)
        self._parts, self._start, self._jobs = parts, start, jobs
        self.n_samples = parts.n_samples

    def expectation(self) -> float:
        """See `Workspace.expectation`."""
        return self._merged(self.means, None)

    def recentre(self) -> None:
        """See `Workspace.recentre`; responsibilities, which would be as many as samples, are computed again."""
        if not len(self.spheres):
            return
        before = self.means.copy()
        kernels_em.move_means(self.layout, self.flat, self.spheres, self.means, self.counts, self.first)
        self._merged(before, self.means)

    def _merged(self, means: Array, about: Array | None) -> float:
        """Make the sums of all parts with these means, and with moments about others; the total log-likelihood."""
        parameters = (self.log_priors, means, self.factors, self.log_norms)
        for sums in (self.counts, self.first, self.second):
            sums[:] = 0.0
        work = partial(_sums, self._start, self._n_threads, parameters, about)
        log_likelihood = 0.0
        for part in side_by_side(work, self._parts, self._jobs):
            self.counts += part[0]
            self.first += part[1]
            self.second += part[2]
            log_likelihood += part[3]
        return log_likelihood


def _sums(
    start: MixtureParameters,
    n_threads: int,
    parameters: tuple[Array, Array, Array, Array],
    about: Array | None,
    samples: Samples,
) -> tuple[Array, Array, Array, float]:
    """Counts, first and second moments and the log-likelihood of one part."""
    part = Workspace(samples, start, n_threads)
    part.log_priors, part.means, part.factors, part.log_norms = parameters
    log_likelihood = part.expectation()
    if about is not None:
        part.means = about
        part.moments_about_means()
    return part.counts, part.first, part.second, log_likelihood
