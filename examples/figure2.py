# SPDX-License-Identifier: Apache-2.0
"""Figure 2 of the paper: the minimum of Eq. (3) is a product of Gaussians.

One of the Gaussians of figure 1, in its new situation. Each box expects the hand within its own Gaussian; Eq. (3) adds
up how far a point is from what both expect, in units of how exactly they expect it. The grey lines are its contours.
Its minimum is the center of the product of both Gaussians, and half its curvature is the inverse of the product's
covariance. Ellipses are one standard deviation.
"""

from __future__ import annotations

import sys
from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import ArrayLike
from scipy.optimize import minimize

from examples import planar
from examples.claims import at_least, at_most, canvas, finish, options_of
from tpgmm_core import Gaussian
from tpgmm_core.common.report import Row
from tpgmm_core.common.types import Array

COMPONENT = 2  # the one in the middle of the movement


def objective(x: ArrayLike, terms: Sequence[Gaussian]) -> Array:
    """Eq. (3) at points x (..., 2), written out."""
    errors = [np.asarray(x) - term.mean for term in terms]
    weights = [np.linalg.inv(term.covariance) for term in terms]
    return np.sum([np.einsum("...i,ij,...j", e, W, e) for e, W in zip(errors, weights, strict=True)], axis=0)


def curvature(x: Array, terms: Sequence[Gaussian], h: float = 1e-3) -> Array:
    """Second derivatives (2, 2) of the objective, by differences, which are exact for a quadratic function."""
    e = h * np.eye(2)
    corners = np.array([[objective(x + s * a + t * b, terms) for s, t in ((1, 1), (-1, 1), (1, -1), (-1, -1))]
                        for a in e for b in e])  # fmt: skip
    return np.asarray((corners @ [1, -1, -1, 1]).reshape(2, 2) / (4.0 * h * h))


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the program; returns its exit status."""
    options = options_of(__doc__, "figure2").parse_args(arguments)
    model, frames = planar.learned(planar.demonstrations()), planar.situation(0.67)
    # Eqs. (1) and (2): what the boxes expect of the position, seen from the world
    terms = [
        Gaussian(model.means_[name][COMPONENT], model.covariances_[name][COMPONENT])
        .transform(frame)
        .marginal(planar.POSITION)
        for name, frame in frames.items()
    ]
    product = Gaussian.product(terms)
    # the same without any knowledge of Gaussians: walk downhill on Eq. (3) from between the two centers
    middle = (terms[0].mean + terms[1].mean) / 2.0
    least = minimize(objective, middle, args=(terms,), method="Nelder-Mead", options={"xatol": 1e-9, "fatol": 1e-12})
    rows: list[Row] = [
        at_most("product's mean from where Eq. (3) is least, m", np.linalg.norm(product.mean - least.x), 1e-6),
        at_most(
            "product's covariance times half the curvature of Eq. (3), less 1",
            np.abs(product.covariance @ curvature(product.mean, terms) / 2.0 - np.eye(2)).max(),
            1e-6,
        ),
        at_least("Eq. (3) between the two centers / at the product", objective(middle, terms) / least.fun, 1.5),
    ]  # fmt: skip
    return finish("figure2", draw(terms, product), rows, options.output)


def draw(terms: Sequence[Gaussian], product: Gaussian) -> Figure:
    """Both Gaussians, their product, and the contours of Eq. (3)."""
    figure = canvas(7.0, 5.9)
    axes = figure.subplots()
    centers = [term.mean for term in terms]
    lower, upper = np.min(centers, axis=0) - 0.35, np.max(centers, axis=0) + 0.35
    x, y = np.meshgrid(np.linspace(lower[0], upper[0], 200), np.linspace(lower[1], upper[1], 200))
    cost = objective(np.stack([x, y], axis=-1), terms)
    lowest = float(cost.min())
    axes.contour(x, y, cost, levels=lowest + np.array([1.0, 4.0, 9.0, 16.0, 36.0, 64.0]), colors="0.75", linewidths=1.0)
    planar.draw_ellipse(axes, product.mean, product.covariance, "#1b9e77", 0.6)
    for j, (term, (name, colour)) in enumerate(zip(terms, planar.FRAME_COLOURS.items(), strict=True), 1):
        planar.draw_ellipse(axes, term.mean, term.covariance, colour, 0.25)
        axes.plot(*np.stack([term.mean, product.mean]).T, color=colour, ls=":", lw=1.5)
        axes.plot(*term.mean, "o", color=colour, label=f"expected by the {name} box")
        name_of(axes, term, rf"^{{({j})}}", colour, 9)
    axes.plot(*product.mean, "o", color="black", label="product, and minimum of Eq. (3)")
    name_of(axes, product, "", "black", -20)
    axes.plot([], [], color="0.75", label="contours of Eq. (3)")
    axes.legend(loc="upper right", framealpha=0.9)
    axes.set(xticks=[], yticks=[], aspect="equal")
    axes.set(xlim=(lower[0] + 0.15, upper[0] - 0.15), ylim=(lower[1] + 0.15, upper[1] - 0.15))
    return figure


def name_of(axes: Axes, gaussian: Gaussian, index: str, colour: str, above: float) -> None:
    """Write above a Gaussian's mean, by some points, what the paper calls it."""
    text = rf"$\mathcal{{N}}(\hat{{\xi}}_t{index},\ \hat{{\Sigma}}_t{index})$"
    place = float(gaussian.mean[0]), float(gaussian.mean[1])
    axes.annotate(
        text,
        place,
        xytext=(0, above),
        textcoords="offset points",
        ha="center",
        color=colour,
        fontsize=11,
        bbox={"boxstyle": "round,pad=0.1", "facecolor": "white", "edgecolor": "none", "alpha": 0.7},
    )


if __name__ == "__main__":
    sys.exit(main())
