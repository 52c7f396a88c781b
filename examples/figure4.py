# SPDX-License-Identifier: Apache-2.0
"""Figure 4 of the paper: factor analyzers span the covariances from diagonal to full.

Above, samples along a bent path in space, and a component for each of its pieces (ellipsoids of two standard
deviations). A diagonal covariance cannot turn to where the path goes; one factor already can.

Below, thirty joints that four synergies move: the correlations of one component. Four factors say as much about other
samples of the same movement as a full covariance, or more, with far fewer parameters. From left to right the
structures have more and more of them.
"""

from __future__ import annotations

import sys
from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import SubFigure
from mpl_toolkits.mplot3d import Axes3D

from examples.claims import at_least, at_most, canvas, finish, options_of
from tpgmm_core import TPGMM, Frame
from tpgmm_core.common.report import Row
from tpgmm_core.common.types import Array
from tpgmm_core.learning.estimation.initialization import Labels

COLOURS = ("#d95f02", "#1b9e77", "#7570b3")
CORNERS = np.array([[0.0, 0.0, 0.0], [1.0, 0.8, 0.2], [1.8, 0.2, 1.0], [2.8, 1.0, 0.6]])
JOINTS, SYNERGIES = 30, 4
#: Title → structure and number of factors
IN_SPACE = {"diagonal": ("diag", 1), "factors d = 1": ("mfa", 1), "full": ("full", 1)}
IN_JOINTS = {
    "diagonal": ("diag", 1),
    "factors d = 1": ("mfa", 1),
    "factors d = 2": ("mfa", 2),
    "factors d = 4": ("mfa", 4),
    "full": ("full", 1),
}


def bent_path(rng: np.random.Generator) -> tuple[Array, Labels]:
    """Samples (N, 3) along three straight pieces, with noise in a different plane for each, and the piece (N,)."""
    piece = np.repeat(np.arange(3), 150)
    along = rng.uniform(0.1, 0.9, size=(len(piece), 1))
    across = rng.normal(size=(3, 3))
    noise = 0.12 * rng.normal(size=(len(piece), 1)) * (across / np.linalg.norm(across, axis=1, keepdims=True))[piece]
    points = CORNERS[piece] + along * (CORNERS[piece + 1] - CORNERS[piece]) + noise
    return points + 0.03 * rng.normal(size=points.shape), piece


def joints(rng: np.random.Generator) -> tuple[Array, Labels]:
    """Angles (N, 30) that four synergies move, each of its own strength, in two phases, and the phase (N,)."""
    phase = np.tile(np.arange(2), 240)
    synergies = rng.normal(size=(2, JOINTS, SYNERGIES)) * np.array([1.0, 0.7, 0.45, 0.3])
    moves = np.einsum("nij,nj->ni", synergies[phase], rng.normal(size=(len(phase), SYNERGIES)))
    noise = rng.uniform(0.15, 0.5, size=JOINTS) * rng.normal(size=moves.shape)
    return 3.0 * phase[:, None] + moves + noise, phase


def learned(X: Array, labels: Labels, structure: tuple[str, int]) -> TPGMM:
    """One frame is enough for the picture; all frames have the same structure."""
    covariance, n_factors = structure
    return TPGMM(
        int(labels.max()) + 1, init=labels, covariance=covariance, n_factors=n_factors, reg_covar=1e-4, max_iter=500
    ).fit_projected({"world": X})


def likelihood(model: TPGMM, X: Array) -> float:
    """Mean log-likelihood of samples (N, D)."""
    D = X.shape[1]
    return float(model.adapt({"world": Frame(np.eye(D), np.zeros(D))}).log_density(X).mean())


def turned_away(model: TPGMM) -> float:
    """The largest angle between the long axis of a component and its piece of the path, degrees."""
    longest = np.linalg.eigh(model.covariances_["world"])[1][:, :, -1]
    pieces = np.diff(CORNERS, axis=0)
    cosines = np.abs(np.sum(longest * pieces, axis=1)) / np.linalg.norm(pieces, axis=1)
    return float(np.degrees(np.arccos(cosines.min())))


