# SPDX-License-Identifier: Apache-2.0
"""Inverse optimal control (Section 5): what a model has learned is the cost that a solver of others begins with.

The file is that of `show --costs`: for each frame targets and precisions over time, in the axes of the frame. With the
frames put where the objects are, CasADi minimises their sum with the squared acceleration of the hand beside it, once
as it is and once within limits of speed and acceleration that no demonstration has shown. Nothing but the file and the
frames' poses goes into the solver. Positions alone are planned here.

The solver is CasADi's IPOPT, which only this program needs: pip install casadi
"""

from __future__ import annotations

import json
import os
import sys
from collections.abc import Mapping, Sequence
from importlib.util import find_spec
from pathlib import Path
from typing import Any

os.environ.update(OMP_NUM_THREADS="1", OPENBLAS_NUM_THREADS="1")  # before numpy is imported

import numpy as np  # noqa: E402
from matplotlib.figure import Figure  # noqa: E402

from examples.claims import at_least, at_most, canvas, finish, options_of  # noqa: E402
from tpgmm_core import Demonstration, Frame  # noqa: E402
from tpgmm_core.common.report import Row  # noqa: E402
from tpgmm_core.common.types import Array  # noqa: E402
from tpgmm_core.learning.learned_mixture import LearnedMixture  # noqa: E402
from tpgmm_core.retrieval.recipe import Recipe  # noqa: E402
from tpgmm_core.retrieval.sub_objectives import quadratic_costs, sub_objectives  # noqa: E402
from tpgmm_ros.recordings.bags import find_bags, read_demonstrations  # noqa: E402
from tpgmm_ros.task.task_file import Task  # noqa: E402

EFFORT = 1e-2
"""Weight of the squared acceleration, s⁴/m²."""
SLOWER = 0.6
"""The limits are this share of the largest speed, and of the largest acceleration, of the movement without limits."""
STEPS = 81


def planned(
    costs: Mapping[str, Any], places: Mapping[str, tuple[Array, Array]], limits: tuple[float, float] | None = None
) -> tuple[Array, Array, Array]:
    """The movement of a point mass that minimises the costs.

    Parameters
    ----------
    costs
        as `show --costs` writes them, of a model whose data begin with x, y, z
    places
        rotation (3, 3) and position (3,), m, of each frame
    limits
        of the components of velocity, m/s, and acceleration, m/s²; None: there are none

    Returns
    -------
    tuple[Array, Array, Array]
        positions (T, 3), velocities (T, 3) and accelerations (T - 1, 3)

    Raises
    ------
    RuntimeError
        the solver has found no movement, as where limits are too tight
    """
    import casadi

    times = np.asarray(costs["times"])
    T, dt = len(times), float(times[1] - times[0])
    problem = casadi.Opti()
    p, v, u = problem.variable(3, T), problem.variable(3, T), problem.variable(3, T - 1)
    total = EFFORT * casadi.sumsqr(u)
    for name, terms in costs["frames"].items():
        R, b = places[name]
        for t in range(T):
            # of positions alone: what a Gaussian says of some dimensions when the others may be anything
            W = np.linalg.inv(np.linalg.inv(np.array(terms["precisions"][t]))[:3, :3])
            e = R.T @ (p[:, t] - b) - np.array(terms["targets"][t][:3])
            total += casadi.dot(e, W @ e)
    problem.minimize(dt * total)
    problem.subject_to(casadi.vec(p[:, 1:] - p[:, :-1] - dt * v[:, :-1] - 0.5 * dt**2 * u) == 0)
    problem.subject_to(casadi.vec(v[:, 1:] - v[:, :-1] - dt * u) == 0)
    if limits is not None:
        problem.subject_to(problem.bounded(-limits[0], casadi.vec(v), limits[0]))
        problem.subject_to(problem.bounded(-limits[1], casadi.vec(u), limits[1]))
    problem.solver("ipopt", {"print_time": False}, {"print_level": 0, "sb": "yes"})
    found = problem.solve()
    return tuple(np.asarray(found.value(x)).T for x in (p, v, u))  # type: ignore[return-value]


