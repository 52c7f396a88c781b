# SPDX-License-Identifier: Apache-2.0
"""The task of figures 1 to 3, a hand that leaves one box and enters another in the plane, and how it is drawn.

The first box stays where it is in the demonstrations, the second one is at a different place each time, and turned
differently. Boxes are open at one side: the hand leaves and enters through that side.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.patches import Ellipse

from tpgmm_core import TPGMM, Demonstration, Frame, Gaussian
from tpgmm_core.common.types import Array

DURATION = 2.0  # s
COMPONENTS = 5
#: Of components, in their order in time.
COLOURS = ("#1b9e77", "#d95f02", "#7570b3", "#e7298a", "#66a61e")
FRAME_COLOURS = {"first": "#c1121f", "second": "#1d4ed8"}
#: Places of the second box in the demonstrations: x and y in m, and its angle in degrees.
SECOND = np.array([[0.7, 1.0, 100.0], [0.95, 0.8, 80.0], [1.1, 0.5, 60.0], [1.15, 0.2, 40.0]])
POSITION = [1, 2]  # of [time, x, y]


# -- the task


def box(x: float, y: float, angle: float) -> Frame:
    """A box at a place (m), turned by an angle (degrees). `with_time`: all frames see the same time."""
    c, s = np.cos(np.radians(angle)), np.sin(np.radians(angle))
    return Frame(np.array([[c, -s], [s, c]]), np.array([x, y])).with_time()


def situation(factor: float, first: Frame | None = None) -> dict[str, Frame]:
    """The second box on the line from the middle of the demonstrated places (0) to the last one (1), and beyond."""
    middle = (SECOND[1] + SECOND[2]) / 2.0
    return {"first": first or box(0.0, 0.0, 0.0), "second": box(*(middle + factor * (SECOND[3] - middle)))}


def reach(frames: Mapping[str, Frame], rng: np.random.Generator) -> Demonstration:
    """What somebody shows: out of the first box and into the second one always alike, and freely in between."""
    first, second = frames["first"], frames["second"]
    start, goal = first.b[POSITION], second.b[POSITION]
    out, back = first.A[POSITION, 2], second.A[POSITION, 2]  # unit vectors through the open sides
    u = np.linspace(0.0, 1.0, 100)[:, None]
    s = u**3 * (10.0 - 15.0 * u + 6.0 * u**2)  # from rest to rest
    path = (1.0 - s) ** 3 * start + 3.0 * s * (1.0 - s) ** 2 * (start + 0.6 * out)
    path = path + 3.0 * s**2 * (1.0 - s) * (goal + 0.6 * back) + s**3 * goal
    path = path + (4.0 * s * (1.0 - s)) ** 2 * rng.normal(scale=0.04, size=2) + 0.004 * rng.normal(size=path.shape)
    return Demonstration(DURATION * u[:, 0], np.column_stack([DURATION * u, path]), frames)


def demonstrations() -> list[Demonstration]:
    """Four of them, as in the paper; the same ones at each call."""
    rng = np.random.default_rng(0)
    return [reach({"first": box(0.0, 0.0, 0.0), "second": box(*place)}, rng) for place in SECOND]


def learned(shown: Sequence[Demonstration], n_components: int = COMPONENTS) -> TPGMM:
    """The model of figures 1 to 3, over [time, x, y]."""
    return TPGMM(n_components, init="time", reg_covar=1e-5).fit(shown)


def end_without_frames(shown: Sequence[Demonstration]) -> Array:
    """Where a model that knows no frames ends (2,): where the demonstrations ended on average."""
    return np.mean([d.data[-1, POSITION] for d in shown], axis=0)


# -- how it is drawn


def draw_ellipse(axes: Axes, mean: Array, covariance: Array, colour: str, alpha: float = 0.35) -> None:
    """One standard deviation of a planar Gaussian, with an outline."""
    (x, y), (values, vectors) = mean, np.linalg.eigh(covariance)
    width, height = 2.0 * np.sqrt(np.maximum(values, 0.0))
    angle = np.degrees(np.arctan2(vectors[1, 0], vectors[0, 0]))
    filled: dict[str, Any] = {"facecolor": colour, "edgecolor": "none", "alpha": alpha, "zorder": 3}
    # above the paths, since some Gaussians are thinner than a line
    outline: dict[str, Any] = {"facecolor": "none", "edgecolor": colour, "alpha": min(1.0, 2.0 * alpha), "zorder": 4}
    for style in (filled, outline):
        axes.add_patch(Ellipse((x, y), width, height, angle=angle, **style))


def draw_gaussians(axes: Axes, gaussians: Sequence[Gaussian], alpha: float, colour: str | None = None) -> None:
    """Gaussians of [time, x, y], seen in the plane; in one colour, or in those of the components."""
    for k, gaussian in enumerate(gaussians):
        seen = gaussian.marginal(POSITION)
        draw_ellipse(axes, seen.mean, seen.covariance, colour or COLOURS[k % len(COLOURS)], alpha)


def draw_boxes(axes: Axes, frames: Mapping[str, Frame], alpha: float = 1.0, **style: Any) -> None:
    """All frames in their colours: boxes that are open towards their second axis."""
    corners = 0.12 * np.array([[-0.6, 0.9], [-0.6, -0.3], [0.6, -0.3], [0.6, 0.9]])
    for name, frame in frames.items():
        sides = corners @ frame.A[1:, 1:].T + frame.b[POSITION]
        look: dict[str, Any] = {
            "color": FRAME_COLOURS[name],
            "lw": 4.0,
            "solid_capstyle": "round",
            "solid_joinstyle": "round",
        } | style
        axes.plot(*sides.T, alpha=alpha, **look)


def draw_demonstrations(axes: Axes, shown: Sequence[Demonstration], alpha: float = 1.0) -> None:
    """Their paths and their boxes."""
    for d in shown:
        axes.plot(*d.data[:, POSITION].T, color="0.25", lw=1.5, alpha=alpha, zorder=1)
        draw_boxes(axes, d.frames, 0.6 * alpha)


def tidy(axes: Axes, title: str) -> None:
    """Equal scales, no ticks, a title."""
    axes.set_aspect("equal", adjustable="datalim")
    axes.set(xticks=[], yticks=[])
    axes.set_title(title, fontsize=11, loc="left")
