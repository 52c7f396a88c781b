# SPDX-License-Identifier: Apache-2.0
"""Figure 1 of the paper: from demonstrations to a controller, in four steps.

(a) Somebody shows a movement out of one box and into another, which is in a different place each time.
(b) A model describes the movement as each box sees it.
(c) In a new situation both boxes say what they expect. Where they disagree, the one that is surer decides.
(d) A controller is stiff where the demonstrations agreed, and soft where they did not.

Ellipses are one standard deviation; in (d) they are stiffness.
"""

from __future__ import annotations

import sys
from collections.abc import Sequence

import numpy as np
from matplotlib.figure import Figure

from examples import planar
from examples.claims import at_least, at_most, canvas, finish, options_of
from tpgmm_core import TPGMM, Demonstration, Gaussian
from tpgmm_core.common.report import Row
from tpgmm_core.common.types import Array
from tpgmm_core.lqr.double_integrator import Gains, double_integrator_gains
from tpgmm_core.retrieval.regression import RegressThenProduct

CONTROL_COST = 1e-3  # of an acceleration, beside the precision in 1/m²
PUSH = np.array([0.0, 40.0])  # m/s²
STEP = 1e-3  # s, of the simulated hand


def pushed(means: Array, gains: Gains, times: Array) -> Array:
    """Path (T, 2) of a hand that follows the means (T, 2) and is pushed all the time."""
    velocities = np.gradient(means, times, axis=0)
    accelerations = np.gradient(velocities, times, axis=0)
    x, v, path = means[0], velocities[0], []
    for t, reference in enumerate(means):
        for _ in range(round((times[1] - times[0]) / STEP)):
            u = accelerations[t] + gains.stiffness[t] @ (reference - x) + gains.damping[t] @ (velocities[t] - v)
            v = v + STEP * (u + PUSH)
            x = x + STEP * v
        path.append(x)
    return np.stack(path)


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the program; returns its exit status."""
    options = options_of(__doc__, "figure1").parse_args(arguments)
    shown = planar.demonstrations()
    new = planar.situation(0.67)

    # (b) each component has a mean and a covariance in each frame
    model = planar.learned(shown)

    # (c) Eqs. (5) and (6): what each frame expects, and the product of both
    expected = {
        name: [
            Gaussian(model.means_[name][k], model.covariances_[name][k]).transform(frame)
            for k in range(planar.COMPONENTS)
        ]
        for name, frame in new.items()
    }
    products = [Gaussian.product(several) for several in zip(*expected.values(), strict=True)]
    # ... and the movement: the Gaussian of the position at each time
    times = np.linspace(0.0, planar.DURATION, 201)
    movement = RegressThenProduct(model).retrieve(new, times)
    means = np.stack([gaussian.mean for gaussian in movement])

    # (d) the controller that loses least by following that movement
    gains = double_integrator_gains(np.stack([gaussian.precision for gaussian in movement]), CONTROL_COST)
    path = pushed(means, gains, times)

    figure = draw(shown, model, expected, products, means, gains, path)
    return finish("figure1", figure, claims(shown, model, expected, products, means, gains, path), options.output)


def draw(
    shown: Sequence[Demonstration], model: TPGMM, expected: dict[str, list[Gaussian]], products: list[Gaussian],
    means: Array, gains: Gains, path: Array,
) -> Figure:  # fmt: skip
    """The four panels."""
    figure = canvas(12.0, 10.0)
    rows = figure.subfigures(2, 1, squeeze=False)[:, 0]
    a, *views = rows[0].subplots(1, 3, width_ratios=[2.0, 1.0, 1.0])
    c, d = rows[1].subplots(1, 2)
    new = planar.situation(0.67)

    planar.draw_demonstrations(a, shown)
    planar.draw_boxes(a, {"second": new["second"]}, lw=2.0, ls=":")
    a.annotate("?", new["second"].b[planar.POSITION], ha="center", va="center", fontsize=16)
    planar.tidy(a, f"(a) {len(shown)} demonstrations, and a new situation")

    titles = "(b) seen from the first box", "and from the second"
    for axes, name, title in zip(views, planar.FRAME_COLOURS, titles, strict=True):
        for demonstration in shown:
            axes.plot(*demonstration.projected()[name][:, planar.POSITION].T, color="0.25", lw=1.0)
        inside = [Gaussian(m, S) for m, S in zip(model.means_[name], model.covariances_[name], strict=True)]
        planar.draw_gaussians(axes, inside, 0.35)
        planar.draw_boxes(axes, {name: planar.box(0.0, 0.0, 0.0)})
        planar.tidy(axes, title)

    for name, gaussians in expected.items():
        planar.draw_gaussians(c, gaussians, 0.12, planar.FRAME_COLOURS[name])
    planar.draw_gaussians(c, products, 0.6)
    planar.tidy(c, "(c) what each box expects (pale), the products, and the movement")

    # an ellipse of the stiffness, how hard the hand is pulled back, in each direction
    longest = np.linalg.eigvalsh(gains.stiffness)[:, -1].max()
    for t in np.linspace(0, len(means) - 1, 15).astype(int):
        half_axes = 0.12 / longest * gains.stiffness[t]
        planar.draw_ellipse(d, means[t], half_axes @ half_axes, "#7570b3", 0.3)
    d.plot(*path.T, color="#d95f02", lw=2.0, ls="--", label=f"pushed upwards by {PUSH[1]:g} m/s² all the time")
    d.legend(loc="lower center", frameon=False)
    planar.tidy(d, f"(d) stiffness, at most {longest:.0f} 1/s²")
    for axes in (c, d):
        axes.plot(*means.T, color="black", lw=2.5)
        planar.draw_boxes(axes, new)
    return figure


def claims(
    shown: Sequence[Demonstration], model: TPGMM, expected: dict[str, list[Gaussian]], products: list[Gaussian],
    means: Array, gains: Gains, path: Array,
) -> list[Row]:  # fmt: skip
    """What the panels must show."""

    def spread(covariance: Array) -> float:
        return float(np.sqrt(np.trace(covariance[1:, 1:])))

    first, second = (model.covariances_[name] for name in planar.FRAME_COLOURS)
    surest = [
        min(spread(one.covariance), spread(other.covariance)) for one, other in zip(*expected.values(), strict=True)
    ]
    goal = planar.situation(0.67)["second"].b[planar.POSITION]
    away = np.linalg.norm(path - means, axis=1)
    stiffest = np.linalg.eigvalsh(gains.stiffness)[:, -1]
    middle = len(means) // 2
    return [
        at_least("(b) seen from the first box: spread at the end / the start", spread(first[-1]) / spread(first[0]), 3),
        at_least("(b) from the second: spread at the start / the end", spread(second[0]) / spread(second[-1]), 3),
        at_most(
            "(c) spread of the products / of the surer frame, at most",
            max(spread(product.covariance) / sure for product, sure in zip(products, surest, strict=True)),
            1,
        ),
        at_most("(c) distance of the end from the second box, m", np.linalg.norm(means[-1] - goal), 0.05),
        at_least("(c) the same without frames, m", np.linalg.norm(planar.end_without_frames(shown) - goal), 0.2),
        at_least("(d) stiffness at the end / in the middle", stiffest[-1] / stiffest[middle], 3),
        at_least("(d) a push moves the hand in the middle / at the end", away[middle] / away[-1], 3),
    ]  # fmt: skip


if __name__ == "__main__":
    sys.exit(main())
