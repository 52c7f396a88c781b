# SPDX-License-Identifier: Apache-2.0
"""Inverse optimal control (Section 5): what a model has learned is the cost that a solver of others begins with.

The file is that of `show --costs`: for each frame targets and precisions over time, in the axes of the frame. With the
frames put where the objects are, a solver minimises their sum with the squared acceleration of the hand beside it,
once as it is and once within limits of speed and acceleration that no demonstration has shown. Nothing but the file and
the frames' poses goes into the solver. Positions alone are planned here.

Solvers are CasADi and Crocoddyl, which only this program needs: pip install casadi crocoddyl
"""

from __future__ import annotations

import json
import os
import sys
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

os.environ.update(OMP_NUM_THREADS="1", OPENBLAS_NUM_THREADS="1")  # before numpy is imported

import numpy as np  # noqa: E402
from matplotlib.figure import Figure  # noqa: E402

from examples.claims import at_least, at_most, canvas, finish, options_of  # noqa: E402
from examples.solvers import SOLVERS, Movement, Problem, installed  # noqa: E402
from tpgmm_core import Demonstration, Frame  # noqa: E402
from tpgmm_core.common.report import Row  # noqa: E402
from tpgmm_core.common.types import Array  # noqa: E402
from tpgmm_core.learning.learned_mixture import LearnedMixture  # noqa: E402
from tpgmm_core.retrieval.recipe import Recipe  # noqa: E402
from tpgmm_core.retrieval.sub_objectives import quadratic_costs, sub_objectives  # noqa: E402
from tpgmm_ros.recordings.bags import find_bags, read_demonstrations  # noqa: E402
from tpgmm_ros.task.task_file import Task  # noqa: E402

SLOWER = 0.6
"""The limits are this share of the largest speed, and of the largest acceleration, of the movement without limits."""
STEPS = 81


def place(frame: Frame) -> tuple[Array, Array]:
    """Rotation and position of a constant frame over [time, pose]."""
    return frame.A[1:4, 1:4], frame.b[1:4]


def costs_of(model: LearnedMixture, duration: float) -> dict[str, Any]:
    """The costs of a model as they come out of a file."""
    times = np.linspace(0.0, duration, STEPS)
    return dict(json.loads(json.dumps(quadratic_costs(model, times), allow_nan=False)))


def claims(
    costs: Mapping[str, Any], model: LearnedMixture, situation: Mapping[str, Frame], solvers: Sequence[str]
) -> tuple[list[Row], Figure]:
    """What must hold of the movements of each solver in a situation, and their picture."""
    places = {name: place(frame) for name, frame in situation.items()}
    times = np.asarray(costs["times"])
    expected = sub_objectives(model, times, situation).means[:, :3]
    free = {name: SOLVERS[name][1](Problem.of(costs, places)) for name in solvers}
    _, velocities, accelerations = free[solvers[0]]
    limits = SLOWER * float(np.abs(velocities).max()), SLOWER * float(np.abs(accelerations).max())
    slow = {name: SOLVERS[name][1](Problem.of(costs, places, limits)) for name in solvers}
    rows = [row for name in solvers for row in claims_of(name, expected, free[name], slow[name], limits)]
    for name in solvers[1:]:
        for kind, found, bound in (("", free, 1e-6), (", with limits", slow, 0.01)):
            apart = np.linalg.norm(found[name][0] - found[solvers[0]][0], axis=1).max()
            rows.append(at_most(f"{name} from {solvers[0]}{kind}, at most, m", float(apart), bound))
    return rows, draw(times, expected, free, slow, limits[0])


def claims_of(name: str, expected: Array, free: Movement, slow: Movement, limits: tuple[float, float]) -> Iterator[Row]:
    """What must hold of one solver's movements without and with limits."""
    aside = np.linalg.norm(slow[0] - expected, axis=1)
    yield at_most(f"{name}: from the model's own movement, RMSE, m", _rms(free[0] - expected), 0.02)
    for what, reached, limit in zip(("speed", "acceleration"), slow[1:], limits, strict=True):
        yield at_most(f"{name}, with limits: {what} over its limit", float(np.abs(reached).max()) / limit, 1.001)
    yield at_most(f"{name}, with limits: end from the model's, m", float(aside[-1]), 0.01)
    yield at_least(f"{name}, with limits: where it gives way, over where it ends", float(aside.max() / aside[-1]), 2.0)


def _rms(differences: Array) -> float:
    return float(np.sqrt(np.mean(np.sum(differences**2, axis=1))))


def draw(
    times: Array, expected: Array, free: Mapping[str, Movement], slow: Mapping[str, Movement], limit: float
) -> Figure:
    """Positions above, velocities below, of x, y and z."""
    figure = canvas(11.0, 5.0)
    for k, (above, below) in enumerate(zip(*figure.subplots(2, 3, sharex=True), strict=True)):
        above.plot(times, expected[:, k], "k:", label="the model's own movement")
        for i, name in enumerate(free):
            # solvers that agree lie on each other: the first is a wide pale line, the next one a dashed line on it
            style = {"linewidth": 3.0, "alpha": 0.5} if i == 0 else {"linestyle": "--"}
            for found, colour, suffix in ((free, "C0", ""), (slow, "C1", ", with limits")):
                above.plot(times, found[name][0][:, k], colour, label=name + suffix, **style)
                below.plot(times, found[name][1][:, k], colour, **style)
        below.axhspan(-limit, limit, color="0.9")
        above.set(title="xyz"[k])
        below.set(xlabel="time, s")
        if k == 0:
            above.set_ylabel("position, m")
            below.set_ylabel("velocity, m/s")
            handles, labels = above.get_legend_handles_labels()
            figure.legend(handles, labels, loc="outside lower center", ncols=5)
    return figure


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the program; returns its exit status."""
    parser = options_of(__doc__, "optimal_control")
    parser.add_argument("--task", type=Path, default=Path("config/pick_place.yaml"), help="(default: %(default)s)")
    parser.add_argument("--bags", type=Path, default=Path("bags/pick_place"), help="(default: %(default)s)")
    parser.add_argument("--solver", choices=sorted(SOLVERS), help="(default: all that are installed)")
    options = parser.parse_args(arguments)
    solvers = [name for name in installed() if options.solver in (None, name)]
    if not solvers:
        wanted = [options.solver] if options.solver else list(SOLVERS)
        packages = " or ".join(f".venv/bin/python -m pip install {SOLVERS[name][0]}" for name in wanted)
        print(f"optimal_control: {' or '.join(wanted)} is not installed: {packages}", file=sys.stderr)
        return 1
    task = Task.load(options.task)
    shown, duration = read_demonstrations(find_bags([options.bags]), task)
    model = Recipe.of(dict(task.model)).learn(shown, task.space.manifold(), task.space.dimensions())
    rows, figure = claims(costs_of(model, duration), model, in_the_beginning(shown[0]), solvers)
    return finish("optimal_control", figure, rows, options.output)


def in_the_beginning(shown: Demonstration) -> dict[str, Frame]:
    """Where the frames of a demonstration are at its first sample."""
    return {name: frame.at(0) for name, frame in shown.frames.items()}


if __name__ == "__main__":
    sys.exit(main())
