# SPDX-License-Identifier: Apache-2.0
"""`TimeStepTPGMM`: the points of all demonstrations at each time step, in each frame, are one Gaussian there.

Its covariances are the R of `step_mixture`, of the points at that step alone.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Self

import numpy as np
from numpy.typing import NDArray

from tpgmm_core.common.types import Array
from tpgmm_core.geometry.manifold import Manifold
from tpgmm_core.learning.estimation.iteration import EmProgress
from tpgmm_core.learning.local_weights import ShownSteps
from tpgmm_core.learning.modes import find_modes
from tpgmm_core.learning.shown_to_frame import ShownToFrame, isotropic
from tpgmm_core.learning.step_mixture import UNSEEN, StepMixture
from tpgmm_core.model.demonstration import Demonstration
from tpgmm_core.model.samples import Samples


@dataclass(eq=False, repr=False)
class TimeStepTPGMM(StepMixture):
    """TP-GMM with a component for each time step; time is the first dimension.

    Parameters and attributes that are not listed here are those of `StepMixture` and `StoredMixture`.

    Parameters
    ----------
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

    shown_: ShownSteps | None = field(init=False)
    modes_: NDArray[np.int64] = field(init=False)

    locality: float = 0.0
    modes: int = 0
    mode: int = 0

    def fit(self, demonstrations: Sequence[Demonstration], progress: EmProgress | None = None) -> Self:
        """Learn from demonstrations, and keep them where `locality` or several ways need them.

        Raises
        ------
        ValueError
            like `TPGMM.fit`, and for a `mode` that the demonstrations do not have
        """
        super().fit(demonstrations, progress)
        space = self.manifold_.subset(range(1, self.manifold_.dim))
        ways = np.zeros(len(demonstrations), dtype=np.int64)
        if self.modes == 0:
            centres, _, within = zip(*(self.steps(name) for name in self.frame_names_), strict=True)
            ways = find_modes(centres, within, demonstrations, space)
        n_modes = int(ways.max()) + 1
        if self.mode > n_modes:
            raise ValueError(
                f"mode is {self.mode}; expected 1 to {n_modes} (the ways of the demonstrations), or 0 for any"
            )
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

    @property
    def _is_local(self) -> bool:
        return self.locality > 0.0

    def _fit(self, samples: Samples, progress: EmProgress | None) -> Self:
        super()._fit(samples, progress)
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

    def _check_parameters(self) -> None:
        super()._check_parameters()
        self._check_numbers("locality")
        self._check_integers("modes", "mode", least=0)
        if self.modes > 1:
            raise ValueError(f"modes is 0 or 1, got {self.modes}")

    def _more_arrays(self) -> dict[str, Array]:
        return {} if self.shown_ is None else self.shown_.arrays()

    def _restore(self, arrays: Mapping[str, Array]) -> None:
        self.shown_ = None
        self.modes_ = np.zeros(0, dtype=np.int64)
        if self._is_local or "places" in arrays:
            self.shown_ = ShownSteps.from_arrays(arrays, self.frame_manifolds_, len(self.priors_))
            self.modes_ = self.shown_.modes
