# SPDX-License-Identifier: Apache-2.0
"""`PeriodicTPGMM`: a movement that repeats, as a Gaussian for each step of its phase and each frame.

It is a probabilistic movement primitive over the circle. Its inputs are the cosine and the sine of the phase: the basis
functions are Gaussians of the distance on the unit circle, which are von Mises functions of the angle (Paraschos et
al., NIPS 2013; rhythmic primitives of Ijspeert et al., Neural Computation 2013),

    b_i(phi) = exp((cos(phi - c_i) - 1) / h^2) / sum_j b_j(phi).

So mean, velocity and covariance are the same after a whole turn, whatever was shown. Each cycle of a demonstration is
one observation of the weights (`tpgmm_core.learning.promp`), with the phases of `tpgmm_core.learning.cycles`.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import ClassVar, Self

import numpy as np

from tpgmm_core.common.types import Array
from tpgmm_core.learning.cycles import (
    STEPS,
    TURN,
    Cycles,
    at_phases,
    beginnings,
    cycles_of,
    numbers_of,
    offset,
)
from tpgmm_core.learning.estimation.iteration import EmProgress
from tpgmm_core.learning.promp import gaussians_of_weights
from tpgmm_core.learning.shown_to_frame import ShownToFrame, resampled
from tpgmm_core.learning.step_mixture import StepMixture
from tpgmm_core.model.demonstration import Demonstration
from tpgmm_core.model.samples import Samples


@dataclass(eq=False, repr=False)
class PeriodicTPGMM(StepMixture):
    """TP-GMM with a component for each step of the phase, which is the first dimension, 0 to 2 pi rad.

    Parameters and attributes that are not listed here are those of `StepMixture` and `StoredMixture`.

    Parameters
    ----------
    n_basis
        number of basis functions, from 3 to `n_steps`: the more, the finer the details that are kept

    Attributes
    ----------
    period_
        mean duration of the demonstrated cycles, s
    cycles_
        number of cycles that were learned from
    """

    period_: float = field(init=False)
    cycles_: int = field(init=False)
    is_closed: ClassVar[bool] = True

    n_basis: int = 20

    def phases(self, demonstration: Demonstration) -> Array:
        """The phases of the model that a demonstration goes through.

        Parameters
        ----------
        demonstration
            over [time, data], in which the movement repeats

        Returns
        -------
        Array
            (T,), rad, increasing; the model is the same after 2 pi

        Raises
        ------
        ValueError
            for a demonstration that does not repeat, or has other frames
        """
        return self._samples([demonstration]).times

    def _samples(self, demonstrations: Sequence[Demonstration]) -> Samples:
        """Samples over [phase, data], whose times are the phases without the wrap."""
        samples = super()._samples(demonstrations)
        shapes = {}
        for name, manifold in samples.manifolds.items():
            # the last step is the first one
            points = self.means_[name][:-1, 1:]
            numbers = numbers_of(manifold.subset(range(1, manifold.dim)), points)
            steps = np.arange(STEPS) * len(points) / STEPS
            closed = np.vstack([numbers, numbers[:1]])
            shapes[name] = np.stack([np.interp(steps, np.arange(len(closed)), x) for x in closed.T], axis=1)
        found = _cycles(samples)
        return _over_phase(
            samples, found, [offset(one.shapes, {name: shapes[name] for name in one.shapes}) for one in found]
        )

    def _fit(self, samples: Samples, progress: EmProgress | None) -> Self:
        found = _cycles(samples)
        duration = float(sum(samples.times[own][-1] - samples.times[own][0] for own in _slices(samples)))
        super()._fit(_over_phase(samples, found, beginnings(found)), progress)
        # Time may be stretched, so that all demonstrations last equally long: all of it has all cycles in it
        self.period_ = duration / sum(one.count for one in found)
        self.cycles_ = sum(_whole(one) for one in found)
        return self

    def _shown(self, samples: Samples, name: str, j: int) -> ShownToFrame:
        """Each cycle of each demonstration, at the same phases."""
        x, seen, grid = samples.X[name], samples.seen[j], np.linspace(0.0, TURN, self.n_steps)
        manifold = samples.manifolds[name]
        space = manifold.subset(range(1, manifold.dim))
        points, visible = [], []
        for own in _slices(samples):
            phases = samples.times[own]
            for cycle in range(max(int((phases[-1] - phases[0]) / TURN + 1e-6), 1)):
                asked = at_phases(np.mod(grid, TURN), phases[0], cycle)
                points.append(resampled(space, phases, x[own, 1:], asked))
                visible.append(seen[own][np.abs(phases[:, None] - asked).argmin(axis=0)])
        return ShownToFrame(space, grid, np.stack(points), np.stack(visible), x[seen, 1:])

    def _gaussians(self, shown: ShownToFrame) -> tuple[Array, Array]:
        return gaussians_of_weights(shown, circular_basis(self.n_steps, self.n_basis), self._predictive)

    def _check_parameters(self) -> None:
        super()._check_parameters()
        self._check_integers("n_basis", least=3)
        if self.n_basis > self.n_steps:
            raise ValueError(f"n_basis is an integer from 3 to n_steps = {self.n_steps}, got {self.n_basis}")

    def _more_arrays(self) -> dict[str, Array]:
        return {"cycles": np.array([self.period_, self.cycles_], dtype=float)}

    def _restore(self, arrays: Mapping[str, Array]) -> None:
        period, cycles = np.asarray(arrays["cycles"], dtype=float)
        if not (np.isfinite([period, cycles]).all() and period > 0.0 and cycles >= 1.0):
            raise ValueError(f"a periodic model holds its period, s, and its cycles, got {period!r} and {cycles!r}")
        if len(self.priors_) < 3:
            raise ValueError(f"a periodic model has three steps or more, got {len(self.priors_)}")
        self.period_, self.cycles_ = float(period), int(cycles)


def circular_basis(n_steps: int, n_basis: int) -> Array:
    """Basis functions (T, B) at steps from 0 to 2 pi, a spacing wide; the values at each step add up to 1."""
    spacing = TURN / n_basis
    angles = np.linspace(0.0, TURN, n_steps)[:, None] - spacing * np.arange(n_basis)
    values = np.exp((np.cos(angles) - 1.0) / spacing**2)
    return np.asarray(values / values.sum(axis=1, keepdims=True))


def _cycles(samples: Samples) -> list[Cycles]:
    """Of each demonstration, in the frames that all demonstrations saw all the time; in all where there is none."""
    names = [name for name, seen in zip(samples.X, samples.seen, strict=True) if seen.all()] or list(samples.X)
    numbers = {}
    for name in names:
        manifold = samples.manifolds[name]
        numbers[name] = numbers_of(manifold.subset(range(1, manifold.dim)), samples.X[name][:, 1:])
    found = []
    for i, own in enumerate(_slices(samples)):
        try:
            found.append(cycles_of(samples.times[own], {name: x[own] for name, x in numbers.items()}))
        except ValueError as error:
            raise ValueError(f"demonstration {i}: {error}") from error
    return found


def phases_shown(samples: Samples) -> list[Array]:
    """The phases of demonstrations that repeat.

    Parameters
    ----------
    samples
        over [time, data]

    Returns
    -------
    list[Array]
        of each demonstration (T,), rad, increasing; they fit each other as `beginnings` says

    Raises
    ------
    ValueError
        for a demonstration that does not repeat
    """
    found = _cycles(samples)
    return [begin + one.phases for one, begin in zip(found, beginnings(found), strict=True)]


def _over_phase(samples: Samples, found: Sequence[Cycles], begins: Sequence[float] | Array) -> Samples:
    """Samples whose first dimension is the phase, 0 to 2 pi, and whose times are the phases without the wrap."""
    phases = np.concatenate([begin + one.phases for one, begin in zip(found, begins, strict=True)])
    wrapped = np.mod(phases, TURN)
    X = {name: np.column_stack([wrapped, x[:, 1:]]) for name, x in samples.X.items()}
    return replace(samples, X=X, times=phases)


def _whole(one: Cycles) -> int:
    return max(int(one.count + 1e-6), 1)


def _slices(samples: Samples) -> list[slice]:
    ends = np.cumsum(samples.lengths).tolist()
    return [slice(end - length, end) for end, length in zip(ends, samples.lengths, strict=True)]
