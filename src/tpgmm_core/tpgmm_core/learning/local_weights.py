# SPDX-License-Identifier: Apache-2.0
"""`ShownSteps`: what each demonstration did at each time step, and where its frames were, for weights by nearness.

Not all demonstrations say as much of a situation: those whose situation was nearer say more (locally weighted learning:
Atkeson, Moore and Schaal 1997). A place is where a frame is as seen from the first one, at that time step, so that it
does not matter where the world's origin is. With z_c the coordinates of the present places, z_ic those of demonstration
i and s_c their standard deviations over the demonstrations,

    w_i ~ exp(-1/2 locality d_i^2),   d_i^2 = mean_c ((z_c - z_ic) / s_c)^2,   sum_i w_i = 1.

So with locality 1 a demonstration as far as two of them usually are from each other counts e^-1 as much as one at the
same place. A step's mean in a frame moves by sum_i w_i e_i, e_i the tangent vector from the mean to demonstration i,
and its covariance is that of the module `time_steps` with weighted moments and with 1 / sum_i w_i^2 in place of the
number of demonstrations.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tpgmm_core.common.types import Array
from tpgmm_core.geometry.frame import Frame
from tpgmm_core.geometry.manifold import Manifold
from tpgmm_core.learning.situations import seen_from
from tpgmm_core.model.demonstration import Demonstration
from tpgmm_core.model.frame_buffer import manifold_origin

STILL = (1e-3, 0.01)
"""Standard deviations are at least these: units of places (m), rad. What hardly moved between demonstrations says
nothing of which one is near."""


@dataclass(frozen=True, slots=True, eq=False)
class Places:
    """Where frames are, as seen from the first one, in numbers.

    Parameters
    ----------
    manifold
        of the data, without time
    names
        of the frames
    bases
        (P - 1, D), points about which the places of the others are tangent vectors
    """

    manifold: Manifold
    names: tuple[str, ...]
    bases: Array

    def __call__(self, frames: Mapping[str, Frame]) -> Array:
        """Numbers (C,) of frames over [time, data]; NaN where a frame, or the first one, is not known."""
        points = self.points(frames, self.names, self.manifold)
        found = np.full((len(points), self.manifold.tangent_dim), np.nan)
        known = ~np.isnan(points).any(axis=1)
        if known.any():
            found[known] = self.manifold.log(self.bases[known], points[known])
        return found.ravel()

    @staticmethod
    def points(frames: Mapping[str, Frame], names: Sequence[str], manifold: Manifold) -> Array:
        """Origins (P - 1, D) of all frames but the first, as seen from that."""
        origin = manifold_origin(manifold)
        points = np.full((len(names) - 1, manifold.dim), np.nan)
        for j, name in enumerate(names[1:]):
            if name in frames and names[0] in frames:
                points[j] = seen_from(frames[names[0]], frames[name], origin)
        return points


@dataclass(frozen=True, slots=True, eq=False)
class ShownSteps:
    """Demonstrations at the time steps of a model.

    Parameters
    ----------
    places
        how places are told
    scales
        (C,), standard deviations of the places over demonstrations
    shown
        (m, T, C), places of each demonstration
    deviations
        frame → (m, T, n), tangent vectors from the means of the steps
    seen
        (P, m, T), whether the frame saw the demonstration
    modes
        (m,), the way of each demonstration: see `tpgmm_core.learning.modes`
    """

    places: Places
    scales: Array
    shown: Array
    deviations: Mapping[str, Array]
    seen: NDArray[np.bool_]
    modes: NDArray[np.int64]

    @classmethod
    def of(
        cls,
        demonstrations: Sequence[Demonstration],
        manifold: Manifold,
        deviations: Mapping[str, Array],
        seen: NDArray[np.bool_],
        modes: NDArray[np.int64],
    ) -> ShownSteps:
        """Of demonstrations over [time, data]; manifold of the data, without time; the others as above."""
        names, (m, T) = tuple(demonstrations[0].frames), seen.shape[1:]
        points = np.stack([_points(shown, names, manifold, T) for shown in demonstrations])  # (m, T, P - 1, D)
        bases = np.zeros((len(names) - 1, manifold.dim))
        for j in range(len(bases)):
            bases[j] = manifold.mean(points[:, :, j].reshape(m * T, -1))
        places = Places(manifold, names, bases)
        shown = np.concatenate(
            [manifold.log(base, points[:, :, j]) for j, base in enumerate(places.bases)] or [np.zeros((m, T, 0))],
            axis=-1,
        )
        floor = np.full(manifold.tangent_dim, STILL[1])
        floor[manifold.flat_tangent] = STILL[0]
        spread = np.sqrt(np.mean(shown.var(axis=0, ddof=1 if m > 1 else 0), axis=0))
        scales = np.maximum(spread, np.tile(floor, len(names) - 1))
        return cls(places, scales, shown, deviations, seen, modes)

    def arrays(self) -> dict[str, Array]:
        """All numbers, as a model file holds them."""
        numbers = {
            "places_bases": self.places.bases,
            "places_scales": self.scales,
            "places": self.shown,
            "seen": self.seen.astype(float),
            "modes": self.modes.astype(float),
        }
        return numbers | {f"deviations_{j}": array for j, array in enumerate(self.deviations.values())}

    @classmethod
    def from_arrays(cls, arrays: Mapping[str, Array], frames: Mapping[str, Manifold], n_steps: int) -> ShownSteps:
        """Make them from what `arrays` gave.

        Parameters
        ----------
        arrays
            by name
        frames
            name → space of the frame's view, time included
        n_steps
            T

        Returns
        -------
        ShownSteps
            the steps

        Raises
        ------
        ValueError
            for arrays that do not fit the frames
        """
        spaces = {name: manifold.subset(range(1, manifold.dim)) for name, manifold in frames.items()}
        space = next(iter(spaces.values()))
        P, m = len(spaces), len(arrays["places"])
        C = (P - 1) * space.tangent_dim
        deviations = {name: arrays[f"deviations_{j}"] for j, name in enumerate(spaces)}
        expected = {
            "places_bases": (P - 1, space.dim),
            "places_scales": (C,),
            "places": (m, n_steps, C),
            "seen": (P, m, n_steps),
            "modes": (m,),
            **{f"deviations_{j}": (m, n_steps, s.tangent_dim) for j, s in enumerate(spaces.values())},
        }
        for key, shape in expected.items():
            if arrays[key].shape != shape or not np.isfinite(arrays[key]).all() or m == 0:
                raise ValueError(f"{key} of {m} demonstrations has the shape {arrays[key].shape}, expected {shape}")
        if arrays["places_scales"].min(initial=1.0) <= 0.0:
            raise ValueError("the scales of places are above 0")
        modes = arrays["modes"].astype(np.int64)
        if set(modes.tolist()) != set(range(int(np.clip(modes.max(), 0, m)) + 1)):
            raise ValueError("the ways of demonstrations are counted from 0")
        places = Places(space, tuple(spaces), arrays["places_bases"])
        return cls(places, arrays["places_scales"], arrays["places"], deviations, arrays["seen"] > 0.5, modes)


def _points(shown: Demonstration, names: Sequence[str], manifold: Manifold, n_steps: int) -> Array:
    """Places (T, P - 1, D) of a demonstration at even shares of its time; hidden frames are where they were seen."""
    t = shown.times
    steps = np.abs(t[:, None] - np.linspace(t[0], t[-1], n_steps)).argmin(axis=0)
    seen = {name: np.flatnonzero(shown.is_visible(name)) for name in names}
    changes = any(shown.frames[name].is_time_varying for name in names)
    found = []
    for step in steps if changes else steps[:1]:
        frames = {
            name: shown.frames[name].at(int(seen[name][np.abs(seen[name] - step).argmin()]))
            for name in names
            if len(seen[name])
        }
        found.append(Places.points(frames, names, manifold))
    points = np.stack(found) if changes else np.repeat(np.stack(found), n_steps, axis=0)
    points[np.isnan(points).any(axis=2)] = manifold_origin(manifold)
    return points
