# SPDX-License-Identifier: Apache-2.0
"""Figure 4 of the paper: factor analyzers span the covariances from diagonal to full.

Above, three-dimensional samples along a bent path, with the components' ellipsoids of two standard deviations;
below, the correlations of one component of a coordinated movement of ten joints, seen from one frame. From left to
right the structures have more and more parameters.
"""

from __future__ import annotations

import argparse
import os
import sys
from collections.abc import Sequence
from pathlib import Path

os.environ.update(OMP_NUM_THREADS="1", OPENBLAS_NUM_THREADS="1")  # before numpy is imported

import numpy as np  # noqa: E402
from matplotlib.axes import Axes  # noqa: E402
from matplotlib.backends.backend_agg import FigureCanvasAgg  # noqa: E402
from matplotlib.figure import Figure  # noqa: E402
from mpl_toolkits.mplot3d import Axes3D  # noqa: E402

from examples.report import write_report  # noqa: E402
from tpgmm_core import TPGMM  # noqa: E402
from tpgmm_core.common.report import Row  # noqa: E402
from tpgmm_core.common.types import Array  # noqa: E402
from tpgmm_core.learning.estimation.initialization import Labels  # noqa: E402

COLOURS = ("#d95f02", "#1b9e77", "#7570b3")
SPATIAL = {"diagonal": ("diag", 1), "factors d = 1": ("mfa", 1), "full": ("full", 1)}
JOINTS = {
    "diagonal": ("diag", 1),
    "factors d = 1": ("mfa", 1),
    "factors d = 2": ("mfa", 2),
    "factors d = 4": ("mfa", 4),
    "full": ("full", 1),
}


def bent_path(rng: np.random.Generator) -> tuple[Array, Labels]:
    """Samples (N, 3) along three straight pieces, with noise in a different plane for each, and the piece (N,)."""
    corners = np.array([[0.0, 0.0, 0.0], [1.0, 0.8, 0.2], [1.8, 0.2, 1.0], [2.8, 1.0, 0.6]])
    piece = np.repeat(np.arange(3), 150)
    along = rng.uniform(0.1, 0.9, size=(len(piece), 1))
    across = rng.normal(size=(3, 3))
    noise = 0.12 * rng.normal(size=(len(piece), 1)) * (across / np.linalg.norm(across, axis=1, keepdims=True))[piece]
    points = corners[piece] + along * (corners[piece + 1] - corners[piece]) + noise
    return points + 0.03 * rng.normal(size=points.shape), piece


def joints(rng: np.random.Generator) -> tuple[Array, Labels]:
    """Angles (N, 10) that four synergies move, each of its own strength, in two phases, and the phase (N,)."""
    phase = np.repeat(np.arange(2), 120)
    synergies = rng.normal(size=(2, 10, 4)) * np.array([1.0, 0.7, 0.45, 0.3])
    moves = np.einsum("nij,nj->ni", synergies[phase], rng.normal(size=(len(phase), 4)))
    noise = rng.uniform(0.15, 0.5, size=10) * rng.normal(size=moves.shape)
    return 3.0 * phase[:, None] + moves + noise, phase


def ellipsoid(axes: Axes3D, mean: Array, covariance: Array, colour: str) -> None:
    """Surface of two standard deviations."""
    u, v = np.meshgrid(np.linspace(0.0, 2.0 * np.pi, 40), np.linspace(0.0, np.pi, 20))
    sphere = np.stack([np.cos(u) * np.sin(v), np.sin(u) * np.sin(v), np.cos(v)], axis=-1)
    x, y, z = np.moveaxis(mean + 2.0 * sphere @ np.linalg.cholesky(covariance).T, -1, 0)
    axes.plot_surface(x, y, z, color=colour, alpha=0.35, linewidth=0)


def learned(X: Array, labels: Labels, structure: tuple[str, int]) -> TPGMM:
    """One frame is enough for the picture; all frames have the same structure."""
    covariance, n_factors = structure
    return TPGMM(
        int(labels.max()) + 1, init=labels, covariance=covariance, n_factors=n_factors, reg_covar=1e-4, max_iter=500
    ).fit_projected({"world": X})


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the program; returns its exit status."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--output", type=Path, default=Path("out/figure4"), help="of report.json, figure4.png")
    parser.add_argument("--seed", type=int, default=1, help="of the samples (default: %(default)s)")
    options = parser.parse_args(arguments)
    rng = np.random.default_rng(options.seed)
    figure = Figure(figsize=(15.0, 8.0), layout="constrained")
    FigureCanvasAgg(figure)
    above, below = figure.subfigures(2, 1, height_ratios=[1.5, 1.0], squeeze=False)[:, 0]
    rows: list[Row] = []

    points, piece = bent_path(rng)
    for i, (title, structure) in enumerate(SPATIAL.items()):
        model = learned(points, piece, structure)
        axes = above.add_subplot(1, len(SPATIAL), i + 1, projection="3d")
        assert isinstance(axes, Axes3D)
        axes.scatter(*points.T, s=3, c=[COLOURS[k] for k in piece], alpha=0.6)
        for k, colour in enumerate(COLOURS):
            ellipsoid(axes, model.means_["world"][k], model.covariances_["world"][k], colour)
        axes.set_box_aspect(None, zoom=1.25)
        axes.view_init(elev=30, azim=-70)
        axes.tick_params(labelsize=7)
        rows.append(_described(axes, title, "path", model))

    angles, phase = joints(rng)
    for i, (title, structure) in enumerate(JOINTS.items()):
        model = learned(angles, phase, structure)
        covariance = model.covariances_["world"][0]
        deviations = np.sqrt(np.diagonal(covariance))
        panel = below.add_subplot(1, len(JOINTS), i + 1)
        image = panel.imshow(covariance / np.outer(deviations, deviations), cmap="RdBu_r", vmin=-1.0, vmax=1.0)
        panel.set_xticks([])
        panel.set_yticks([])
        rows.append(_described(panel, title, "joints", model))
    below.colorbar(image, ax=below.axes, shrink=0.8, label="correlation")

    write_report("report", rows, options.output)
    figure.savefig(options.output / "figure4.png", dpi=120)
    print(f"picture: {options.output / 'figure4.png'}")
    return 0


def _described(axes: Axes, title: str, data: str, model: TPGMM) -> Row:
    axes.set_title(
        f"{title}\n{model.n_parameters_} parameters, log-likelihood {model.log_likelihood_:.2f}", fontsize=10
    )
    return {
        "data": data,
        "structure": title,
        "n_parameters": model.n_parameters_,
        "log_likelihood": model.log_likelihood_,
        "passed": bool(np.isfinite(model.log_likelihood_)),
    }


if __name__ == "__main__":
    sys.exit(main())
