# SPDX-License-Identifier: Apache-2.0
"""Objectives of tasks as objectives of joints."""

import numpy as np
import pytest

from random_problems import random_covariance
from tpgmm_core.kinematics.joint_space import to_joint_space


def test_the_reference_is_best_for_all_tasks_together() -> None:
    rng = np.random.default_rng(0)
    q = rng.normal(size=7)
    precisions = [random_covariance(rng, D) for D in (6, 3)]
    jacobians, errors = [rng.normal(size=(D, 7)) for D in (6, 3)], [rng.normal(size=D) for D in (6, 3)]
    precision, reference = to_joint_space(precisions, jacobians, errors, q)

    def cost(joints: np.ndarray) -> float:
        left = [e - J @ (joints - q) for e, J in zip(errors, jacobians, strict=True)]
        return float(sum(e @ L @ e for e, L in zip(left, precisions, strict=True)))

    step = rng.normal(size=7)
    # a quadratic function with this precision, at its minimum
    assert cost(reference + step) - cost(reference) == pytest.approx(step @ precision @ step, rel=1e-9)
    assert cost(reference + 1e-3 * step) > cost(reference)


def test_what_no_task_constrains_stays_and_has_no_precision() -> None:
    rng = np.random.default_rng(1)
    J, q = rng.normal(size=(3, 7)), rng.normal(size=7)
    precision, reference = to_joint_space([np.diag([1e4, 1e3, 1e2])], [J], [np.full(3, 0.1)], q)
    free = np.linalg.svd(J)[2][3:]
    np.testing.assert_allclose(free @ precision @ free.T, 0.0, atol=1e-9 * np.abs(precision).max())
    np.testing.assert_allclose(free @ (reference - q), 0.0, atol=1e-12)
    np.testing.assert_allclose(J @ (reference - q), 0.1, rtol=1e-9)


@pytest.mark.parametrize(
    ("precisions", "jacobians", "errors", "message"),
    [
        ([], [], [], "one or more tasks"),
        ([np.eye(2)], [np.ones((2, 3))], [], "one precision, Jacobian and error"),
        ([np.eye(2)], [np.ones((2, 4))], [np.ones(2)], r"Jacobian \(D, 3\)"),
        ([np.eye(2)], [np.full((2, 3), np.inf)], [np.ones(2)], "finite"),
    ],
)
@pytest.mark.filterwarnings("ignore:invalid value:RuntimeWarning")
def test_bad_input_is_refused(precisions: list, jacobians: list, errors: list, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        to_joint_space(precisions, jacobians, errors, np.zeros(3))
