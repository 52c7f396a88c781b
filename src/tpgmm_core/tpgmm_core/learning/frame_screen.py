# SPDX-License-Identifier: Apache-2.0
"""Which frames matter, and when: each alone predicts each demonstration from the others.

In a frame that matters, demonstrations are alike. At each share of the time, the mean of all demonstrations but one, as
a frame sees them, is moved with that frame to the situation of the one left out; how far that is from what was shown
there is the frame's error. The fewest frames are kept of which one is nearly the best nearly everywhere: what is left
out explains nothing that they do not explain as well. Nothing is fitted, and nothing is assumed of the method that is
used afterwards.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tpgmm_core.common.types import Array
from tpgmm_core.geometry import quaternion
from tpgmm_core.geometry.frame import Frame
from tpgmm_core.model.demonstration import Demonstration

SHARES = 100
"""Moments of a movement that are compared, at equal shares of its time."""
METRES_PER_RADIAN = 0.1
"""How far apart two poses are: a turn by 0.1 rad counts as a centimetre."""
LEAST_SHARE = 0.05
"""A frame is kept where it predicts best, and none that is kept does as well, for at least this share of the time."""
MARGIN = 0.15
"""A frame whose error is larger than the least one by less than this share is as good."""
TOLD = 0.5
"""What a frame predicts has to differ from what the base predicts by this share of the base's error: a frame that
hardly moves cannot make that much smaller, and of many one will make it a little smaller by chance."""
ALIKE = 0.05
"""Of frames that are good at most of the time, to this share, the one that is named first is taken."""


@dataclass(frozen=True, slots=True, eq=False)
class FrameScreen:
    """What each frame alone predicts of demonstrations that were left out.

    Parameters
    ----------
    names
        of the frames, those first that are taken where several are as good
    errors
        shape (J, M, S): of frame j, for demonstration m, at share s of the time, m; infinite where it was not seen
    is_told
        shape (J, S): whether frame j can be told from the base, or is as still as the base
    """

    names: tuple[str, ...]
    errors: Array
    is_told: NDArray[np.bool_]

    @property
    def mean_errors(self) -> Array:
        """Root mean square of the errors over the demonstrations, (J, S)."""
        return np.asarray(np.sqrt(np.mean(self.errors**2, axis=1)))

    def shares(self) -> dict[str, float]:
        """Frames that are kept, and the share of the time for which each was taken; the first explains most of it."""
        is_good = self._is_good()
        shares: dict[str, float] = {}
        while True:
            gains = is_good.mean(axis=1)
            if gains.max() < LEAST_SHARE:
                return shares
            chosen = int(np.argmax(gains >= (1.0 - ALIKE) * gains.max()))
            shares[self.names[chosen]] = float(gains[chosen])
            is_good = is_good & ~is_good[chosen]

    def rivals(self) -> tuple[str, ...]:
        """Frames that are nearly the best for at least LEAST_SHARE of the time, those with most of it first."""
        good = dict(zip(self.names, self._is_good().mean(axis=1).tolist(), strict=True))
        return tuple(sorted((name for name in good if good[name] >= LEAST_SHARE), key=lambda name: -good[name]))

    def _is_good(self) -> NDArray[np.bool_]:
        means = np.where(self.is_told, self.mean_errors, np.inf)  # (J, S)
        return np.asarray(means <= (1.0 + MARGIN) * means.min(axis=0) + 1e-9) & self.is_told

    def relevance(self, names: Sequence[str], parts: int = 10) -> dict[str, Array]:
        """What each of some frames says of where the hand is, in each part of the time: name → shares (parts,).

        The shares of all add up to 1. They are those of the inverse squared errors: what the product of Gaussians (Eq.
        6) would weight frames with whose variances are these.

        Returns
        -------
        dict[str, Array]
            name → shares, (parts,)
        """
        rows = [self.names.index(name) for name in names]
        precisions = 1.0 / (self.mean_errors[rows] ** 2 + 1e-12)  # (J, S)
        shares = precisions / precisions.sum(axis=0)
        split = np.array_split(shares, parts, axis=1)
        return {name: np.array([part[j].mean() for part in split]) for j, name in enumerate(names)}


def screen_frames(demonstrations: Sequence[Demonstration], names: Sequence[str] | None = None) -> FrameScreen:
    """How well each frame alone predicts each demonstration from the others.

    Parameters
    ----------
    demonstrations
        at least two, over [time, position] or [time, pose]
    names
        of the frames, in order of preference; all where None

    Returns
    -------
    FrameScreen
        the errors of each frame

    Raises
    ------
    ValueError
        for fewer than two demonstrations
    """
    if len(demonstrations) < 2:
        raise ValueError(f"comparing frames needs at least two demonstrations, got {len(demonstrations)}: record more")
    chosen = tuple(demonstrations[0].frames) if names is None else tuple(names)
    samples = [_samples(shown.times) for shown in demonstrations]
    points = np.array([shown.data[chosen_ones] for shown, chosen_ones in zip(demonstrations, samples, strict=True)])
    D = points.shape[2]
    base = _predictions(points, [Frame(np.eye(D), np.zeros(D))] * len(points))
    base_error = np.sqrt(np.mean(distances(base, points[..., 1:]) ** 2, axis=0))  # (S,)
    errors, is_told = [], []
    for name in chosen:
        frames = [shown.frames[name].at(at) for shown, at in zip(demonstrations, samples, strict=True)]
        predicted = _predictions(points, frames)
        error = distances(predicted, points[..., 1:])
        seen = [shown.is_visible(name)[at] for shown, at in zip(demonstrations, samples, strict=True)]
        errors.append(np.where(seen, error, np.inf))
        change = np.sqrt(np.mean(distances(predicted, base) ** 2, axis=0))
        is_told.append((change >= TOLD * base_error) | (change <= 1e-6))
    return FrameScreen(chosen, np.array(errors), np.array(is_told))


def _samples(times: Array) -> NDArray[np.intp]:
    """The samples nearest to equal shares of the time, (SHARES,)."""
    wanted = np.linspace(times[0], times[-1], SHARES)
    after = np.clip(np.searchsorted(times, wanted), 1, len(times) - 1)
    return np.asarray(np.where(wanted - times[after - 1] < times[after] - wanted, after - 1, after))


def _predictions(points: Array, frames: Sequence[Frame]) -> Array:
    """Where each demonstration would be, as the others look from its frame, (M, S, D - 1); points are (M, S, D)."""
    seen = np.array([frame.project(data)[:, 1:] for frame, data in zip(frames, points, strict=True)])
    seen[..., 3:] = _one_sign(seen[..., 3:])
    means = (seen.sum(axis=0) - seen) / (len(frames) - 1)
    return np.array(
        [
            np.einsum("...ij,...j->...i", frame.A[..., 1:, 1:], mean) + frame.b[..., 1:]
            for frame, mean in zip(frames, means, strict=True)
        ]
    )


def _one_sign(quaternions: Array) -> Array:
    """Quaternions (M, S, 4) with the signs of the first demonstration: means of both signs are none."""
    if quaternions.shape[-1] == 0:
        return quaternions
    return np.where(np.sum(quaternions * quaternions[:1], axis=-1, keepdims=True) < 0.0, -quaternions, quaternions)


def distances(path: Array, shown: Array) -> Array:
    """How far poses (..., 7) or positions (..., 3) are from others, m: METRES_PER_RADIAN says what a turn counts."""
    squares = np.sum((path[..., :3] - shown[..., :3]) ** 2, axis=-1)
    if path.shape[-1] == 7:
        one, other = quaternion.normalize(path[..., 3:]), quaternion.normalize(shown[..., 3:])
        turns = quaternion.angle_between(one, other)
        squares = squares + (METRES_PER_RADIAN * turns) ** 2
    return np.asarray(np.sqrt(squares))
