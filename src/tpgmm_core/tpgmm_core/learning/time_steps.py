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

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, ClassVar, Self

import numpy as np
from numpy.typing import ArrayLike, NDArray

from tpgmm_core.common.types import Array
from tpgmm_core.geometry.manifold import Manifold
from tpgmm_core.learning.estimation.compiled_em import Estimate, MixtureParameters, Workspace
from tpgmm_core.learning.estimation.iteration import Progress
from tpgmm_core.learning.local_weights import ShownSteps
from tpgmm_core.learning.modes import find_modes
from tpgmm_core.learning.tpgmm import TPGMM
from tpgmm_core.model.demonstration import Demonstration
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
    locality
        how much more demonstrations say whose situations are near (`tpgmm_core.learning.local_weights`); 0: all count
        alike. The mixture of the steps, and so `adapt` and `score`, do not know of it; retrieval does
    modes
        0: demonstrations that do the same thing in several ways are found and kept apart (`tpgmm_core.learning.modes`);
        1: they all count as one way
    mode
        0: retrieval goes the way of the demonstrations whose situations are near; k: always the k-th way, of which 1 is
        that of most demonstrations

    Attributes
    ----------
    shown_
        `ShownSteps`: the demonstrations themselves, where `locality` is above 0 or there are several ways; else None
    modes_
        (m,), the way of each demonstration that was learned from, from 0. The mixture of the steps is the way of most
        demonstrations, or that of `mode`
    """

    shown_: ShownSteps | None
    modes_: NDArray[np.int64]

    unused: ClassVar[frozenset[str]] = frozenset(
        (
            "n_components", "init", "tol", "max_iter", "random_state", "regularization", "n_init", "covariance",
            "n_factors", "covariance_options",
        )
    )  # fmt: skip
    """Parameters without a meaning here."""

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
        locality: float = 0.0,
        modes: int = 0,
        mode: int = 0,
    ) -> None:
        super().__init__(
            n_components, init, reg_covar, tol, max_iter, random_state, manifold, regularization, n_init,
            covariance, n_factors, covariance_options, prior_strength,
        )  # fmt: skip
        self.n_steps = n_steps
        self.locality = locality
        self.modes, self.mode = modes, mode

    def fit(self, demonstrations: Sequence[Demonstration], progress: Progress | None = None) -> Self:
        """Learn from demonstrations: see `TPGMM.fit`. Raises ValueError also for a `mode` that they do not have."""
        super().fit(demonstrations, progress)
        space = self.manifold_.subset(range(1, self.manifold_.dim))
        ways = np.zeros(len(demonstrations), dtype=np.int64)
        if self.modes == 0 and "modes" not in self.unused:
            centres, _, within = zip(*(self.steps(name) for name in self.frame_names_), strict=True)
            ways = find_modes(centres, within, demonstrations, space)
        n_modes = int(ways.max()) + 1
        if self.mode > n_modes:
            raise ValueError(f"mode is {self.mode}, and the demonstrations go {n_modes} ways: 1 to {n_modes}, 0: any")
        own = [shown for shown, way in zip(demonstrations, ways, strict=True) if way == max(self.mode - 1, 0)]
        if n_modes > 1:
            super().fit(own, progress)
        self.modes_ = ways
        if self.mode:
            demonstrations, ways = own, np.zeros(len(own), dtype=np.int64)
        if self._is_local or ways.any():
            samples = self._samples(demonstrations)
            deviations, seen = {}, []
            for (name, x), mask in zip(samples.X.items(), samples.seen, strict=True):
                shown = ShownToFrame.of(samples.manifolds[name], x, mask, samples, self.n_steps)
                deviations[name], which = self._deviations(shown, self.means_[name][:, 1:])
                seen.append(which)
            self.shown_ = ShownSteps.of(demonstrations, space, deviations, np.stack(seen), ways)
        return self

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

    @property
    def _is_local(self) -> bool:
        return self.locality > 0.0 and "locality" not in self.unused

    def _deviations(self, shown: ShownToFrame, centres: Array) -> tuple[Array, NDArray[np.bool_]]:
        """Tangent vectors (m, T, n) from the means (T, D) of the steps to what the frame saw; what it saw, (m, T)."""
        return shown.space.log(centres[None], shown.points) * shown.visible[:, :, None], shown.visible

    def predictive(self, space: Manifold, deviations: Array, seen: NDArray[np.bool_]) -> tuple[Array, Array]:
        """What the covariances of steps are made of where all demonstrations count alike.

        Parameters
        ----------
        space
            of the points, without time
        deviations
            (m, T, n)
        seen
            (m, T), which of them count

        Returns
        -------
        tuple[Array, Array]
            B and R of the module, without `reg_covar`, (T, n, n); zeros where fewer than two were seen
        """
        c = self.prior_strength
        B = np.zeros((seen.shape[1], space.tangent_dim, space.tangent_dim))
        R = np.zeros_like(B)
        for t, m in enumerate(seen.sum(axis=0).tolist()):
            if m > 1:
                spread = deviations[seen[:, t], t]
                spread = spread - spread.mean(axis=0)
                S = spread.T @ spread / (m - 1)
                B[t] = isotropic(space, S)
                R[t] = self._student(space, m) * ((m - 1) * S + c * B[t]) / (m - 1 + c)
        return B, R

    def _fit(self, samples: Samples, progress: Progress | None) -> Self:
        T = self.n_steps
        means, covariances = {}, {}
        for (name, x), seen in zip(samples.X.items(), samples.seen, strict=True):
            manifold = samples.manifolds[name]
            if manifold.ambient_of_tangent[0] != 0 or manifold.tangent_dim < 2:
                raise ValueError(f"time steps need time first, then other dimensions; frame {name!r} is {manifold}")
            shown = ShownToFrame.of(manifold, x, seen, samples, T)
            centres, within = self._gaussians(shown)
            means[name], covariances[name] = self._over_time(shown.space, shown.times, centres, within)
        parameters = MixtureParameters(np.full(T, 1.0 / T), means, covariances)
        workspace = Workspace(samples, parameters)
        workspace.factorise()
        course = np.array([workspace.expectation() / samples.n_samples])
        if progress is not None:
            progress(1, float(course[0]))
        self._learned(Estimate(parameters, course, course, converged=True), samples.manifold)
        self.shown_, self.modes_ = None, np.zeros(len(samples.lengths), dtype=np.int64)
        return self

    def _gaussians(self, shown: ShownToFrame) -> tuple[Array, Array]:
        """Means (T, D) and covariances (T, n, n) of one frame, of the points at each step alone."""
        centres, within = [], []
        for points, visible in zip(shown.points.swapaxes(0, 1), shown.visible.T, strict=True):
            chosen = points[visible]
            centres.append(shown.space.mean(chosen if len(chosen) else shown.everything))
            spread = shown.space.log(centres[-1], chosen if len(chosen) > 1 else shown.everything)
            within.append(self._predictive(shown.space, spread) * (1.0 if len(chosen) else UNSEEN))
        return np.stack(centres), np.stack(within)

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
        freedom = TimeStepTPGMM.block_size(space) * (m - 1)
        return (1.0 + 1.0 / m) * freedom / max(freedom - 2.0, 1.0)

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
        L = self.locality
        if not isinstance(L, int | float | np.number) or not (np.isfinite(L) and L >= 0.0):
            raise ValueError(f"locality is a finite number from 0, got {L!r}")
        for name, largest in (("modes", 1), ("mode", np.inf)):
            value = getattr(self, name)
            if not isinstance(value, int | np.integer) or isinstance(value, bool) or not 0 <= value <= largest:
                raise ValueError(f"{name} is {'0 or 1' if largest == 1 else 'an integer from 0'}, got {value!r}")

    def _more_arrays(self) -> dict[str, Array]:
        return {} if self.shown_ is None else self.shown_.arrays()

    def _restore(self, arrays: Mapping[str, Array]) -> None:
        self.shown_ = None
        self.modes_ = np.zeros(0, dtype=np.int64)
        if self._is_local or "places" in arrays:
            self.shown_ = ShownSteps.from_arrays(arrays, self.frame_manifolds_, len(self.priors_))
            self.modes_ = self.shown_.modes


@dataclass(frozen=True, slots=True, eq=False)
class ShownToFrame:
    """What one frame saw, at the same shares of the time of each demonstration.

    Parameters
    ----------
    space
        of the points, without time
    times
        (T,), of the steps, s: between the mean begin and the mean end
    points
        (m, T, D)
    visible
        (m, T), whether the frame saw them
    everything
        (N, D), all samples that the frame saw
    """

    space: Manifold
    times: Array
    points: Array
    visible: NDArray[np.bool_]
    everything: Array

    @classmethod
    def of(cls, manifold: Manifold, x: Array, seen: Array, samples: Samples, n_steps: int) -> ShownToFrame:
        """Of one frame's view x (N, D) over [time, point], where seen (N,), at n_steps."""
        space = manifold.subset(range(1, manifold.dim))
        shares = np.linspace(0.0, 1.0, n_steps)
        points, visible, spans = [], [], []
        first = 0
        for length in samples.lengths:
            own = slice(first, first + length)
            first += length
            t = samples.times[own]
            asked = t[0] + shares * (t[-1] - t[0])
            points.append(_resampled(space, t, x[own, 1:], asked))
            visible.append(seen[own][np.abs(t[:, None] - asked).argmin(axis=0)])
            spans.append((t[0], t[-1]))
        begin, end = np.mean(spans, axis=0)
        return cls(space, begin + shares * (end - begin), np.stack(points), np.stack(visible), x[seen, 1:])

    def held(self) -> Array:
        """Points (m', T, D) of the demonstrations that the frame saw, which stay where it last saw or first sees them.

        So a demonstration of which a part was hidden is a whole path too.
        """
        steps = np.arange(self.points.shape[1])
        held = []
        for points, visible in zip(self.points, self.visible, strict=True):
            seen = np.flatnonzero(visible)
            if len(seen):
                held.append(points[seen[np.abs(steps[:, None] - seen).argmin(axis=1)]])
        return np.stack(held)


def isotropic(space: Manifold, S: Array) -> Array:
    """B (n, n) of the module: the same variance in all directions of a place, and of a turn, as S has on average."""
    B = np.zeros_like(S)
    for block in isotropic_blocks(space):
        size = block.stop - block.start
        B[block, block] = np.trace(S[block, block]) / size * np.eye(size)
    return B


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
