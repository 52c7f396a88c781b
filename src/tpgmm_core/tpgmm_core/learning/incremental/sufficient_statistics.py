# SPDX-License-Identifier: Apache-2.0
"""`SufficientStatistics` of cells, runs of neighbouring samples: learning goes on from them in place of the samples.

When all samples of a cell c share their responsibilities r_ck, the bound of EM (Neal and Hinton, 1998) needs of
them only their number n_c and their moments, and is largest for r_ck ∝ pi_k exp E_c[log N_k] (Verbeek, Nunnink
and Vlassis, 2006):

    F(theta) = sum_c n_c log sum_k pi_k exp sum_j E_c[log N(x^(j); mu_k^(j), Sigma_k^(j))].

Whatever the parameters theta become later, the log-likelihood of the samples, which are gone, is at least F(theta).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy.special import logsumexp

from tpgmm_core.common.types import Array
from tpgmm_core.geometry.manifold import Manifold
from tpgmm_core.learning.estimation.em import MixtureEstimate
from tpgmm_core.learning.estimation.emissions import Emissions, Moments
from tpgmm_core.learning.estimation.iteration import EmProgress, iterate
from tpgmm_core.learning.estimation.kernels_em import EMPTY
from tpgmm_core.learning.estimation.kernels_expectation import NEGLIGIBLE
from tpgmm_core.model.samples import Samples

PARTS = ("counts", "means", "scatters")  # of moments, in the order of their arguments


@dataclass(frozen=True, eq=False)
class SufficientStatistics:
    """C groups of samples, in the order in which they were shown.

    Parameters
    ----------
    counts
        shape (C,), samples, or their weight
    demonstrations
        shape (C,), which demonstration each is part of; does not decrease
    frames
        name → counts (C,) of the samples that the frame saw, their means (C, D_j) and scatters (C, n_j, n_j)
    manifolds
        name → space of the frame's view
    """

    counts: Array
    demonstrations: NDArray[np.int64]
    frames: Mapping[str, Moments]
    manifolds: Mapping[str, Manifold]

    @classmethod
    def of(cls, samples: Samples, weight: float = 1.0) -> SufficientStatistics:
        """Make a cell of every sample, each with this weight."""
        frames = {
            name: Moments(weight * seen, x, np.zeros((len(x), *2 * (samples.manifolds[name].tangent_dim,))))
            for (name, x), seen in zip(samples.X.items(), samples.seen, strict=True)
        }
        demonstrations = np.repeat(np.arange(len(samples.lengths)), samples.lengths)
        return cls(np.full(samples.n_samples, weight), demonstrations, frames, samples.manifolds)

    def arrays(self) -> dict[str, Array]:
        """All numbers, as a model file holds them."""
        arrays = {"cells": self.counts, "cells_demonstrations": self.demonstrations.astype(float)}
        for j, moments in enumerate(self.frames.values()):
            for part in PARTS:
                arrays[f"cells_{part}_{j}"] = getattr(moments, part)
        return arrays

    @classmethod
    def from_arrays(cls, arrays: Mapping[str, Array], manifolds: Mapping[str, Manifold]) -> SufficientStatistics:
        """Make statistics from the arrays that `arrays` gave.

        Parameters
        ----------
        arrays
            by name
        manifolds
            name → space of the frame's view

        Returns
        -------
        SufficientStatistics
            the statistics

        Raises
        ------
        ValueError
            for arrays that do not fit the manifolds
        """
        counts, demonstrations = arrays["cells"], arrays["cells_demonstrations"]
        C = len(counts)
        frames = {}
        for j, (name, manifold) in enumerate(manifolds.items()):
            moments = frames[name] = Moments(*(arrays[f"cells_{part}_{j}"] for part in PARTS))
            n = manifold.tangent_dim
            shapes = tuple(getattr(moments, part).shape for part in PARTS)
            if shapes != ((C,), (C, manifold.dim), (C, n, n)) or moments.counts.min(initial=0.0) < 0.0:
                raise ValueError(f"{C} cells of frame {name!r} on {manifold} have arrays of shapes {shapes}")
        if (
            C == 0
            or counts.min() <= 0.0
            or demonstrations.shape != (C,)
            or np.diff(demonstrations).min(initial=0.0) < 0.0
        ):
            raise ValueError("cells have counts above 0, and come in the order of their demonstrations")
        return cls(counts, demonstrations.astype(np.int64), frames, manifolds)

    @property
    def n_samples(self) -> float:
        """Samples in all cells, by weight."""
        return float(self.counts.sum())

    @property
    def n_demonstrations(self) -> int:
        """How many demonstrations the cells are of."""
        return int(self.demonstrations[-1]) + 1

    def as_samples(self) -> Samples:
        """The means of the cells, one sample for each; their places in the demonstrations stand for times."""
        lengths = np.bincount(self.demonstrations)
        return Samples(
            dict(self.manifolds),
            {name: moments.means for name, moments in self.frames.items()},
            np.stack([moments.counts > 0.0 for moments in self.frames.values()]),
            np.concatenate([np.arange(n) / n for n in lengths]),
            lengths.tolist(),
        )

    def followed_by(self, others: SufficientStatistics) -> SufficientStatistics:
        """The cells of these demonstrations, followed by those of others."""
        joined = {}
        for name, a in self.frames.items():
            b = others.frames[name]
            joined[name] = Moments(
                np.concatenate([a.counts, b.counts]),
                np.concatenate([a.means, b.means]),
                np.concatenate([a.scatters, b.scatters]),
            )
        later = others.demonstrations + self.demonstrations.max(initial=-1) + 1
        return replace(
            self,
            counts=np.concatenate([self.counts, others.counts]),
            demonstrations=np.concatenate([self.demonstrations, later]),
            frames=joined,
        )

    def coarser(self, size: int) -> SufficientStatistics:
        """Join every `size` cells that follow each other in a demonstration."""
        starts = np.searchsorted(self.demonstrations, self.demonstrations)
        places = (np.arange(len(self.counts)) - starts) // size
        _, first, labels = np.unique(
            np.stack([self.demonstrations, places]), axis=1, return_index=True, return_inverse=True
        )
        labels = labels.ravel()
        members = np.zeros((len(labels), len(first)))
        members[np.arange(len(labels)), labels] = 1.0
        frames = {}
        for name, moments in self.frames.items():
            base = moments.means[first]
            by_count = np.argsort(moments.counts, kind="stable")
            base[labels[by_count]] = moments.means[by_count]  # one that was seen, if any was
            manifold = self.manifolds[name]
            frames[name] = _moments(manifold, moments, members, base)
            if not manifold.is_euclidean:  # seen from nearby, the mean is exact
                frames[name] = _moments(manifold, moments, members, frames[name].means)
        return replace(self, counts=members.T @ self.counts, demonstrations=self.demonstrations[first], frames=frames)

    def log_densities(self, emissions: Emissions) -> Array:
        """E_c[log prod_j N(x^(j); mu_k^(j), Sigma_k^(j))], (C, K), over the frames j that saw the samples."""
        out = np.zeros((len(self.counts), emissions.n_components))
        for name, moments in self.frames.items():
            manifold, frame = self.manifolds[name], emissions.frames[name]
            wide, roots = self._roots[name]
            n = manifold.tangent_dim
            share = moments.counts / self.counts
            for k, mean in enumerate(emissions.means[name]):
                value = frame.log_density(k, manifold.log(mean, moments.means))
                if len(wide):
                    moved = roots
                    if not manifold.is_euclidean:
                        moved = roots @ np.swapaxes(manifold.transport(moments.means[wide], mean), 1, 2)
                    squares = frame.squared_distances(k, moved.reshape(-1, n)).reshape(-1, n)
                    value[wide] -= 0.5 * squares.sum(axis=1)
                out[:, k] += share * value
        return out

    @cached_property
    def _roots(self) -> dict[str, tuple[NDArray[np.intp], Array]]:
        """Name → which cells have a scatter, and n rows for each whose squares sum up to it, (·, n, n)."""
        roots = {}
        for name, moments in self.frames.items():
            wide = np.flatnonzero(moments.scatters.any(axis=(1, 2)))
            values, vectors = np.linalg.eigh(moments.scatters[wide])
            roots[name] = wide, np.sqrt(np.maximum(values, 0.0))[:, :, None] * np.swapaxes(vectors, 1, 2)
        return roots

    def moments(self, emissions: Emissions, responsibilities: Array) -> dict[str, Moments]:
        """Name → moments (K of them) of all samples, weighted by responsibilities (C, K)."""
        return {
            name: _moments(self.manifolds[name], moments, responsibilities, emissions.means[name])
            for name, moments in self.frames.items()
        }

    def bound(self, priors: Array, emissions: Emissions) -> float:
        """A lower bound F(theta) of the log-likelihood of all the samples.

        On S³ this holds up to the curvature over the extent of a cell.

        Parameters
        ----------
        priors
            shape (K,)
        emissions
            the Gaussians

        Returns
        -------
        float
            nats
        """
        log_joint = self.log_densities(emissions) + np.log(np.maximum(priors, np.finfo(float).tiny))
        return float(self.counts @ logsumexp(log_joint, axis=1))


def fit_cells(
    cells: SufficientStatistics,
    priors: Array,
    emissions: Emissions,
    *,
    tol: float,
    max_iter: int,
    progress: EmProgress | None = None,
) -> MixtureEstimate:
    """EM with shared responsibilities from the given start, with the rules of `fit_mixture`; log-likelihoods are F.

    Parameters
    ----------
    cells
        statistics of the samples
    priors
        shape (K,), of the start
    emissions
        components of the start
    tol, max_iter, progress
        as for `fit_mixture`

    Returns
    -------
    MixtureEstimate
        the parameters, and how F went

    Raises
    ------
    ValueError
        when a covariance is no longer positive definite
    """
    N = cells.n_samples

    def step() -> tuple[float, float]:
        nonlocal priors, emissions
        log_joint = cells.log_densities(emissions) + np.log(np.maximum(priors, np.finfo(float).tiny))
        each = logsumexp(log_joint, axis=1)
        bound, penalty = float(cells.counts @ each) / N, emissions.penalty() / N
        responsibilities = np.exp(log_joint - each[:, None])
        priors = cells.counts @ responsibilities / N
        emissions = emissions.updated(cells.moments(emissions, responsibilities))
        return bound, bound - penalty

    course = iterate(step, tol=tol, max_iter=max_iter, progress=progress)
    return MixtureEstimate(priors, emissions, *course)


def _moments(manifold: Manifold, parts: Moments, weights: Array, base: Array) -> Moments:
    """Moments (K) of parts (C) weighted by (C, K).

    The means are one step along the mean tangent vector from the base (K, D). Scatters move by parallel transport.
    """
    K, n = len(base), manifold.tangent_dim
    counts = np.zeros(K)
    means, scatters = base.copy(), np.zeros((K, n, n))
    for k in range(K):
        w = weights[:, k] * parts.counts
        rows = np.flatnonzero(w > NEGLIGIBLE)
        counts[k] = w[rows].sum()
        if counts[k] <= EMPTY:
            continue
        w = w[rows] / counts[k]
        x, S = parts.means[rows], parts.scatters[rows]
        means[k] = manifold.exp(base[k], w @ manifold.log(base[k], x))
        d = manifold.log(means[k], x)
        if not manifold.is_euclidean:
            T = manifold.transport(x, means[k])
            S = T @ S @ np.swapaxes(T, 1, 2)
        scatters[k] = np.tensordot(w, S, axes=1) + (w[:, None] * d).T @ d
    return Moments(counts, means, scatters)
