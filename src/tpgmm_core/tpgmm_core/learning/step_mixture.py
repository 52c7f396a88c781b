# SPDX-License-Identifier: Apache-2.0
"""`StepMixture`: a Gaussian for each time step and frame, learned without EM, for few demonstrations.

Nothing has to be found out by iteration: at each share of the time, each frame has seen one point of each of m
demonstrations. What m points say of a covariance is little, so that it is shrunk towards one that is the same in all
directions of a place, and in those of a turn, with the variance that the points themselves have (Ledoit and Wolf, J.
Multivariate Analysis 2004). With S the sample covariance and B the block-wise isotropic one,

    R = f(m) ((m - 1) S + c B) / (m - 1 + c),   f(m) = (1 + 1 / m) nu / (nu - 2),   nu = d (m - 1).

f is that of the Student distribution which predicts the next point of d dimensions when mean and variance come from m
points (Gelman et al., Bayesian Data Analysis, Section 3.2): it says how little few demonstrations tell. So the product
over the frames weighs them by what they have in common at that time, and not by which directions happen to agree.

The model is a mixture all the same, with a component for each step: its time is the step's, and within the step the
mean moves on with time. So model files, `adapt` and regression work as for others.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar, Self

import numpy as np

from tpgmm_core.common.types import Array
from tpgmm_core.geometry.manifold import Manifold
from tpgmm_core.learning.estimation.compiled_em import Estimate, MixtureParameters, Workspace
from tpgmm_core.learning.estimation.iteration import EmProgress
from tpgmm_core.learning.learned_mixture import LearnedMixture
from tpgmm_core.learning.shown_to_frame import ShownToFrame, isotropic, isotropic_blocks
from tpgmm_core.model.samples import Samples

PRIOR_STRENGTH = 10.0
"""c, demonstrations: on recordings of real robots errors fall up to there, and hardly change from 3 to 10."""

UNSEEN = 100.0
"""A frame that saw no demonstration at a time has this times the covariance of all that it saw."""


@dataclass(eq=False, repr=False)
class StepMixture(LearnedMixture):
    """TP-GMM with a component for each time step; time is the first dimension. Subclasses say what the Gaussians are.

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

    Attributes
    ----------
    is_closed
        whether the last step is the first one again
    """

    is_closed: ClassVar[bool] = False

    reg_covar: float = 1e-6
    manifold: str | Manifold = "euclidean"
    prior_strength: float = PRIOR_STRENGTH
    n_steps: int = 100

    def steps(self, name: str) -> tuple[Array, Array, Array]:
        """What one frame expects at the time steps, without time.

        Parameters
        ----------
        name
            of the frame

        Returns
        -------
        tuple[Array, Array, Array]
            means (T, D), their velocities (T, n), and covariances (T, n, n)
        """
        S = self.covariances_[name]
        velocities = S[:, 1:, 0] / S[:, 0, 0, None]
        return self.means_[name][:, 1:], velocities, S[:, 1:, 1:] - velocities[:, :, None] * S[:, None, 0, 1:]

    def _fit(self, samples: Samples, progress: EmProgress | None) -> Self:
        T = self.n_steps
        means, covariances = {}, {}
        for j, (name, manifold) in enumerate(samples.manifolds.items()):
            if manifold.ambient_of_tangent[0] != 0 or manifold.tangent_dim < 2:
                raise ValueError(f"time steps need time first, then other dimensions; frame {name!r} is {manifold}")
            shown = self._shown(samples, name, j)
            centres, within = self._gaussians(shown)
            means[name], covariances[name] = self._over_time(shown.space, shown.times, centres, within)
        parameters = MixtureParameters(np.full(T, 1.0 / T), means, covariances)
        workspace = Workspace(samples, parameters)
        workspace.factorise()
        course = np.array([workspace.expectation() / samples.n_samples])
        if progress is not None:
            progress(1, float(course[0]))
        self._learned(Estimate(parameters, course, course, converged=True), samples.manifold)
        return self

    def _shown(self, samples: Samples, name: str, j: int) -> ShownToFrame:
        """What the j-th frame saw of each demonstration at the steps."""
        return ShownToFrame.of(samples.manifolds[name], samples.X[name], samples.seen[j], samples, self.n_steps)

    def _gaussians(self, shown: ShownToFrame) -> tuple[Array, Array]:
        """Means (T, D) and covariances (T, n, n) of one frame, without time."""
        raise NotImplementedError

    def _predictive(self, space: Manifold, spread: Array) -> Array:
        """R (n, n) of the module for points at tangent vectors `spread` (m, n) from their mean."""
        m, c = len(spread), self.prior_strength
        S = spread.T @ spread / (m - 1)
        R = self._student(space, m) * ((m - 1) * S + c * isotropic(space, S)) / (m - 1 + c)
        return np.asarray(R + self.reg_covar * np.eye(len(R)))

    @staticmethod
    def block_size(space: Manifold) -> int:
        """Dimensions of the smallest place or turn of a space."""
        return min(block.stop - block.start for block in isotropic_blocks(space))

    @staticmethod
    def _student(space: Manifold, m: int) -> float:
        """f(m) of the module."""
        freedom = StepMixture.block_size(space) * (m - 1)
        return (1.0 + 1.0 / m) * freedom / max(freedom - 2.0, 1.0)

    @classmethod
    def _over_time(cls, space: Manifold, grid: Array, centres: Array, within: Array) -> tuple[Array, Array]:
        """Components over [time, point], each half a step wide, that move on with time as the centres do."""
        T = len(grid)
        before, after = np.maximum(np.arange(T) - 1, 0), np.minimum(np.arange(T) + 1, T - 1)
        spans = grid[after] - grid[before]
        if cls.is_closed:
            before[0], after[-1], spans[[0, -1]] = T - 2, 1, spans[1]
        steps = np.stack(
            [
                space.log(x, b) - space.log(x, a)
                for x, a, b in zip(centres, centres[before], centres[after], strict=True)
            ]
        )
        velocities = steps / spans[:, None]
        variance = (0.5 * (grid[1] - grid[0])) ** 2
        n = 1 + space.tangent_dim
        covariances = np.zeros((len(grid), n, n))
        covariances[:, 0, 0] = variance
        covariances[:, 0, 1:] = covariances[:, 1:, 0] = variance * velocities
        covariances[:, 1:, 1:] = within + variance * velocities[:, :, None] * velocities[:, None, :]
        return np.column_stack([grid, centres]), covariances

    def _check_parameters(self) -> None:
        self._check_numbers("reg_covar", "prior_strength")
        self._check_integers("n_steps", least=2)
