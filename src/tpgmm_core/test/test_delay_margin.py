# SPDX-License-Identifier: Apache-2.0
"""Delay margins, against a simulation of the delayed loop that knows nothing of them."""

from __future__ import annotations

import math

import numpy as np
import pytest

from tpgmm_core.control.delay_margin import (
    DELAY_SAFETY,
    OF_CRITICAL,
    OF_DAMPING,
    borne_share,
    delay_margin,
    fastest_rate,
    joint_damping,
)
from tpgmm_core.lqr.double_integrator import double_integrator_gains


def grows(k: float, d: float, delay: float, periods: float = 40.0) -> bool:
    """Whether `a = -k x(t - T) - d v(t - T)` swings more and more: by simulation in small steps."""
    dt = delay / 200.0
    steps = int(periods * 2.0 * math.pi / (max(d, math.sqrt(k)) * dt))
    x, v = np.zeros(steps + 201), np.zeros(steps + 201)
    x[:201], v[:201] = 1.0, 0.1
    for t in range(200, steps + 200):
        a = -k * x[t - 200] - d * v[t - 200]
        v[t + 1] = v[t] + dt * a
        x[t + 1] = x[t] + dt * v[t + 1]
    quarter = steps // 4
    return bool(np.abs(v[-quarter:]).max() > np.abs(v[200 : 200 + quarter]).max())


@pytest.mark.parametrize("k, d", [(0.0, 40.0), (400.0, 40.0), (2500.0, 70.7), (40.0, 4.0), (5.0, 2.0)])
def test_a_loop_swings_beyond_its_margin_and_not_below_it(k: float, d: float) -> None:
    margin = delay_margin(k, d)
    assert not grows(k, d, 0.95 * margin)
    assert grows(k, d, 1.05 * margin)


def test_pure_and_critical_damping_have_their_closed_forms() -> None:
    assert delay_margin(0.0, 10.0) == pytest.approx(OF_DAMPING / 10.0)
    assert delay_margin(25.0, 10.0) == pytest.approx(OF_CRITICAL / 10.0, rel=1e-4)
    assert delay_margin(0.0, 0.0) == math.inf


@pytest.mark.parametrize("share", [0.9, 0.5, 0.1])
def test_slower_in_time_bears_a_delay_that_is_as_many_times_as_long(share: float) -> None:
    assert delay_margin(share**2 * 700.0, share * 37.0) == pytest.approx(delay_margin(700.0, 37.0) / share)


def test_the_share_leaves_half_of_the_margin_and_is_one_for_what_is_in_time() -> None:
    assert borne_share(0.015, 0.002) == 1.0
    assert borne_share(0.015, 0.0) == 1.0
    share = borne_share(0.015, 0.03)
    assert 0.015 / share == pytest.approx(DELAY_SAFETY * 0.03)


def test_the_fastest_rate_is_the_largest_eigenvalue_of_the_gains() -> None:
    rng = np.random.default_rng(3)
    A = rng.normal(size=(6, 6))
    cost = 0.02 * np.array([1.0, 1.0, 1.0, 0.09, 0.09, 0.09])
    gains = double_integrator_gains(A @ A.T + np.eye(6), cost)
    expected = np.linalg.eigvals(gains.damping).real.max()
    assert fastest_rate(gains.damping, 0.3) == pytest.approx(expected, rel=1e-9)


@pytest.mark.parametrize("delay", [0.0, 0.003, 0.03, 0.1])
def test_damping_of_joints_that_move_each_other_bears_the_delay_together(delay: float) -> None:
    rng = np.random.default_rng(0)
    for _ in range(50):
        A = rng.normal(size=(7, 7)) * 10.0 ** rng.uniform(-2, 1, size=7)[:, None]
        M = A @ A.T + 1e-3 * np.eye(7)
        inverse, out = np.linalg.inv(M), np.empty(7)
        mass = 1.0 / np.diag(inverse)
        joint_damping(2.0, 50.0, mass, inverse, delay, out)
        assert (out > 0.0).all() and (out <= 2.0).all()
        fastest = np.linalg.eigvals(inverse * out).real.max()
        assert fastest * DELAY_SAFETY * delay <= OF_DAMPING * (1.0 + 1e-9)
