# SPDX-License-Identifier: Apache-2.0
"""LQR gains: closed form and doubling against scipy's Riccati solver; finite horizon against bare numpy."""

from __future__ import annotations

import os
from collections.abc import Callable

os.environ.update(OMP_NUM_THREADS="1", OPENBLAS_NUM_THREADS="1")  # before numpy is imported

import sys  # noqa: E402

import numpy as np  # noqa: E402
from scipy.linalg import solve_continuous_are  # noqa: E402

from benchmarks.report import alternating, without_options, write_report  # noqa: E402
from tpgmm_core.lqr.double_integrator import Gains, double_integrator, double_integrator_gains, riccati_gains  # noqa: E402
from tpgmm_core.lqr.finite_horizon import finite_horizon_gains  # noqa: E402

Row = dict[str, str | float | bool]
Array = np.ndarray
Law = Callable[[Array], Gains]
STEPS, CONTROL_COST = 200, 0.3


def precisions(count: int, dimensions: int) -> np.ndarray:
    """Symmetric positive definite matrices (count, D, D)."""
    X = np.random.default_rng(0).normal(size=(count, dimensions, dimensions))
    return X @ X.swapaxes(1, 2) + 0.1 * np.eye(dimensions)


def scipy_gains(position_cost: np.ndarray, velocity_cost: np.ndarray) -> Gains:
    """By scipy's solver of the Riccati equation."""
    D = len(position_cost)
    zero, eye = np.zeros((D, D)), np.eye(D)
    A, B = np.block([[zero, eye], [zero, zero]]), np.vstack([zero, eye])
    Q = np.block([[position_cost, zero], [zero, velocity_cost]])
    K = B.T @ solve_continuous_are(A, B, Q, CONTROL_COST * eye) / CONTROL_COST
    return Gains(K[:, :D], K[:, D:])


def infinite_horizon(
    state: int, name: str, to_reach: float, velocity_cost: float, ours: Callable[[Array], Gains]
) -> Row:
    """One gain of each kind per call; the double integrator of `state` numbers."""
    D = state // 2
    costs, velocities = precisions(STEPS, D), velocity_cost * np.eye(D)
    turn = iter(range(10**9))
    scipy_s, ours_s = alternating(
        lambda: scipy_gains(costs[next(turn) % STEPS], velocities),
        lambda: ours(costs[next(turn) % STEPS]),
        rounds=20,
        repetitions=50,
    )
    error = 0.0
    for cost in costs:
        exact, ours_too = scipy_gains(cost, velocities), ours(cost)
        for one, other in ((ours_too.stiffness, exact.stiffness), (ours_too.damping, exact.damping)):
            error = max(error, float(np.abs(one - other).max()))
    ratio = float(np.median(scipy_s) / np.median(ours_s))
    return {
        "work": f"one gain, {name}, state {state}",
        "yardstick_us": 1e6 * float(np.median(scipy_s)),
        "ours_us": 1e6 * float(np.median(ours_s)),
        "times_faster": ratio,
        "largest_difference": error,
        "passed": bool(ratio >= to_reach and error <= 1e-9),
    }


def bare_recursion(A: np.ndarray, B: np.ndarray, Q: np.ndarray, R: np.ndarray) -> np.ndarray:
    """Gains (T, m, n) only, no feedforward: what is to be met."""
    gains, P = np.empty((len(Q) - 1, B.shape[1], len(A))), Q[-1]
    for t in range(len(Q) - 2, -1, -1):
        BP = B.T @ P
        gains[t] = np.linalg.solve(R + BP @ B, BP @ A)
        P = Q[t] + A.T @ P @ (A - B @ gains[t])
    return gains


def finite_horizon(state: int) -> Row:
    """200 steps with references that move, feedforward included."""
    D = state // 2
    A, B = double_integrator(D, 0.01)
    Q = np.zeros((STEPS + 1, state, state))
    Q[:, :D, :D] = precisions(STEPS + 1, D)
    R, references = CONTROL_COST * np.eye(D), np.random.default_rng(1).normal(size=(STEPS + 1, state))
    bare_s, ours_s = alternating(
        lambda: bare_recursion(A, B, Q, R), lambda: finite_horizon_gains(A, B, Q, R, references), rounds=40
    )
    error = np.abs(bare_recursion(A, B, Q, R) - finite_horizon_gains(A, B, Q, R, references).gains).max()
    ratio = float(np.median(bare_s) / np.median(ours_s))
    return {
        "work": f"{STEPS} steps, state {state}",
        "yardstick_us": 1e6 * float(np.median(bare_s)),
        "ours_us": 1e6 * float(np.median(ours_s)),
        "times_faster": ratio,
        "largest_difference": float(error),
        "passed": bool(ratio >= 1.0 / 1.5 and error <= 1e-9),
    }


def closed_form(precision: Array) -> Gains:
    """Without a cost on velocities."""
    return double_integrator_gains(precision, CONTROL_COST)


def doubling(precision: Array) -> Gains:
    """With a cost on velocities."""
    return riccati_gains(precision, np.eye(len(precision)), CONTROL_COST)


if __name__ == "__main__":
    without_options(__doc__)
    rows = [infinite_horizon(state, "closed form", 50.0, 0.0, closed_form) for state in (6, 14)]
    rows += [infinite_horizon(state, "with velocities", 1.0, 1.0, doubling) for state in (6, 14, 28)]
    sys.exit(write_report("lqr", [*rows, finite_horizon(6), finite_horizon(14)]))