def draw_path(figure: SubFigure, models: dict[str, TPGMM], points: Array, piece: Labels) -> None:
    """The samples, and the components' ellipsoids of two standard deviations."""
    u, v = np.meshgrid(np.linspace(0.0, 2.0 * np.pi, 40), np.linspace(0.0, np.pi, 20))
    sphere = np.stack([np.cos(u) * np.sin(v), np.sin(u) * np.sin(v), np.cos(v)], axis=-1)
    for i, (title, model) in enumerate(models.items()):
        axes = figure.add_subplot(1, len(models), i + 1, projection="3d")
        assert isinstance(axes, Axes3D)
        axes.scatter(*points.T, s=3, c=[COLOURS[k] for k in piece], alpha=0.6)
        for mean, S, colour in zip(model.means_["world"], model.covariances_["world"], COLOURS, strict=True):
            surface = mean + 2.0 * sphere @ np.linalg.cholesky(S).T
            axes.plot_surface(*np.moveaxis(surface, -1, 0), color=colour, alpha=0.35, linewidth=0)
        axes.set_box_aspect(None, zoom=1.1)
        axes.view_init(elev=30, azim=-70)
        axes.tick_params(labelsize=7)
        describe(axes, title, model, y=0.98)


def draw_joints(figure: SubFigure, models: dict[str, TPGMM]) -> None:
    """Correlations between the joints, of the first component."""
    panels = figure.subplots(1, len(models))
    for axes, (title, model) in zip(panels, models.items(), strict=True):
        covariance = model.covariances_["world"][0]
        deviations = np.sqrt(np.diagonal(covariance))
        image = axes.imshow(covariance / np.outer(deviations, deviations), cmap="RdBu_r", vmin=-1.0, vmax=1.0)
        axes.set(xticks=[], yticks=[])
        describe(axes, title, model)
    figure.colorbar(image, ax=panels, shrink=0.8, label="correlation")


def describe(axes: Axes, title: str, model: TPGMM, y: float | None = None) -> None:
    """What the structure costs."""
    axes.set_title(f"{title}\n{model.n_parameters_} parameters", fontsize=11, y=y)


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the program; returns its exit status."""
    options = options_of(__doc__, "figure4").parse_args(arguments)
    rng = np.random.default_rng(1)
    points, piece = bent_path(rng)
    in_space = {title: learned(points, piece, structure) for title, structure in IN_SPACE.items()}
    angles, phase = joints(rng)
    half = len(angles) // 2  # the other half is kept for the question how likely it is
    in_joints = {title: learned(angles[:half], phase[:half], structure) for title, structure in IN_JOINTS.items()}
    figure = canvas(15.0, 8.5)
    above, below = figure.subfigures(2, 1, height_ratios=[1.5, 1.0], squeeze=False)[:, 0]
    draw_path(above, in_space, points, piece)
    draw_joints(below, in_joints)
    return finish("figure4", figure, claims(in_space, in_joints, angles[half:]), options.output)


def claims(in_space: dict[str, TPGMM], in_joints: dict[str, TPGMM], unseen: Array) -> list[Row]:
    """What the panels must show."""
    diagonal, *_, four, full = (likelihood(model, unseen) for model in in_joints.values())
    sizes = [model.n_parameters_ for model in in_joints.values()]
    fitted = [model.log_likelihood_ for model in in_joints.values()]
    away = [turned_away(model) for model in in_space.values()]
    return [
        at_least("diagonal: a component's long axis from its piece of the path, deg", away[0], 20),
        at_most("one factor: the same, deg", away[1], 10),
        at_most("full: the same, deg", away[2], 10),
        at_least("joints: parameters from a structure to the next", float(np.diff(sizes).min()), 1),
        at_least("joints: log-likelihood from a structure to the next", np.diff(fitted).min(), 0),
        at_most("joints: parameters with four factors / full", sizes[-2] / sizes[-1], 0.4),
        at_least("joints, other samples: log-likelihood of four factors - diagonal", four - diagonal, 5),
        at_least("joints, other samples: log-likelihood of four factors - full", four - full, 0),
    ]  # fmt: skip


if __name__ == "__main__":
    sys.exit(main())
