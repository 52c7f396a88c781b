# SPDX-License-Identifier: Apache-2.0
"""Figure 1 of the paper: demonstrations in several situations, the model seen from each frame, a new situation.

With pbdlib's planar data. Ellipses are one standard deviation.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from examples import planar
from examples.report import write_report
from tpgmm_core import TPGMM, Gaussian
from tpgmm_core.common.report import Row
from tpgmm_core.retrieval.regression import AdaptThenRegress, RegressThenProduct

POSITION = [1, 2]


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the program; returns its exit status."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--data", type=Path, default=planar.DATA, help="pbdlib's data (default: %(default)s)")
    parser.add_argument("--output", type=Path, default=Path("out/figures"), help="of figure1.json, figure1.png")
    parser.add_argument("--components", type=int, default=3, help="of the model (default: %(default)s)")
    options = parser.parse_args(arguments)
    try:
        demonstrations = planar.demonstrations(options.data)
    except FileNotFoundError as error:
        print(f"figure 1 left out: {error}")
        return 0
    model = TPGMM(options.components, init="time", reg_covar=1e-4).fit(demonstrations)
    figure = Figure(figsize=(17.0, 5.0), layout="constrained")
    FigureCanvasAgg(figure)
    shown, *views, new = figure.subplots(1, 4, width_ratios=[1.3, 0.9, 0.9, 1.3])

    for d in demonstrations:
        shown.plot(d.data[:, 1], d.data[:, 2], color="0.25", lw=1.5)
        planar.draw_frames(shown, d.frames, 0.6)
    planar.tidy(shown, f"(a) {len(demonstrations)} demonstrations, each in a situation of its own")

    for axes, name, letter in zip(views, planar.FRAME_COLOURS, "bc", strict=True):
        for d in demonstrations:
            seen = d.projected()[name]
            axes.plot(seen[:, 1], seen[:, 2], color="0.25", lw=1.0)
        for k in range(options.components):
            g = Gaussian(model.means_[name][k], model.covariances_[name][k]).marginal(POSITION)
            planar.draw_ellipse(axes, g.mean, g.covariance, planar.COLOURS[k % len(planar.COLOURS)])
        axes.plot(0.0, 0.0, "+", ms=14, mew=3, color=planar.FRAME_COLOURS[name])
        planar.tidy(axes, f"({letter}) as seen from the {name} frame")

    situation = {
        "first": demonstrations[0].frames["first"],
        "second": planar.between(demonstrations[2].frames["second"], demonstrations[3].frames["second"], 0.5),
    }
    mixture = model.adapt(situation)
    for name, frame in situation.items():
        for k in range(options.components):
            g = Gaussian(model.means_[name][k], model.covariances_[name][k]).transform(frame).marginal(POSITION)
            planar.draw_ellipse(new, g.mean, g.covariance, planar.FRAME_COLOURS[name], 0.1)
    for k in range(options.components):
        g = mixture.component(k).marginal(POSITION)
        planar.draw_ellipse(new, g.mean, g.covariance, planar.COLOURS[k % len(planar.COLOURS)], 0.5)
    times = np.linspace(demonstrations[0].times[0], demonstrations[0].times[-1], 200)
    paths = {
        "adapted, then regression": AdaptThenRegress(model).retrieve(situation, times),
        "regression, then product": RegressThenProduct(model).retrieve(situation, times),
    }
    rows: list[Row] = []
    for (label, path), style in zip(paths.items(), ("-", "--"), strict=True):
        means = np.stack([g.mean for g in path])
        new.plot(*means.T, style, color="black", lw=2.5 if style == "-" else 1.5, label=label)
        rows.append({"order": label, **planar.judged_end(demonstrations, situation["second"], means[-1])})
    planar.draw_frames(new, situation)
    new.legend(fontsize=8, frameon=False, loc="upper left")
    planar.tidy(new, "(d) a new situation: what each frame expects (pale),\ntheir products, and the reproduction")

    print(f"figure 1: {options.components} components, {model.n_iter_} iterations of EM")
    write_report("figure1", rows, options.output)
    figure.savefig(options.output / "figure1.png", dpi=110)
    print(f"picture: {options.output / 'figure1.png'}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
