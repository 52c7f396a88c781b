# SPDX-License-Identifier: Apache-2.0
"""`TimeStepTPGMM`: a Gaussian for each time step and frame, learned without EM, for few demonstrations.

Nothing has to be found out by iteration: at each share of the time, each frame has seen one point of each of m
demonstrations. What m points say of a covariance is little, so that it is shrunk towards one that is the same in all
directions of a place, and in those of a turn, with the variance that the points themselves have (Ledoit and Wolf, J.
Multivariate Analysis 2004). With S the sample covariance and B the block-wise isotropic one,

    R = f(m) ((m - 1) S + c B) / (m - 1 + c),   f(m) = (1 + 1 / m) nu / (nu - 2),   nu = d (m - 1).

f is that of the Student distribution which predicts the next point of d dimensions when mean and variance come from m
points (Gelman et al., Bayesian Data Analysis, Section 3.2): it says how little few demonstrations tell. So the product
over the frames weighs them by what they have in common at that time, and not by which directions happen to agree.

The model is a `TPGMM` all the same, with a component for each step: its time is the step's, and within the step the
mean moves on with time. So model files, `adapt` and regression work as for others.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Self

import numpy as np
from numpy.typing import ArrayLike

from tpgmm_core.common.types import Array
from tpgmm_core.geometry.manifold import Manifold
from tpgmm_core.learning.estimation.compiled_em import Estimate, MixtureParameters, Workspace
from tpgmm_core.learning.estimation.iteration import Progress
from tpgmm_core.learning.tpgmm import TPGMM
from tpgmm_core.model.samples import Samples

PRIOR_STRENGTH = 10.0
"""c, demonstrations: on recordings of real robots errors fall up to there, and hardly change from 3 to 10."""

UNSEEN = 100.0
"""A frame that saw no demonstration at a time has this times the covariance of all that it saw."""


class TimeStepTPGMM(TPGMM):
    """TP-GMM with a component for each time step; time is the first dimension.

    Attributes, and parameters that are not listed here, are those of `TPGMM`. Those of EM (`n_components`, `init`,
    `tol`, `max_iter`, `random_state`, `regularization`, `n_init`, and `covariance` with its options) have no
    meaning here; they are taken so that the settings of a task serve all methods.

    Parameters
    ----------
    reg_covar
        added to the diagonal of the covariances, in squared units of the data
    manifold
        space of the data, time first
    prior_strength
        c, in demonstrations: how far covariances are shrunk
    n_steps
        number of time steps, from 2
    """

    def __init__(
        self,
        n_components: int = 3,
        init: str | ArrayLike | TPGMM = "time",
        reg_covar: float = 1e-6,
        tol: float = 1e-5,
        max_iter: int = 100,
        random_state: int | np.random.Generator | None = 0,
        manifold: str | Manifold = "euclidean",
        regularization: str = "add",
        n_init: int = 1,
        covariance: str = "full",
        n_factors: int = 1,
        covariance_options: Mapping[str, Any] | None = None,
        prior_strength: float = PRIOR_STRENGTH,
        n_steps: int = 100,
    ) -> None:
        super().__init__(
            n_components, init, reg_covar, tol, max_iter, random_state, manifold, regularization, n_init,
            covariance, n_factors, covariance_options, prior_strength,
        )  # fmt: skip
        self.n_steps = n_steps

    def _fit(self, samples: Samples, progress: Progress | None) -> Self:
        T = self.n_steps
        means, covariances = {}, {}
        for (name, x), seen in zip(samples.X.items(), samples.seen, strict=True):
            manifold = samples.manifolds[name]
            if manifold.ambient_of_tangent[0] != 0 or manifold.tangent_dim < 2:
                raise ValueError(f"time steps need time first, then other dimensions; frame {name!r} is {manifold}")
            means[name], covariances[name] = self._steps(manifold, x, seen, samples)
        parameters = MixtureParameters(np.full(T, 1.0 / T), means, covariances)
        workspace = Workspace(samples, parameters)
        workspace.factorise()
        course = np.array([workspace.expectation() / samples.n_samples])
        if progress is not None:
            progress(1, float(course[0]))
        self._learned(Estimate(parameters, course, course, converged=True), samples.manifold)
        return self

    def _steps(self, manifold: Manifold, x: Array, seen: Array, samples: Samples) -> tuple[Array, Array]:
        """Means (T, D) and covariances (T, n, n) over [time, point] of what one frame saw, x (N, D) where seen (N,)."""
        space = manifold.subset(range(1, manifold.dim))
        shares = np.linspace(0.0, 1.0, self.n_steps)
        points, visible, spans = [], [], []
        first = 0
        for length in samples.lengths:
            own = slice(first, first + length)
            first += length
            t = samples.times[own]
            points.append(_resampled(space, t, x[own, 1:], t[0] + shares * (t[-1] - t[0])))
            nearest = np.abs(t[:, None] - (t[0] + shares * (t[-1] - t[0]))).argmin(axis=0)
            visible.append(seen[own][nearest])
            spans.append((t[0], t[-1]))
        begin, end = np.mean(spans, axis=0)
        grid = begin + shares * (end - begin)
        everything = x[seen, 1:]
        centres, within = [], []
        for step in range(self.n_steps):
            chosen = np.array([p[step] for p, v in zip(points, visible, strict=True) if v[step]])
            centres.append(space.mean(chosen if len(chosen) else everything))
            spread = space.log(centres[-1], chosen if len(chosen) > 1 else everything)
            within.append(self._predictive(space, spread) * (1.0 if len(chosen) else UNSEEN))
        return self._over_time(space, grid, np.stack(centres), np.stack(within))

    def _predictive(self, space: Manifold, spread: Array) -> Array:
        """R (n, n) of the module for points at tangent vectors `spread` (m, n) from their mean."""
        m, c = len(spread), self.prior_strength
        S = spread.T @ spread / (m - 1)
        B, blocks = np.zeros_like(S), isotropic_blocks(space)
        for block in blocks:
            B[block, block] = np.trace(S[block, block]) / (block.stop - block.start) * np.eye(block.stop - block.start)
        freedom = min(block.stop - block.start for block in blocks) * (m - 1)
        factor = (1.0 + 1.0 / m) * freedom / max(freedom - 2.0, 1.0)
        R = factor * ((m - 1) * S + c * B) / (m - 1 + c)
        return np.asarray(R + self.reg_covar * np.eye(len(R)))

    @staticmethod
    def _over_time(space: Manifold, grid: Array, centres: Array, within: Array) -> tuple[Array, Array]:
        """Components over [time, point], each half a step wide, that move on with time as the centres do."""
        before, after = np.maximum(np.arange(len(grid)) - 1, 0), np.minimum(np.arange(len(grid)) + 1, len(grid) - 1)
        steps = np.stack(
            [
                space.log(x, b) - space.log(x, a)
                for x, a, b in zip(centres, centres[before], centres[after], strict=True)
            ]
        )
        velocities = steps / (grid[after] - grid[before])[:, None]
        variance = (0.5 * (grid[1] - grid[0])) ** 2
        n = 1 + space.tangent_dim
        covariances = np.zeros((len(grid), n, n))
        covariances[:, 0, 0] = variance
        covariances[:, 0, 1:] = covariances[:, 1:, 0] = variance * velocities
        covariances[:, 1:, 1:] = within + variance * velocities[:, :, None] * velocities[:, None, :]
        return np.column_stack([grid, centres]), covariances

    def _check_parameters(self) -> None:
        super()._check_parameters()
        T = self.n_steps
        if not isinstance(T, int | np.integer) or isinstance(T, bool) or T < 2:
            raise ValueError(f"n_steps is an integer from 2, got {T!r}")


def isotropic_blocks(space: Manifold) -> list[slice]:
    """The tangent dimensions that are places, or turns, of one thing: those of each factor of the space."""
    blocks, first = [], 0
    for kind, size in space.factors:
        n = size if kind == "R" else 3
        blocks.append(slice(first, first + n))
        first += n
    return blocks


def _resampled(space: Manifold, times: Array, points: Array, asked: Array) -> Array:
    """Points (T, D) at the times asked for (T,), between the samples (N, D) at increasing times (N,)."""
    i = np.clip(np.searchsorted(times, asked, side="right") - 1, 0, len(times) - 2)
    share = np.clip((asked - times[i]) / (times[i + 1] - times[i]), 0.0, 1.0)
    return np.stack(
        [space.exp(p, s * space.log(p, q)) for p, q, s in zip(points[i], points[i + 1], share, strict=True)]
    )
