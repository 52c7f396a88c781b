# SPDX-License-Identifier: Apache-2.0
"""`CovariancePrior`: an inverse-Wishart prior for the covariances, with a scale that the data themselves give.

Demonstrations are few, and the samples of one of them are no independent observations: five demonstrations are five
points in the six dimensions of a pose, however many samples they have. EM by itself takes the directions in which these
points happen to agree for certain, their correlations for laws, and lets components stand for some of the
demonstrations alone. The prior of a component's covariance in one frame is

    p(Sigma) ~ |Sigma|^(-c / 2) exp(-c / 2 tr(B Sigma^-1)),

whose M-step, Sigma = (N S + c B) / (N + c) for N samples with scatter S, is that of c more samples with the scatter B
(Fraley and Raftery, J. Classification 2007, Section 3; Gelman et al., Bayesian Data Analysis, Section 3.6). Here

    B = m m^T + diag(R),

where m m^T is how the component's samples move with time, and R how they are spread about that, both as EM finds the
component at its start. What moves together stays so, and the variances are those of the data; but demonstrations that
differ in one thing say nothing of how they differ in another. c is `strength` times the number of samples that one
demonstration has in a component on average, so that `strength` counts demonstrations.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from tpgmm_core.common.types import Array
from tpgmm_core.model.samples import Samples

if TYPE_CHECKING:
    from tpgmm_core.learning.covariance.structure import Covariances


@dataclass(frozen=True, slots=True, eq=False)
class CovariancePrior:
    """Samples that are taken to have been seen before, for each component and frame.

    Parameters
    ----------
    count
        c, number of samples, from 0
    scales
        name → B, shape (K, n_j, n_j), their covariances
    """

    count: float
    scales: Mapping[str, Array]

    @classmethod
    def of_data(
        cls, samples: Samples, means: Mapping[str, Array], responsibilities: Array, strength: float
    ) -> CovariancePrior:
        """The prior of the module.

        Parameters
        ----------
        samples
            what all frames saw
        means
            name → shape (K, D_j), of the components at the start of EM
        responsibilities
            shape (N, K), at the start of EM
        strength
            in demonstrations, from 0

        Returns
        -------
        CovariancePrior
            one for each component and frame
        """
        return cls.of_parts(lambda: [(samples, responsibilities)], means, strength)

    @classmethod
    def of_parts(
        cls, parts: Callable[[], Iterable[tuple[Samples, Array]]], means: Mapping[str, Array], strength: float
    ) -> CovariancePrior:
        """The prior of the module, from samples that are not in the memory all at once.

        Parameters
        ----------
        parts
            called four times; parts of the samples, each with its responsibilities (N, K) at the start of EM
        means
            name → shape (K, D_j), of the components at the start of EM
        strength
            in demonstrations, from 0

        Returns
        -------
        CovariancePrior
            one for each component and frame
        """
        K = len(next(iter(means.values())))
        most = {(name, k): 1e-300 for name in means for k in range(K)}
        n_samples, n_demonstrations = 0, 0
        for samples, responsibilities in parts():
            n_samples += samples.n_samples
            n_demonstrations += len(samples.lengths)
            for name, seen in zip(samples.X, samples.seen, strict=True):
                for k, largest in enumerate((responsibilities * seen[:, None]).max(axis=0).tolist()):
                    most[name, k] = max(most[name, k], largest)
        found = {key: _Scale() for key in most}
        for work in (_Scale.add_weights, _Scale.add_means, _Scale.add_spread):
            for samples, responsibilities in parts():
                for (name, x), seen in zip(samples.X.items(), samples.seen, strict=True):
                    weights = responsibilities * seen[:, None]
                    for k in range(K):
                        rows = np.flatnonzero(weights[:, k] > 1e-6 * most[name, k])
                        d = samples.manifolds[name].log(means[name][k], x[rows])
                        work(found[name, k], weights[rows, k], samples.times[rows], d)
        scales = {name: np.stack([found[name, k].scale() for k in range(K)]) for name in means}
        return cls(strength * n_samples / (n_demonstrations * K), scales)

    def divided(self, n_parts: int) -> CovariancePrior:
        """The prior of components that are each divided into n_parts of the same size."""
        scales = {name: np.repeat(scale, n_parts, axis=0) for name, scale in self.scales.items()}
        return CovariancePrior(self.count / n_parts, scales)

    def with_samples(self, name: str, counts: Array, scatters: Array) -> tuple[Array, Array]:
        """What one frame saw, together with what the prior says it saw before.

        Parameters
        ----------
        name
            of the frame
        counts
            (K,), samples of each component
        scatters
            (K, n, n), their covariances

        Returns
        -------
        tuple[Array, Array]
            counts (K,) and scatters (K, n, n) of both
        """
        total = counts + self.count
        share = (counts / total)[:, None, None]
        return total, share * scatters + (1.0 - share) * self.scales[name]

    def penalty(self, frames: Mapping[str, Covariances]) -> float:
        """-log p of the covariances of all frames, without its constant."""
        total = 0.0
        for name, frame in frames.items():
            traces = np.einsum("kij,kji->", self.scales[name], np.linalg.inv(frame.dense()))
            total += 0.5 * self.count * float(frame.log_determinants.sum() + traces)
        return total


class _Scale:
    """B of one component in one frame, by sums that are made one after the other; zeros where it saw nothing."""

    def __init__(self) -> None:
        self._weight, self._time, self._variance = 0.0, 0.0, 0.0
        self._mean: Array | float = 0.0
        self._motion: Array | float = 0.0
        self._spread: Array | float = 0.0

    def add_weights(self, weights: Array, times: Array, d: Array) -> None:
        """First, for all parts: of rows with weights (S,) at times (S,), that are d (S, n) from the mean."""
        self._weight += float(weights.sum())

    def add_means(self, weights: Array, times: Array, d: Array) -> None:
        """Then, for all parts."""
        share = weights / max(self._weight, 1e-300)
        self._mean = self._mean + share @ d
        self._time += float(share @ times)

    def add_spread(self, weights: Array, times: Array, d: Array) -> None:
        """At last, for all parts."""
        share = weights / max(self._weight, 1e-300)
        t = times - self._time
        d = np.asarray(d - self._mean)
        self._variance += float(share @ t**2)
        self._motion = np.asarray(self._motion + (share * t) @ d)
        self._spread = self._spread + share @ d**2

    def scale(self) -> Array:
        """B (n, n)."""
        spread = np.asarray(self._spread)
        motion = self._motion / np.sqrt(self._variance) if self._variance > 0.0 else np.zeros(spread.shape)
        return np.asarray(np.outer(motion, motion) + np.diag(np.maximum(spread - motion**2, 0.0)))
