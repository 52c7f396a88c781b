# SPDX-License-Identifier: Apache-2.0
"""LQR gains: closed form against scipy's Riccati solver, and the finite horizon against the bare numpy recursion."""

from __future__ import annotations

import os

os.environ.update(OMP_NUM_THREADS="1", OPENBLAS_NUM_THREADS="1")  # before numpy is imported

import numpy as np  # noqa: E402

from benchmarks.report import alternating, write_report  # noqa: E402
from tpgmm_core.control.finite_horizon import finite_horizon_gains  # noqa: E402
from tpgmm_core.control.lqr import double_integrator, double_integrator_gains, riccati_gains  # noqa: E402

Row = dict[str, str | float | bool]
STEPS, CONTROL_COST = 200, 0.3


def precisions(count: int, dimensions: int) -> np.ndarray:
    """Symmetric positive definite matrices (count, D, D)."""
    X = np.random.default_rng(0).normal(size=(count, dimensions, dimensions))
    return X @ X.swapaxes(1, 2) + 0.1 * np.eye(dimensions)


def infinite_horizon(state: int) -> Row:
    """One gain of each kind per call; the double integrator of `state` numbers."""
    D = state // 2
    costs, zero = precisions(STEPS, D), np.zeros((D, D))
    turn = iter(range(10**9))
    scipy_s, ours_s = alternating(
        lambda: riccati_gains(costs[next(turn) % STEPS], zero, CONTROL_COST),
        lambda: double_integrator_gains(costs[next(turn) % STEPS], CONTROL_COST),
        rounds=20,
        repetitions=50,
    )
    error = 0.0
    for cost in costs:
        exact, ours = riccati_gains(cost, zero, CONTROL_COST), double_integrator_gains(cost, CONTROL_COST)
        error = max(error, np.abs(ours.stiffness - exact.stiffness).max(), np.abs(ours.damping - exact.damping).max())
    ratio = float(np.median(scipy_s) / np.median(ours_s))
    return {
        "work": f"one gain, state {state}",
        "yardstick_us": 1e6 * float(np.median(scipy_s)),
        "ours_us": 1e6 * float(np.median(ours_s)),
        "times_faster": ratio,
        "largest_difference": float(error),
        "passed": bool(ratio >= 50.0 and error <= 1e-9),
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


if __name__ == "__main__":
    write_report("lqr", [infinite_horizon(6), infinite_horizon(14), finite_horizon(6), finite_horizon(14)])
