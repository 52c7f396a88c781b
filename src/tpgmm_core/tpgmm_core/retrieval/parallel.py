# SPDX-License-Identifier: Apache-2.0
"""`Parallel`: several movements at the same time, as one.

Composition in parallel (Section 6). Each movement has a model, frames and a phase of its own. At each step the
reference is the product of what they say, Eq. (6): each counts where, when and in the directions in which it is sure.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from tpgmm_core.common.types import Array
from tpgmm_core.geometry.frame import Frame
from tpgmm_core.geometry.gaussian import Gaussian
from tpgmm_core.geometry.manifold import Manifold
from tpgmm_core.geometry.mixture import GaussianMixture
from tpgmm_core.model.reference import Reference
from tpgmm_core.retrieval.interface import Retrieval


class Parallel(Retrieval):
    """A `Retrieval` whose references are the products of those of others.

    Movements may differ in method, frames and duration. One that has ended stays at its end, and still counts. The
    phase is that of the movement that is behind the others, so that the whole ends with the last one. A movement of
    which no frame is known does not count meanwhile.

    Parameters
    ----------
    movements
        one or more, of the same manifold

    Raises
    ------
    ValueError
        for no movements, and movements of different manifolds
    """

    def __init__(self, movements: Sequence[Retrieval]) -> None:
        if not movements:
            raise ValueError("there are no movements; expected at least one")
        for number, movement in enumerate(movements[1:], 2):
            if movement.manifold != movements[0].manifold:
                raise ValueError(
                    f"movement 1 is on {movements[0].manifold}, movement {number} on {movement.manifold}: movements in "
                    "parallel move the same"
                )
        self.movements = tuple(movements)
        self._phases = [0.0] * len(movements)
        self._going: list[int] = []  # those that took part in the last step
        self._encoded: dict[int, Manifold] = {}  # what the mixture of each is over

    @property
    def manifold(self) -> Manifold:
        """Manifold of the references, without time."""
        return self.movements[0].manifold

    @property
    def frame_names(self) -> tuple[str, ...]:
        """The frames of all models, each once."""
        return tuple(dict.fromkeys(name for movement in self.movements for name in movement.frame_names))

    @property
    def duration(self) -> float:
        """Of the longest movement at speed 1, s."""
        return max(movement.duration for movement in self.movements)

    @property
    def speed(self) -> float:
        """Of all movements: see `Retrieval.speed`."""
        return self.movements[0].speed

    @speed.setter
    def speed(self, speed: float) -> None:
        before = [movement.speed for movement in self.movements]
        try:
            for movement in self.movements:
                movement.speed = speed
        except ValueError:
            for movement, former in zip(self.movements, before, strict=True):
                movement.speed = former
            raise

    def start(self, time_ns: int, state: Array | None = None, phase: float = 0.0) -> None:
        """Begin all movements: see `Retrieval.start`. A phase is that of the longest."""
        self._going = []
        for i, movement in enumerate(self.movements):
            self._phases[i] = min(1.0, phase * self.duration / movement.duration)
            movement.start(time_ns, state, self._phases[i])

    def step(
        self,
        time_ns: int,
        frames: Mapping[str, Frame],
        state: Array | None = None,
        weights: Mapping[str, float] | None = None,
    ) -> Reference:
        """The product of the references at a time; each movement gets its own frames.

        Activations are those of the components of `mixture`.

        Raises
        ------
        ValueError
            as for `Retrieval.step`, and where the movements want orientations that are too far apart
        """
        unknown = sorted(set(frames) - set(self.frame_names))
        if unknown or not frames:
            raise ValueError(f"expected frames of {self.frame_names}, got {tuple(frames)}")
        references, going = [], []
        for i, movement in enumerate(self.movements):
            own = {name: frames[name] for name in movement.frame_names if name in frames}
            if own or not movement.frame_names:
                trusted = None if weights is None else {name: weights[name] for name in own if name in weights}
                references.append(movement.step(time_ns, own, state, trusted))
                self._phases[i] = references[-1].phase
                going.append(i)
        self._going = going
        for i in going:
            if i not in self._encoded:
                self._encoded[i] = self.movements[i].mixture().manifold
        dt = references[0].horizon_time_step
        ahead = [
            r.horizon if r.horizon_time_step == dt else self.movements[i].horizon(len(references[0].horizon), dt)
            for i, r in zip(going, references, strict=True)
        ]
        alike = [r.activations for i, r in zip(going, references, strict=True) if i in self._alike]
        return Reference(
            phase=min(self._phases),
            gaussian=Gaussian.product([r.gaussian for r in references]),
            horizon_time_step=dt,
            horizon=tuple(Gaussian.product(each) for each in zip(*ahead, strict=False)),
            activations=np.concatenate(alike) / len(alike),
            frames=tuple(frames),
        )

    def horizon(self, n: int, dt: float) -> list[Gaussian]:
        """The next n products, dt (s) apart: see `Retrieval.horizon`."""
        self._require_step()
        ahead = [self.movements[i].horizon(n, dt) for i in self._going]
        return [Gaussian.product(each) for each in zip(*ahead, strict=False)]

    def mixture(self) -> GaussianMixture:
        """The components of all models in the situation of the last step: see `Retrieval.mixture`.

        Where the models encode different dimensions, those of the models that encode the same as the first one.
        """
        self._require_step()
        mixtures = [self.movements[i].mixture() for i in self._alike]
        priors, means, covariances = (
            np.concatenate([getattr(mixture, name) for mixture in mixtures])
            for name in ("priors", "means", "covariances")
        )
        return GaussianMixture(priors / len(mixtures), means, covariances, mixtures[0].manifold)

    @property
    def _alike(self) -> list[int]:
        return [i for i in self._going if self._encoded[i] == self._encoded[self._going[0]]]

    def _require_step(self) -> None:
        if not self._going:
            raise ValueError("there was no step yet: call start(time_ns) and step(...)")
