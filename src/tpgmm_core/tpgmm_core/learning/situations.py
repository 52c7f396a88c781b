# SPDX-License-Identifier: Apache-2.0
"""What situations demonstrations were shown in: what they determine, what they leave open, which one would add most.

A situation is where the frames are. Each way in which frames vary between demonstrations is a degree of freedom. How a
movement follows d of them is, to first order, an affine function: d + 1 situations determine it, and only those beyond
say how exactly it holds. With as many again, 2 (d + 1), half of all that is known is about how exact it is. Where the
next demonstration adds most is a question of optimal design (Fedorov 1972): the variance of what an affine function
predicts is in proportion to the leverage h^T (H^T H)^-1 h, which is largest at a corner of the range.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tpgmm_core.common.types import Array
from tpgmm_core.geometry.frame import Frame
from tpgmm_core.geometry.manifold import Manifold
from tpgmm_core.model.demonstration import Demonstration
from tpgmm_core.model.frame_buffer import manifold_origin

STANDS_STILL = 0.05
"""A coordinate varies where its range exceeds this share of the largest range of its kind, and for turns this, rad."""
COLLINEAR = 1e-3
"""Directions whose variance is below this share of that of independent coordinates were not shown by themselves."""
MOST_CORNERS = 4096
AXES = "xyz"


@dataclass(frozen=True, slots=True, eq=False)
class FrameCoordinates:
    """Where frames are, as numbers: their images of the space's origin, in the tangent spaces at the means of these.

    Parameters
    ----------
    manifold
        of the data, without time
    means
        frame → (D,), a point of the manifold
    """

    manifold: Manifold
    means: Mapping[str, Array]

    @classmethod
    def of(cls, situations: Sequence[Mapping[str, Frame]], manifold: Manifold) -> FrameCoordinates:
        """Coordinates about the mean of situations, frames over [time, data]; manifold of the data, without time."""
        origin = manifold_origin(manifold)
        means = {
            name: manifold.mean(np.stack([_image(frames[name], origin) for frames in situations if name in frames]))
            for name in dict.fromkeys(name for frames in situations for name in frames)
        }
        return cls(manifold, means)

    def __call__(self, frames: Mapping[str, Frame]) -> Array:
        """Numbers (C,) of a situation; those of a frame that is missing are not known: NaN."""
        origin, n = manifold_origin(self.manifold), self.manifold.tangent_dim
        parts = [
            self.manifold.log(mean, _image(frames[name], origin)) if name in frames else np.full(n, np.nan)
            for name, mean in self.means.items()
        ]
        return np.concatenate(parts)

    @property
    def names(self) -> list[tuple[str, str, bool]]:
        """Of each number: its frame, what it is, and whether it is a turn."""
        names = [""] * self.manifold.tangent_dim
        flat = self.manifold.flat_tangent
        for i, t in enumerate(flat):
            names[t] = AXES[i] if len(flat) <= 3 else f"dimension {i + 1}"
        for i, sphere in enumerate(self.manifold.spheres):
            for axis, t in zip(AXES, range(sphere.tangent.start, sphere.tangent.stop), strict=True):
                names[t] = f"turn about {axis}" + (f" ({i + 1})" if i else "")
        return [(frame, name, name.startswith("turn")) for frame in self.means for name in names]


@dataclass(frozen=True, slots=True)
class DemonstratedSituations:
    """What demonstrations say of how a movement follows its frames.

    Parameters
    ----------
    count
        number of demonstrations
    varied
        "frame: coordinate" of all degrees of freedom
    constant
        the same, of what frames that vary otherwise always had alike
    least, better
        how many situations determine how the movement follows the frames, and how many say how exactly as well
    undetermined
        number of directions, of those degrees of freedom, that were not shown by themselves
    most_informative
        "frame: coordinate" → value, of the situation in the demonstrated range whose demonstration would add most: m,
        and rad from the mean orientation
    """

    count: int
    varied: tuple[str, ...]
    constant: tuple[str, ...]
    least: int
    better: int
    undetermined: int
    most_informative: Mapping[str, float]

    def __str__(self) -> str:
        if not self.varied:
            if self.count == 1:
                return "one demonstration shows one situation: it cannot show how to adapt to another"
            return f"all {self.count} demonstrations have the same situation: they cannot show how to adapt to another"
        freedom = "1 degree" if len(self.varied) == 1 else f"{len(self.varied)} degrees"
        text = (
            f"{_grouped(self.varied)} varied: {freedom} of freedom. At least {self.least} situations "
            f"are needed to learn how the movement follows them, {self.better} to learn how precisely; "
            f"{self.count} were demonstrated"
        )
        if self.undetermined:
            text += f", and {self.undetermined} of the degrees of freedom never varied independently"
        if self.count < self.better or self.undetermined:
            places = _grouped([f"{name} {value:.2f}" for name, value in self.most_informative.items()])
            text += f". The most informative next demonstration: {places} (m; rad from the mean orientation)"
        if self.constant:
            text += f". Never varied, so not learned: {_grouped(self.constant)}"
        return text


def demonstrated_situations(demonstrations: Iterable[Demonstration], manifold: Manifold) -> DemonstratedSituations:
    """Judge the situations at the beginnings of demonstrations.

    Parameters
    ----------
    demonstrations
        over [time, data]; gone through once
    manifold
        of [time, data]

    Returns
    -------
    DemonstratedSituations
        what they say of how the movement follows the frames
    """
    space = manifold.subset(range(1, manifold.dim))
    situations = [first_frames(demonstration) for demonstration in demonstrations]
    coordinates = FrameCoordinates.of(situations, space)
    values = np.array([coordinates(frames) for frames in situations])
    values = np.where(np.isnan(values), np.nanmean(values, axis=0), values)
    ranges, names = np.ptp(values, axis=0), coordinates.names
    is_turn = np.array([turn for _, _, turn in names])
    longest = float(np.max(ranges[~is_turn], initial=0.0))
    widest = float(np.max(ranges[is_turn], initial=1.0))
    varies = ranges > STANDS_STILL * np.where(is_turn, widest, max(longest, 1e-6))
    moving = {names[i][0] for i in np.flatnonzero(varies)}
    named = [f"{frame}: {what}" for frame, what, _ in names]
    chosen = np.flatnonzero(varies)
    d, undetermined, best = len(chosen), 0, {}
    if d:
        scaled = (values[:, chosen] - values[:, chosen].mean(axis=0)) / values[:, chosen].std(axis=0)
        eigenvalues = np.linalg.eigvalsh(scaled.T @ scaled / len(scaled))
        undetermined = int(np.count_nonzero(eigenvalues < COLLINEAR))
        best = dict(zip([named[i] for i in chosen], _most_informative(coordinates, values, chosen), strict=True))
    return DemonstratedSituations(
        count=len(situations),
        varied=tuple(named[i] for i in chosen),
        constant=tuple(named[i] for i in np.flatnonzero(~varies) if names[i][0] in moving),
        least=d + 1,
        better=2 * (d + 1),
        undetermined=undetermined,
        most_informative=best,
    )


def first_frames(demonstration: Demonstration) -> dict[str, Frame]:
    """The frames of a demonstration, each when it was first seen."""
    found = {}
    for name, frame in demonstration.frames.items():
        seen = np.flatnonzero(demonstration.is_visible(name))
        if len(seen):
            found[name] = frame.at(seen[:1]).at(0) if frame.is_time_varying else frame  # no view of all the others
    return found


def seen_from(reference: Frame, frame: Frame, origin: Array) -> Array:
    """The origin of a frame, as seen from another one.

    Parameters
    ----------
    reference, frame
        over [time, data]
    origin
        of the data's manifold, (D,)

    Returns
    -------
    Array
        shape (D,)
    """
    image = np.concatenate([[0.0], _image(frame, origin)])
    return np.asarray(reference.project(image[None])[0, 1:])


def _most_informative(coordinates: FrameCoordinates, values: Array, chosen: NDArray[np.intp]) -> list[float]:
    """Positions of frames, and their turns from the mean, at the corner of the range with the largest leverage."""
    shown = values[:, chosen]
    low, high = shown.min(axis=0), shown.max(axis=0)
    H = np.column_stack([np.ones(len(shown)), (2.0 * shown - low - high) / (high - low)])
    d = len(chosen)
    if 2**d <= MOST_CORNERS:
        bits = (np.arange(2**d)[:, None] >> np.arange(d)) & 1
    else:
        bits = np.random.default_rng(0).integers(0, 2, (MOST_CORNERS, d))
    corners = np.where(bits == 1, -1.0, 1.0)
    h = np.column_stack([np.ones(len(corners)), corners])
    inverse = np.linalg.inv(H.T @ H + COLLINEAR * np.eye(d + 1))
    corner = corners[np.argmax(np.einsum("ci,ij,cj->c", h, inverse, h))]
    offsets = 0.5 * (low + high + corner * (high - low))
    ambient = coordinates.manifold.ambient_of_tangent
    origins = np.concatenate([np.where(ambient >= 0, mean[ambient], 0.0) for mean in coordinates.means.values()])
    return [float(origins[i] + offset) for i, offset in zip(chosen, offsets, strict=True)]


def _image(frame: Frame, origin: Array) -> Array:
    return np.asarray(frame.A[1:, 1:] @ origin + frame.b[1:])


def _grouped(names: Sequence[str]) -> str:
    """Names by frame: from "object: x", "object: y", "target: x" to "object (x, y), target (x)"."""
    groups: dict[str, list[str]] = {}
    for name in names:
        frame, what = name.split(": ", 1)
        groups.setdefault(frame, []).append(what)
    return ", ".join(f"{frame} ({', '.join(whats)})" for frame, whats in groups.items())
