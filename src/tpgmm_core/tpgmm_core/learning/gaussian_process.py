# SPDX-License-Identifier: Apache-2.0
"""`GaussianProcessTPGMM`: Gaussian processes over time, for each frame and coordinate, fused by the product.

In each frame and coordinate, the mean of the demonstrations is a Gaussian process over time, and so is the logarithm of
their variance (Goldberg, Williams and Bishop, NIPS 1998; Kersting et al., ICML 2007): how much demonstrations differ
changes along a movement, and that is what the product over the frames weighs them by (Section 7: "as long as a local
measure of uncertainty is available"). A process with one variance for all times could not tell when a frame matters.

Both have a constant mean that is not known, and the covariance s (k + lambda I), k(t, t') = exp(-(t - t')^2 / (2 l^2)).
s is the likeliest one in closed form; l and lambda are those of a grid with the largest marginal likelihood
(Rasmussen and Williams 2006, Sections 2.7 and 5.4.1), found for each coordinate. s lambda is the noise of recordings,
which the mean is freed of. The variance at a step, before it is smoothed, is that of the demonstrations,
shrunk as for time steps (`tpgmm_core.learning.time_steps`), and what the step says is widened as the Student
distribution asks for. Coordinates are independent of each other as a frame sees them.

All is computed at training, on the grid of the time steps: a step of a loop costs what it costs for time steps.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from tpgmm_core.common.types import Array
from tpgmm_core.learning.shown_to_frame import ShownToFrame, isotropic
from tpgmm_core.learning.smooth_paths import smoothed, unrolled
from tpgmm_core.learning.step_mixture import UNSEEN, StepMixture

LENGTHS = np.geomspace(0.03, 0.6, 8)
"""l, shares of the duration."""
NOISES = np.geomspace(1e-6, 1.0, 13)
"""lambda, shares of the variance of the process."""


class GaussianProcessTPGMM(StepMixture):
    """Gaussian processes over time in all frames and coordinates, as a Gaussian for each time step and frame.

    Parameters and attributes are those of `StepMixture` and `StoredMixture`.
    """

    def _gaussians(self, shown: ShownToFrame) -> tuple[Array, Array]:
        space, points = shown.space, shown.held()
        m, c = len(points), self.prior_strength
        processes = Processes(self.n_steps)
        rough = np.stack([space.mean(p) for p in points.swapaxes(0, 1)])
        found = processes.fit(unrolled(space, rough))
        centres = smoothed(space, rough, found.smoothers)
        if m > 1:
            spread = space.log(rough[None], points)
        else:
            spread, m = space.log(rough[None], shown.everything[:, None]), len(shown.everything)
        S = np.einsum("mtn,mto->tno", spread, spread) / (m - 1)
        alike = np.stack([np.diag(isotropic(space, s)) for s in S])
        variances = ((m - 1) * np.einsum("tnn->tn", S) + c * alike) / (m - 1 + c) + np.finfo(float).tiny
        logs = np.log(np.maximum(variances, 1e-9 * variances.max(axis=0)))
        smooth = np.einsum("nts,sn->tn", processes.fit(logs).smoothers, logs)
        total = self._student(space, m) * np.exp(smooth) + found.variances + self.reg_covar
        within = total[:, :, None] * np.eye(space.tangent_dim)
        within[~shown.visible.any(axis=0)] *= UNSEEN
        return centres, within


class Processes:
    """Gaussian processes at T evenly spaced times from 0 to 1, of which all hyperparameters of the grid are prepared.

    Parameters
    ----------
    n_steps
        T
    """

    def __init__(self, n_steps: int) -> None:
        t = np.linspace(0.0, 1.0, n_steps)
        self._eigen = [np.linalg.eigh(np.exp(-0.5 * ((t[:, None] - t) / length) ** 2)) for length in LENGTHS]

    def fit(self, y: Array) -> FittedProcesses:
        """The likeliest process for each column of y (T, n)."""
        T, n = y.shape
        best = np.full(n, -np.inf)
        smoothers, variances = np.empty((n, T, T)), np.empty((T, n))
        for k, vectors in self._eigen:
            k = np.maximum(k, 0.0)
            ones, values = vectors.sum(axis=0), vectors.T @ y
            for noise in NOISES:
                inverse = 1.0 / (k + noise)
                mean = (ones * inverse) @ values / (ones**2 @ inverse)
                left = values - ones[:, None] * mean
                scale = np.maximum(inverse @ left**2 / (T - 1), np.finfo(float).tiny)
                likelihood = -0.5 * ((T - 1) * np.log(scale) - np.log(inverse).sum() + np.log(ones**2 @ inverse))
                for j in np.flatnonzero(likelihood > best):
                    best[j] = likelihood[j]
                    H = _smoother(k, vectors, ones, inverse)
                    smoothers[j], variances[:, j] = H, scale[j] * noise * np.diag(H)
        return FittedProcesses(smoothers, variances)


@dataclass(frozen=True, slots=True, eq=False)
class FittedProcesses:
    """What processes say at the times that they were observed at.

    Parameters
    ----------
    smoothers
        (n, T, T): the means are these times what was observed; the rows add up to 1
    variances
        (T, n), of the means
    """

    smoothers: Array
    variances: Array


def _smoother(k: Array, vectors: Array, ones: Array, inverse: Array) -> Array:
    """K (K + lambda)^-1 of what is observed without its mean, and that mean, by generalised least squares."""
    gain = (vectors * (k * inverse)) @ vectors.T
    mean = (vectors @ (inverse * ones)) / (ones**2 @ inverse)
    return np.asarray(gain + np.outer(1.0 - gain.sum(axis=1), mean))
