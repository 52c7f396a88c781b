# SPDX-License-Identifier: Apache-2.0
"""The problem of `PredictiveLaw` at one moment, and the plan that solves it, which may be made in another thread."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from tpgmm_core.common.types import Array
from tpgmm_core.control.joint_impedance import JointImpedanceConfig
from tpgmm_core.control.joint_target import JointGains, receding_joint_gains
from tpgmm_core.control.predictive import JointReference, PredictiveController, PredictivePlan
from tpgmm_core.geometry.manifold import POSE
from tpgmm_core.kinematics.joint_space import to_joint_space


@dataclass(frozen=True, slots=True)
class PredictiveTarget:
    """Where to be from now on, as a pose or as joints.

    Parameters
    ----------
    means
        (T, D)
    precisions
        (T, m, m)
    time_step
        between them, s
    """

    means: Array
    precisions: Array
    time_step: float


@dataclass(frozen=True, slots=True)
class PlanProblem:
    """All that a plan is made from; `jacobian` (6, n) and `pose` (7,) of the hand are None for references of joints.

    `share` is that of the rates of the feedback, for the delay of the loop: planning again from late states is feedback
    too.
    """

    q: Array
    v: Array
    inertia: Array
    nonlinear: Array
    pose: Array | None
    jacobian: Array | None
    target: PredictiveTarget
    share: float


@dataclass(frozen=True, slots=True)
class Planned:
    """A plan from q and v (n,) on, and the gains around it."""

    q: Array
    v: Array
    plan: PredictivePlan
    gains: JointGains


def solve(
    problem: PlanProblem,
    solver: PredictiveController,
    config: JointImpedanceConfig,
    rest: Array,
    posture_precision: Array,
) -> Planned:
    """Make a plan, and gains, from a problem alone.

    Parameters
    ----------
    problem
        what the plan is made from
    solver
        with the limits of the joints
    config
        costs and bounds of the stiffness
    rest
        shape (n,), posture that free directions are drawn to
    posture_precision
        shape (n, n), how firmly

    Returns
    -------
    Planned
        the plan, and the gains around it

    Raises
    ------
    ValueError
        for numbers that cannot be computed with
    """
    positions, precisions = _course(problem, rest, posture_precision)
    dt = problem.target.time_step
    known = dt * np.arange(len(positions))
    at = np.array([np.interp(solver.times, known, joint) for joint in positions.T]).T
    knot = np.searchsorted(known, solver.times, side="right") - 1
    try:
        L = np.linalg.cholesky(problem.inertia)
        cost, covariances = config.joint_control_cost, np.linalg.inv(precisions)
        gains = receding_joint_gains(L, positions, covariances, dt, cost, config.bounds)
    except np.linalg.LinAlgError as error:
        raise ValueError(f"no plan can be made: {error}") from error
    # the fourth power: K_P is the square root of the precision, and goes with the square of the share
    softer = problem.share**4 * _bounded(precisions, L, config)
    bounded = JointReference(positions=at, precisions=softer[knot])
    plan = solver.solve(problem.q, problem.v, bounded, problem.inertia, problem.nonlinear)
    return Planned(problem.q, problem.v, plan, replace(gains, push=np.zeros(len(rest))))  # the plan has it


def _course(problem: PlanProblem, rest: Array, posture_precision: Array) -> tuple[Array, Array]:
    """Positions (T, n) and precisions (T, n, n) of the joints."""
    target, q, n = problem.target, problem.q, len(problem.q)
    if problem.pose is None or problem.jacobian is None:
        return target.means, target.precisions
    both = []
    for mean, precision in zip(target.means, target.precisions, strict=True):
        errors = [POSE.log(problem.pose, mean), rest - q]
        both.append(to_joint_space([precision, posture_precision], [problem.jacobian, np.eye(n)], errors, q))
    return np.stack([positions for _, positions in both]), np.stack([precision for precision, _ in both])


def _bounded(precisions: Array, L: Array, config: JointImpedanceConfig) -> Array:
    """Precisions (T, n, n) with the stiffness within its bounds, in the coordinates L^T q of the inertia."""
    F = np.linalg.inv(L)
    values, vectors = np.linalg.eigh(F @ precisions @ F.T)
    cost = config.joint_control_cost
    values = np.clip(values, cost * config.joint_min_stiffness**2, cost * config.joint_max_stiffness**2)
    basis = L @ vectors
    return np.asarray((basis * values[:, None, :]) @ basis.mT)
