# SPDX-License-Identifier: Apache-2.0
"""Figure 3 of the paper: reproductions in the demonstrated situations, and in new ones farther and farther away.

With pbdlib's planar data. The second frame goes on along the way on which the demonstrations had it, and turns on by
its angle; once the first frame, which never moved in the demonstrations, moves and turns too. Ellipses and bands
are one standard deviation; solid: adapted, then regression; dashed: regression in each frame, then the product.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from examples import planar
from examples.report import write_report
from tpgmm_core import TPGMM, Demonstration, Frame
from tpgmm_core.common.report import Row
from tpgmm_core.retrieval.regression import AdaptThenRegress, RegressThenProduct


def situations(demonstrations: Sequence[Demonstration]) -> dict[str, dict[str, Frame]]:
    """The demonstrated situations, then new ones of growing distance, by title."""
    found = {f"demonstration {i + 1}": dict(d.frames) for i, d in enumerate(demonstrations)}
    first = demonstrations[0].frames["first"]
    seconds = [d.frames["second"] for d in demonstrations]
    middle = planar.between(seconds[1], seconds[2], 0.5)
    c, s = np.cos(np.radians(50.0)), np.sin(np.radians(50.0))
    turned = Frame(np.array([[c, -s], [s, c]]) @ first.A[1:, 1:], first.b[1:] + np.array([-0.8, 0.6])).with_time()
    for title, start, factor in (
        ("between demonstrations", first, 0.67),
        ("2 × the demonstrated range", first, 2.0),
        ("2 ×, and the first frame moved and turned", turned, 2.0),
        ("4 × the demonstrated range", first, 4.0),
    ):
        found[title] = {"first": start, "second": planar.between(middle, seconds[3], factor)}
    return found


def draw(
    axes: Axes, title: str, model: TPGMM, demonstrations: Sequence[Demonstration], new: Mapping[str, Frame]
) -> Row:
    """One reproduction over the demonstrations; returns what the table says of it."""
    for d in demonstrations:
        axes.plot(d.data[:, 1], d.data[:, 2], color="0.6", lw=1.0, zorder=1)
        planar.draw_frames(axes, d.frames, 0.12)
    mixture = model.adapt(new)
    for k in range(len(mixture.priors)):
        g = mixture.component(k).marginal([1, 2])
        planar.draw_ellipse(axes, g.mean, g.covariance, planar.COLOURS[k % len(planar.COLOURS)], 0.35)
    times = np.linspace(demonstrations[0].times[0], demonstrations[0].times[-1], 200)
    path = AdaptThenRegress(model).retrieve(new, times)
    means = np.stack([g.mean for g in path])
    planar.draw_band(axes, means, np.stack([g.covariance for g in path]))
    axes.plot(*means.T, color="black", lw=2.5)
    other = np.stack([g.mean for g in RegressThenProduct(model).retrieve(new, times)])
    axes.plot(*other.T, "--", color="black", lw=1.2)
    planar.draw_frames(axes, new)
    planar.tidy(axes, title)
    distance = max(min(float(np.linalg.norm(new[n].b - d.frames[n].b)) for d in demonstrations) for n in new)
    return {
        "situation": title,
        "frame_distance": distance,
        **planar.judged_end(demonstrations, new["second"], means[-1]),
        "end_error_product_last": planar.judged_end(demonstrations, new["second"], other[-1])["end_error"],
    }


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the program; returns its exit status."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--data", type=Path, default=planar.DATA, help="pbdlib's data (default: %(default)s)")
    parser.add_argument("--output", type=Path, default=Path("out/figures"), help="of figure3.json, figure3.png")
    parser.add_argument("--components", type=int, default=3, help="of the model (default: %(default)s)")
    options = parser.parse_args(arguments)
    try:
        demonstrations = planar.demonstrations(options.data)
    except FileNotFoundError as error:
        print(f"figure 3 left out: {error}")
        return 0
    model = TPGMM(options.components, init="time", reg_covar=1e-4).fit(demonstrations)
    figure = Figure(figsize=(17.0, 8.6), layout="constrained")
    FigureCanvasAgg(figure)
    panels = figure.subplots(2, 4).flat
    found = situations(demonstrations)
    rows = [
        draw(axes, title, model, demonstrations, new) for axes, (title, new) in zip(panels, found.items(), strict=True)
    ]
    print(f"figure 3: {options.components} components, {model.n_iter_} iterations of EM; lengths in units of the data")
    write_report("figure3", rows, options.output)
    figure.savefig(options.output / "figure3.png", dpi=110)
    print(f"picture: {options.output / 'figure3.png'}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