def place(frame: Frame) -> tuple[Array, Array]:
    """Rotation and position of a constant frame over [time, pose]."""
    return frame.A[1:4, 1:4], frame.b[1:4]


def costs_of(model: LearnedMixture, duration: float) -> dict[str, Any]:
    """The costs of a model as they come out of a file."""
    times = np.linspace(0.0, duration, STEPS)
    return dict(json.loads(json.dumps(quadratic_costs(model, times), allow_nan=False)))


def claims(costs: Mapping[str, Any], model: LearnedMixture, situation: Mapping[str, Frame]) -> tuple[list[Row], Figure]:
    """What must hold of the movements in a situation, and their picture."""
    places = {name: place(frame) for name, frame in situation.items()}
    times = np.asarray(costs["times"])
    expected = sub_objectives(model, times, situation).means[:, :3]
    path, velocities, accelerations = planned(costs, places)
    limits = SLOWER * float(np.abs(velocities).max()), SLOWER * float(np.abs(accelerations).max())
    slow, slow_velocities, slow_accelerations = planned(costs, places, limits)
    aside = np.linalg.norm(slow - expected, axis=1)
    rows = [
        at_most("from the model's own movement, RMSE, m", _rms(path - expected), 0.02),
        at_most("with limits: speed over its limit", float(np.abs(slow_velocities).max()) / limits[0], 1.0 + 1e-6),
        at_most(
            "with limits: acceleration over its limit", float(np.abs(slow_accelerations).max()) / limits[1], 1.0001
        ),
        at_most("with limits: end from the model's, m", float(aside[-1]), 0.01),
        at_least("with limits: where it gives way, over where it ends", float(aside.max() / aside[-1]), 2.0),
    ]
    return rows, draw(times, expected, (path, velocities), (slow, slow_velocities), limits[0])


def _rms(differences: Array) -> float:
    return float(np.sqrt(np.mean(np.sum(differences**2, axis=1))))


def draw(
    times: Array, expected: Array, free: tuple[Array, Array], limited: tuple[Array, Array], limit: float
) -> Figure:
    """Positions above, velocities below, of x, y and z."""
    figure = canvas(11.0, 5.0)
    for k, (above, below) in enumerate(zip(*figure.subplots(2, 3, sharex=True), strict=True)):
        above.plot(times, expected[:, k], "k:", label="the model's own movement")
        for (path, velocities), colour, label in ((free, "C0", "CasADi"), (limited, "C1", "CasADi, with limits")):
            above.plot(times, path[:, k], colour, label=label)
            below.plot(times, velocities[:, k], colour)
        below.axhspan(-limit, limit, color="0.9")
        above.set(title="xyz"[k])
        below.set(xlabel="time, s")
        if k == 0:
            above.set_ylabel("position, m")
            below.set_ylabel("velocity, m/s")
            above.legend(loc="upper left")
    return figure


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the program; returns its exit status."""
    parser = options_of(__doc__, "optimal_control")
    parser.add_argument("--task", type=Path, default=Path("config/pick_place.yaml"), help="(default: %(default)s)")
    parser.add_argument("--bags", type=Path, default=Path("bags/pick_place"), help="(default: %(default)s)")
    options = parser.parse_args(arguments)
    if find_spec("casadi") is None:
        print("optimal_control: CasADi is not installed: .venv/bin/python -m pip install casadi", file=sys.stderr)
        return 1
    task = Task.load(options.task)
    shown, duration = read_demonstrations(find_bags([options.bags]), task)
    model = Recipe.of(dict(task.model)).learn(shown, task.space.manifold(), task.space.dimensions())
    rows, figure = claims(costs_of(model, duration), model, in_the_beginning(shown[0]))
    return finish("optimal_control", figure, rows, options.output)


def in_the_beginning(shown: Demonstration) -> dict[str, Frame]:
    """Where the frames of a demonstration are at its first sample."""
    return {name: frame.at(0) for name, frame in shown.frames.items()}


if __name__ == "__main__":
    sys.exit(main())
