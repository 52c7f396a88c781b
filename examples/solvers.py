# SPDX-License-Identifier: Apache-2.0
"""Solvers of others that plan with learned costs: CasADi (IPOPT) and Crocoddyl (box FDDP).

Each is a function from a problem to a movement. Neither is installed with the project.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from importlib.util import find_spec
from typing import Any, Self

import numpy as np

from tpgmm_core.common.types import Array

EFFORT = 1e-2
"""Weight of the squared acceleration, s⁴/m²."""
BARRIER = 1e6
"""Crocoddyl: weight of the squared speed above its limit, s²/m²."""

type Movement = tuple[Array, Array, Array]
"""Positions (T, 3), m, velocities (T, 3), m/s, and accelerations (T - 1, 3), m/s², of a point mass."""


@dataclass(frozen=True)
class Problem:
    """What a point mass minimises over time: `(p - target)^T precision (p - target)`, and its squared acceleration.

    Parameters
    ----------
    step
        of time, s
    targets
        (T, 3), m
    precisions
        (T, 3, 3), 1/m²
    limits
        of the components of velocity, m/s, and acceleration, m/s²; None: there are none
    """

    step: float
    targets: Array
    precisions: Array
    limits: tuple[float, float] | None = None

    @classmethod
    def of(
        cls,
        costs: Mapping[str, Any],
        places: Mapping[str, tuple[Array, Array]],
        limits: tuple[float, float] | None = None,
    ) -> Self:
        """The sum of the frames' costs, Eq. (3), where the frames are.

        Parameters
        ----------
        costs
            as `show --costs` writes them, of a model whose data begin with x, y, z
        places
            rotation (3, 3) and position (3,), m, of each frame
        limits
            of the components of velocity, m/s, and acceleration, m/s²; None: there are none
        """
        times = np.asarray(costs["times"])
        total, pull = np.zeros((len(times), 3, 3)), np.zeros((len(times), 3))
        for name, terms in costs["frames"].items():
            R, b = places[name]
            # of positions alone: what a Gaussian says of some dimensions when the others may be anything
            W = R @ np.linalg.inv(np.linalg.inv(np.array(terms["precisions"]))[:, :3, :3]) @ R.T
            target = np.array(terms["targets"])[:, :3] @ R.T + b
            total += W
            pull += np.einsum("tij,tj->ti", W, target)
        targets = np.linalg.solve(total, pull[..., None])[..., 0]
        return cls(float(times[1] - times[0]), targets, total, limits)


def with_casadi(problem: Problem) -> Movement:
    """The best movement, by IPOPT; limits are constraints.

    Raises
    ------
    RuntimeError
        the solver has found no movement, as where limits are too tight
    """
    import casadi

    T, dt = len(problem.targets), problem.step
    found = casadi.Opti()
    p, v, u = found.variable(3, T), found.variable(3, T), found.variable(3, T - 1)
    total = EFFORT * casadi.sumsqr(u)
    for t in range(T):
        e = p[:, t] - problem.targets[t]
        total += casadi.dot(e, problem.precisions[t] @ e)
    found.minimize(dt * total)
    found.subject_to(casadi.vec(p[:, 1:] - p[:, :-1] - dt * v[:, :-1] - 0.5 * dt**2 * u) == 0)
    found.subject_to(casadi.vec(v[:, 1:] - v[:, :-1] - dt * u) == 0)
    if problem.limits is not None:
        speed, acceleration = problem.limits
        found.subject_to(found.bounded(-speed, casadi.vec(v), speed))
        found.subject_to(found.bounded(-acceleration, casadi.vec(u), acceleration))
    found.solver("ipopt", {"print_time": False}, {"print_level": 0, "sb": "yes"})
    solution = found.solve()
    return tuple(np.asarray(solution.value(x)).T for x in (p, v, u))  # type: ignore[return-value]


def with_crocoddyl(problem: Problem) -> Movement:
    """The best movement, by box FDDP, whose controls have bounds; the limit of speed is a steep cost.

    Raises
    ------
    RuntimeError
        the solver has not converged
    """
    import crocoddyl

    dt = problem.step
    F = np.block([[np.eye(3), dt * np.eye(3)], [np.zeros((3, 3)), np.eye(3)]])
    G = np.block([[0.5 * dt**2 * np.eye(3), np.zeros((3, 3))], [dt * np.eye(3), np.zeros((3, 3))]])
    speed, acceleration = problem.limits or (np.inf, np.inf)

    class Step(crocoddyl.ActionModelAbstract):  # type: ignore[misc, unused-ignore]
        """One step of time; the state is [position, velocity], the control [acceleration, what moves nothing]."""

        def __init__(self, target: Array, precision: Array) -> None:
            super().__init__(crocoddyl.StateVector(6), 6, 0)
            self.target, self.precision = target, precision
            self.u_lb, self.u_ub = np.full(6, -acceleration), np.full(6, acceleration)

        def calc(self, data: Any, x: Array, u: Array | None = None) -> None:
            e, over = x[:3] - self.target, x[3:] - np.clip(x[3:], -speed, speed)
            data.cost = dt * (e @ self.precision @ e + BARRIER * over @ over)
            if u is not None:
                data.xnext = F @ x + G @ u
                data.cost += dt * EFFORT * u @ u

        def calcDiff(self, data: Any, x: Array, u: Array | None = None) -> None:  # noqa: N802 (Crocoddyl's name)
            over = x[3:] - np.clip(x[3:], -speed, speed)
            data.Lx = 2.0 * dt * np.concatenate([self.precision @ (x[:3] - self.target), BARRIER * over])
            data.Lxx = np.zeros((6, 6))
            data.Lxx[:3, :3] = 2.0 * dt * self.precision
            data.Lxx[3:, 3:] = 2.0 * dt * BARRIER * np.diag(over != 0.0)
            if u is not None:
                data.Fx, data.Fu = F, G
                data.Lu, data.Luu = 2.0 * dt * EFFORT * u, 2.0 * dt * EFFORT * np.eye(6)

    # The movement may begin anywhere, but the solver begins in a given state: a first, free control chooses it.
    # All controls have the size of that one, because the solver's quadratic programs have one size.
    none = np.zeros((6, 6))
    begin = crocoddyl.ActionModelLQR(none, np.eye(6), none, none, none, *3 * [np.zeros(6)])
    steps = [Step(*one) for one in zip(problem.targets, problem.precisions, strict=True)]
    solver = crocoddyl.SolverBoxFDDP(crocoddyl.ShootingProblem(np.zeros(6), [begin, *steps[:-1]], steps[-1]))
    if not solver.solve([], [], 1000):
        raise RuntimeError(f"Crocoddyl has not converged within {solver.iter} iterations")
    states = np.array(solver.xs)[1:]
    return states[:, :3], states[:, 3:], np.array(solver.us)[1:, :3]


SOLVERS: dict[str, tuple[str, Callable[[Problem], Movement]]] = {
    "CasADi": ("casadi", with_casadi),
    "Crocoddyl": ("crocoddyl", with_crocoddyl),
}
"""Package of PyPI and function of each solver."""


def installed() -> list[str]:
    """The solvers that are there."""
    return [name for name, (package, _) in SOLVERS.items() if find_spec(package) is not None]
