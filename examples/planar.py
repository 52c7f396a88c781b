# SPDX-License-Identifier: Apache-2.0
"""pbdlib's planar data as demonstrations, situations between and beyond them, and how figures draw them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import PatchCollection
from matplotlib.patches import Ellipse
from scipy.io import loadmat
from scipy.linalg import polar

from tpgmm_core import Demonstration, Frame
from tpgmm_core.common.types import Array

#: Of components, in their order in time.
COLOURS = ("#1b9e77", "#d95f02", "#7570b3", "#e7298a", "#66a61e")
FRAME_COLOURS = {"first": "#c1121f", "second": "#1d4ed8"}
DATA = Path("../shared/data/pbdlib")


def demonstrations(directory: Path) -> list[Demonstration]:
    """Data02.mat: four movements of 200 samples, [time in s, x, y], with two frames, of which the second is a
    reflection. The file's own views agree with Eq. (4) to its rounding.

    Raises
    ------
    FileNotFoundError
        when the data are not there
    """
    path = directory / "Data02.mat"
    if not path.is_file():
        raise FileNotFoundError(f"{path} is missing: give the directory of pbdlib's Data02.mat by --data")
    result = []
    for one in loadmat(path, simplify_cells=True)["s"]:
        data = np.asarray(one["Data0"], dtype=float).T
        frames = {name: Frame(p["A"], p["b"]) for name, p in zip(FRAME_COLOURS, one["p"], strict=True)}
        result.append(Demonstration(data[:, 0], data, frames))
    return result


def between(start: Frame, end: Frame, fraction: float) -> Frame:
    """The frame (over [time, x, y]) at a fraction of the way from one to another; below 0 and above 1 beyond them.

    A = Q S splits into what turns, and may reflect, and what stretches (polar decomposition). The turn from one Q to
    the other goes by its angle; S and b go in straight lines.

    Raises
    ------
    ValueError
        when only one of the frames reflects
    """
    (Q, S), (R, T) = polar(start.A[1:, 1:]), polar(end.A[1:, 1:])
    turn = R @ Q.T
    if np.linalg.det(turn) < 0.0:
        raise ValueError("one of the frames is a reflection and the other is not: no turn leads from one to the other")
    angle = fraction * np.arctan2(turn[1, 0], turn[0, 0])
    c, s = np.cos(angle), np.sin(angle)
    A = np.array([[c, -s], [s, c]]) @ Q @ (S + fraction * (T - S))
    return Frame(A, start.b[1:] + fraction * (end.b - start.b)[1:]).with_time()


def judged_end(demonstrations: Sequence[Demonstration], second: Frame, end: Array) -> dict[str, float | bool]:
    """How far the end (2,) of a reproduction is from where demonstrations ended on average, seen from the second frame.

    Beside it, the same of a model that knows no frames and ends where demonstrations ended on average; in units of the
    data. To pass is to be nearer by half.
    """
    seen = np.stack([d.projected()["second"][-1] for d in demonstrations]).mean(axis=0)
    expected = (second.A @ seen + second.b)[1:]
    fixed = np.stack([d.data[-1, 1:] for d in demonstrations]).mean(axis=0)
    error, without = float(np.linalg.norm(end - expected)), float(np.linalg.norm(fixed - expected))
    return {"end_error": error, "end_error_without_frames": without, "passed": error < 0.5 * without}


def draw_ellipse(axes: Axes, mean: Array, covariance: Array, colour: str, alpha: float = 0.35) -> None:
    """One standard deviation of a planar Gaussian, with an outline."""
    axes.add_patch(_ellipse(mean, covariance, facecolor=colour, edgecolor="none", alpha=alpha, zorder=3))
    # above the paths, since some Gaussians are thinner than a line
    axes.add_patch(
        _ellipse(mean, covariance, facecolor="none", edgecolor=colour, alpha=min(1.0, 2.0 * alpha), lw=2.0, zorder=4)
    )


def draw_band(axes: Axes, means: Array, covariances: Array) -> None:
    """One standard deviation along a path, behind everything else: means (T, 2), covariances (T, 2, 2)."""
    ellipses = [_ellipse(mean, covariance) for mean, covariance in zip(means, covariances, strict=True)]
    axes.add_collection(PatchCollection(ellipses, facecolor="0.87", edgecolor="none", zorder=0))


def _ellipse(mean: Array, covariance: Array, **style: Any) -> Ellipse:
    values, vectors = np.linalg.eigh(covariance)
    width, height = 2.0 * np.sqrt(np.maximum(values, 0.0))
    angle = np.degrees(np.arctan2(vectors[1, 0], vectors[0, 0]))
    return Ellipse((mean[0], mean[1]), width, height, angle=angle, **style)


def draw_frame(axes: Axes, frame: Frame, colour: str, alpha: float = 1.0) -> None:
    """A frame as the paper draws it: an open box whose mouth points along the second axis."""
    A, b = frame.A[1:, 1:], frame.b[1:]
    box = np.array([[-0.6, 0.9], [-0.6, -0.3], [0.6, -0.3], [0.6, 0.9]]) @ A.T + b
    axes.plot(*box.T, color=colour, alpha=alpha, lw=4.0, solid_capstyle="round", solid_joinstyle="round")


def draw_frames(axes: Axes, frames: Mapping[str, Frame], alpha: float = 1.0) -> None:
    """All frames in their colours."""
    for name, frame in frames.items():
        draw_frame(axes, frame, FRAME_COLOURS[name], alpha)


def tidy(axes: Axes, title: str) -> None:
    """Equal scales, no ticks, a title."""
    axes.set_aspect("equal", adjustable="datalim")
    axes.set_xticks([])
    axes.set_yticks([])
    axes.set_title(title, fontsize=10)
