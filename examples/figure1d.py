# SPDX-License-Identifier: Apache-2.0
"""Figure 1 (d) of the paper: stiffness ellipsoids along a reach in a new situation.

Demonstrations leave the start and enter the object each along its axis, always alike, and go between them as they
like. The infinite-horizon LQR on the reproduction's precision is then stiff where they agree and soft where they do
not. Its stiffness is the square root of the precision, so that the ellipse of standard deviations is also where a push
moves the hand, the same in all directions: narrow where the demonstrations agree, wide where they do not. Ellipses of
the stiffness itself, how hard the hand is pulled back, are its inverse.
"""

from __future__ import annotations

import argparse
import os
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path

os.environ.update(OMP_NUM_THREADS="1", OPENBLAS_NUM_THREADS="1")  # before numpy is imported

import numpy as np  # noqa: E402
from matplotlib.axes import Axes  # noqa: E402
from matplotlib.backends.backend_agg import FigureCanvasAgg  # noqa: E402
from matplotlib.figure import Figure  # noqa: E402
from numpy.typing import ArrayLike  # noqa: E402

from examples import planar  # noqa: E402
from examples.report import write_report  # noqa: E402
from tpgmm_core import TPGMM, Demonstration, Frame  # noqa: E402
from tpgmm_core.common.report import Row  # noqa: E402
from tpgmm_core.common.types import Array  # noqa: E402
from tpgmm_core.lqr.double_integrator import double_integrator_gains  # noqa: E402
from tpgmm_core.retrieval.regression import RegressThenProduct  # noqa: E402

DURATION = 2.0  # s
CONTROL_COST = 1e-3
SHOWN = 13  # ellipses along the path
LONGEST = 0.12  # m, half an axis of what stands for stiffness
START, OBJECT = planar.FRAME_COLOURS  # the first and the second frame


def frame(place: ArrayLike, angle: float) -> Frame:
    """A frame over [time, x, y], at a place (2,), m, turned by an angle, rad."""
    c, s = np.cos(angle), np.sin(angle)
    return Frame(np.array([[c, -s], [s, c]]), np.asarray(place, dtype=float)).with_time()


def reach(rng: np.random.Generator) -> Demonstration:
    """One reach, in a situation of its own: a cubic Bezier curve, whose tangents at both ends are the frames' axes."""
    frames = {
        START: frame(rng.uniform(-0.1, 0.1, 2), rng.uniform(-0.5, 0.5)),
        OBJECT: frame([1.0, 0.3] + rng.uniform(-0.2, 0.2, 2), rng.uniform(-0.6, 0.6)),
    }
    start, goal = (f.b[1:] for f in frames.values())
    ahead, behind = (f.A[1:, 1] for f in frames.values())
    u = np.linspace(0.0, 1.0, 100)[:, None]
    s = u**3 * (10.0 - 15.0 * u + 6.0 * u**2)
    path = (1.0 - s) ** 3 * start + 3.0 * s * (1.0 - s) ** 2 * (start + 0.4 * ahead)
    path = path + 3.0 * s**2 * (1.0 - s) * (goal - 0.4 * behind) + s**3 * goal
    # in the middle everybody goes where he likes
    path = path + (4.0 * s * (1.0 - s)) ** 4 * rng.normal(scale=0.08, size=2) + 0.002 * rng.normal(size=path.shape)
    return Demonstration(DURATION * u[:, 0], np.column_stack([DURATION * u, path]), frames)


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the program; returns its exit status."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--output", type=Path, default=Path("out/figures"), help="of figure1d.json and figure1d.png")
    parser.add_argument("--seed", type=int, default=0, help="of the demonstrations (default: %(default)s)")
    options = parser.parse_args(arguments)
    rng = np.random.default_rng(options.seed)
    demonstrations = [reach(rng) for _ in range(8)]
    model = TPGMM(5, init="time", reg_covar=1e-5).fit(demonstrations)
    situation = {START: frame([0.0, -0.05], 0.4), OBJECT: frame([1.1, 0.4], -0.5)}
    times = np.linspace(0.0, DURATION, 200)
    path = RegressThenProduct(model).retrieve(situation, times)
    means, covariances = np.stack([g.mean for g in path]), np.stack([g.covariance for g in path])
    stiffness = double_integrator_gains(np.linalg.inv(covariances), CONTROL_COST).stiffness

    write_report("figure1d", rows(times, means, covariances, stiffness), options.output)
    figure = Figure(figsize=(15.0, 4.6), layout="constrained")
    FigureCanvasAgg(figure)
    shown, variable, stiff = figure.subplots(1, 3)
    for d in demonstrations:
        shown.plot(d.data[:, 1], d.data[:, 2], color="0.25", lw=1.2)
        draw_axes(shown, d.frames, 0.5)
    planar.tidy(shown, f"{len(demonstrations)} demonstrations, each in a situation of its own")
    firmest = np.linalg.eigvalsh(stiffness)[:, -1].max()
    half_axes = LONGEST / firmest * stiffness
    ellipses = {variable: (covariances, "#d95f02"), stiff: (half_axes @ half_axes, "#7570b3")}
    for axes, (matrices, colour) in ellipses.items():
        for t in np.linspace(0, len(times) - 1, SHOWN).astype(int):
            planar.draw_ellipse(axes, means[t], matrices[t], colour, 0.3)
        axes.plot(*means.T, color="black", lw=2.0)
        draw_axes(axes, situation)
    push = 1.0 / np.sqrt(CONTROL_COST)
    planar.tidy(variable, f"a new situation: standard deviation,\nand where a push of {push:.0f} m/s² moves the hand")
    planar.tidy(stiff, f"its stiffness: up to {firmest:.0f} 1/s²")
    figure.savefig(options.output / "figure1d.png", dpi=110)
    print(f"picture: {options.output / 'figure1d.png'}")
    return 0


def rows(times: Array, means: Array, covariances: Array, stiffness: Array) -> list[Row]:
    """Along and across the path, at the start, in the middle and at the end."""
    result: list[Row] = []
    for place, t in (("start", 4), ("middle", len(times) // 2), ("end", len(times) - 5)):
        along = means[t + 4] - means[t - 4]
        along /= np.linalg.norm(along)
        across = np.array([-along[1], along[0]])
        result.append(
            {
                "place": place,
                "time_s": float(times[t]),
                "deviation_across_m": float(np.sqrt(across @ covariances[t] @ across)),
                "stiffness_along_per_s2": float(along @ stiffness[t] @ along),
                "stiffness_across_per_s2": float(across @ stiffness[t] @ across),
            }
        )
    return result


def draw_axes(axes: Axes, frames: Mapping[str, Frame], alpha: float = 1.0) -> None:
    """Each frame as a dot and its axis, in its colour."""
    for name, one in frames.items():
        origin, tip = one.b[1:], one.b[1:] + 0.12 * one.A[1:, 1]
        axes.plot(*np.stack([origin, tip]).T, color=planar.FRAME_COLOURS[name], lw=3.0, alpha=alpha)
        axes.plot(*origin, "o", color=planar.FRAME_COLOURS[name], ms=7, alpha=alpha)


if __name__ == "__main__":
    sys.exit(main())
