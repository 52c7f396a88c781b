# SPDX-License-Identifier: Apache-2.0
"""Figure 3 of the paper: the movement of figure 1 in the demonstrated situations, and farther and farther away.

Pale: the four demonstrations, and the Gaussians of the model in their situations. In colour: the situation of the
panel. There are two orders of the same two steps:

- solid: regression over time in each frame, then the product of what the frames expect at that time;
- dashed: the product of whole components, Eqs. (5) and (6), then regression, as in the paper.

A component is a straight piece of the movement: with few of them the reproduction leaves the demonstrations in the
curves. The program compares three with five. Far from the demonstrations the dashed order suffers: frames that
disagree about a component's place also move it in time. Where the first box moves, the start is a compromise: it never
moved in the demonstrations, so that nothing told the model that the second box does not matter there.
"""

from __future__ import annotations

import sys
from collections.abc import Mapping, Sequence

import numpy as np
from matplotlib.axes import Axes

from examples import planar
from examples.claims import at_least, at_most, canvas, finish, options_of
from tpgmm_core import TPGMM, Demonstration, Frame
from tpgmm_core.common.report import Row
from tpgmm_core.common.types import Array
from tpgmm_core.retrieval.regression import AdaptThenRegress, RegressThenProduct

TIMES = np.linspace(0.0, planar.DURATION, 201)
FEW = 3  # components, to compare with


def situations() -> dict[str, dict[str, Frame]]:
    """New ones of growing distance, by title."""
    return {
        "between the demonstrations": planar.situation(0.67),
        "2 × the demonstrated range": planar.situation(2.0),
        "2 ×, and the first box moved and turned": planar.situation(2.0, planar.box(-0.25, 0.3, 40.0)),
        "4 × the demonstrated range": planar.situation(4.0),
    }


def path_of(retrieval: AdaptThenRegress | RegressThenProduct, frames: Mapping[str, Frame]) -> Array:
    """The mean movement (T, 2) in a situation."""
    return np.stack([gaussian.mean for gaussian in retrieval.retrieve(frames, TIMES)])


def farthest(path: Array, demonstration: Demonstration) -> float:
    """How far a path (T, 2) leaves that of a demonstration, m."""
    gaps = path[:, None] - demonstration.data[None, :, planar.POSITION]
    return float(np.linalg.norm(gaps, axis=-1).min(axis=1).max())


def draw(axes: Axes, title: str, model: TPGMM, shown: Sequence[Demonstration], frames: Mapping[str, Frame]) -> None:
    """One situation, over the demonstrations."""
    planar.draw_demonstrations(axes, shown, 0.35)
    for d in shown:
        adapted = model.adapt({name: frame.at(0) for name, frame in d.frames.items()})
        planar.draw_gaussians(axes, [adapted.component(k) for k in range(planar.COMPONENTS)], 0.1)
    adapted = model.adapt(frames)
    planar.draw_gaussians(axes, [adapted.component(k) for k in range(planar.COMPONENTS)], 0.6)
    axes.plot(*path_of(RegressThenProduct(model), frames).T, color="black", lw=2.5, zorder=5)
    axes.plot(*path_of(AdaptThenRegress(model), frames).T, "--", color="black", lw=1.2, zorder=5)
    planar.draw_boxes(axes, frames)
    planar.tidy(axes, title)


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the program; returns its exit status."""
    options = options_of(__doc__, "figure3").parse_args(arguments)
    shown = planar.demonstrations()
    model, with_few = planar.learned(shown), planar.learned(shown, FEW)
    of_demonstrations = {f"demonstration {i + 1}": dict(d.frames) for i, d in enumerate(shown)}
    figure = canvas(17.0, 8.6)
    for axes, (title, frames) in zip(
        figure.subplots(2, 4).flat, (of_demonstrations | situations()).items(), strict=True
    ):
        draw(axes, title, model, shown, frames)
    return finish("figure3", figure, claims(shown, model, with_few), options.output)


def claims(shown: Sequence[Demonstration], model: TPGMM, with_few: TPGMM) -> list[Row]:
    """What the panels must show."""
    solid, few = RegressThenProduct(model), RegressThenProduct(with_few)
    leaves = max(farthest(path_of(solid, d.frames), d) for d in shown)
    leaves_with_few = max(farthest(path_of(few, d.frames), d) for d in shown)
    rows = [
        at_most("demonstrated situations: the path leaves the demonstration by, m", leaves, 0.08),
        at_least(f"the same with {FEW} components / with {planar.COMPONENTS}", leaves_with_few / leaves, 1.2),
    ]
    fixed = planar.end_without_frames(shown)
    for title, frames in situations().items():
        goal = frames["second"].b[planar.POSITION]
        error = np.linalg.norm(path_of(solid, frames)[-1] - goal)
        order = model.adapt(frames).means[:, 0]  # when the components come, s
        rows += [
            at_most(f"{title}: distance of the end from the second box, m", error, 0.08),
            at_most(f"{title}: the same / without frames", error / np.linalg.norm(fixed - goal), 0.2),
            at_least(f"{title}: time from a component to the next, s", np.diff(order).min(), 0.1),
        ]
    return rows


if __name__ == "__main__":
    sys.exit(main())
