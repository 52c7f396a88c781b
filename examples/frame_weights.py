# SPDX-License-Identifier: Apache-2.0
"""The frames of a task as sub-objectives (Section 5): how much each of them counts at each time of the movement.

The model is learned from the project's own recordings; nobody names the frame that matters. The situation is that of
the first recording at its start. Above for the position of the hand, in the middle for its orientation, below what is
left of each sub-objective: how far the frames contradict each other.
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

from examples.report import write_report  # noqa: E402
from tpgmm_core.common.report import Row  # noqa: E402
from tpgmm_core.common.types import Array  # noqa: E402
from tpgmm_core.retrieval.recipe import Recipe  # noqa: E402
from tpgmm_core.retrieval.sub_objectives import SubObjectives, sub_objectives  # noqa: E402
from tpgmm_ros.recordings.bags import find_bags, read_demonstrations  # noqa: E402
from tpgmm_ros.task.state_space import DIMENSIONS, MANIFOLD  # noqa: E402
from tpgmm_ros.task.task_file import Task  # noqa: E402

COLOURS = ("#d95f02", "#1b9e77", "#7570b3", "#e7298a", "#66a61e")
POSITION, ROTATION = slice(0, 3), slice(3, 6)
TOLD_AT = (0.0, 0.25, 0.5, 0.75, 1.0)  # of the duration


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the program; returns its exit status."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--task", type=Path, default=Path("config/pick_place.yaml"), help="(default: %(default)s)")
    parser.add_argument("--bags", type=Path, default=Path("bags/pick_place"), help="(default: %(default)s)")
    parser.add_argument("--output", type=Path, default=Path("out/figures"), help="of frame_weights.json and .png")
    options = parser.parse_args(arguments)
    task = Task.load(options.task)
    demonstrations, duration = read_demonstrations(find_bags([options.bags]), task)
    model = Recipe.of(dict(task.model)).learn(demonstrations, MANIFOLD, DIMENSIONS)
    situation = {name: frame.at(0) for name, frame in demonstrations[0].frames.items()}
    times = np.linspace(0.0, duration, 300)
    objectives = sub_objectives(model, times, situation)
    write_report("frame_weights", rows(times / duration, objectives), options.output)
    picture = options.output / "frame_weights.png"
    draw(times, objectives).savefig(picture, dpi=110)
    print(f"picture: {picture}")
    return 0


def rows(phase: Array, objectives: SubObjectives) -> list[Row]:
    """The weights at some phases."""
    position, rotation = objectives.weights(POSITION), objectives.weights(ROTATION)
    result: list[Row] = []
    for wanted in TOLD_AT:
        t = int(np.argmin(np.abs(phase - wanted)))
        result.append(
            {"phase": float(phase[t])}
            | {f"{name}_position_weight": float(position[t, j]) for j, name in enumerate(objectives.frames)}
            | {f"{name}_orientation_weight": float(rotation[t, j]) for j, name in enumerate(objectives.frames)}
        )
    return result


def draw(times: Array, objectives: SubObjectives) -> Figure:
    """Weights as stacked areas, and what is left of the sub-objectives."""
    figure = Figure(figsize=(9.0, 8.0), layout="constrained")
    FigureCanvasAgg(figure)
    above, middle, below = figure.subplots(3, 1, sharex=True)
    colours = COLOURS[: len(objectives.frames)]
    panels: tuple[tuple[Axes, slice, str], ...] = ((above, POSITION, "position"), (middle, ROTATION, "orientation"))
    for axes, dimensions, title in panels:
        axes.stackplot(times, objectives.weights(dimensions).T, colors=colours, labels=objectives.frames, alpha=0.8)
        axes.set_ylim(0.0, 1.0)
        axes.set_ylabel(f"weight in the objective,\n{title}")
    above.legend(loc="center right", framealpha=0.9)
    for j, (name, colour) in enumerate(zip(objectives.frames, colours, strict=True)):
        below.semilogy(times, objectives.costs[:, j], color=colour, label=name)
    below.set_ylabel("what is left of the\nsub-objective (variances)")
    below.set_xlabel("time (s)")
    above.set_xlim(times[0], times[-1])
    return figure


if __name__ == "__main__":
    sys.exit(main())
