# SPDX-License-Identifier: Apache-2.0
"""Objectives of tasks as objectives of joints: `(x_ref - x)^T Lambda (x_ref - x)` becomes one of q through Jacobians.

Around the joint positions q the task is `x + J (q' - q)`, so that the sum of the tasks' costs is a quadratic function
of q'. Directions that the tasks leave free have no precision: they cost nothing. In joint space,
all laws of control follow it as they follow any Gaussian.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike

from tpgmm_core.common.types import Array

SMALLEST_PRECISION = 1e-9  # share of the largest eigenvalue: directions in which the tasks are softer are left alone


def to_joint_space(
    precisions: Sequence[ArrayLike], jacobians: Sequence[ArrayLike], errors: Sequence[ArrayLike], q: ArrayLike
) -> tuple[Array, Array]:
    """Precision and reference of joints for tasks of the robot.

    Parameters
    ----------
    precisions
        of each task (D_i, D_i), symmetric, semidefinite allowed
    jacobians
        of each task (D_i, n)
    errors
        of each task (D_i,), `x_ref - x`, on manifolds `log_x(x_ref)`, in the axes of the Jacobian
    q
        (n,)

    Returns
    -------
    tuple[Array, Array]
        precision (n, n), `sum J^T Lambda J`, and the reference (n,) that is best for all tasks and nearest to q

    Raises
    ------
    ValueError
        for no task, shapes that do not fit, and values that are not finite
    """
    where = np.asarray(q, dtype=np.float64)
    n = len(where)
    precision, force = np.zeros((n, n)), np.zeros(n)
    if not len(precisions) or not len(precisions) == len(jacobians) == len(errors):
        raise ValueError(
            f"expected one precision, Jacobian and error for each of one or more tasks, got {len(precisions)}, "
            f"{len(jacobians)} and {len(errors)}"
        )
    for given in zip(precisions, jacobians, errors, strict=True):
        Lambda, J, e = (np.asarray(x, dtype=np.float64) for x in given)
        if J.ndim != 2 or J.shape[1] != n or Lambda.shape != (len(J), len(J)) or e.shape != (len(J),):
            raise ValueError(
                f"a task of D dimensions has a precision (D, D), a Jacobian (D, {n}) and an error (D,), "
                f"got {Lambda.shape}, {J.shape} and {e.shape}"
            )
        weighed = J.T @ Lambda
        precision += weighed @ J
        force += weighed @ e
    precision = 0.5 * (precision + precision.T)
    if not (np.isfinite(precision).all() and np.isfinite(force).all() and np.isfinite(where).all()):
        raise ValueError("precisions, Jacobians, errors and joint positions must be finite")
    values, vectors = np.linalg.eigh(precision)
    held = values > SMALLEST_PRECISION * values[-1]
    step = vectors[:, held] @ ((vectors[:, held].T @ force) / values[held])
    return precision, where + step
