# SPDX-License-Identifier: Apache-2.0
"""Each stage between a law of control and the motors, alone."""

import numpy as np
import pytest

from tpgmm_core.control.torque_limits import (
    approach_speed,
    blend,
    clamp_at_limits,
    finite,
    fit,
    injected_power,
    keep_within,
    limit_power,
    repel,
    torque_bounds,
)

ONE = np.ones(1)


def test_nan_and_infinity_are_found() -> None:
    assert finite(np.zeros(2)) and not finite(np.array([0.0, np.nan]))
    assert not finite(np.array([-np.inf, 0.0]))


@pytest.mark.parametrize(("share", "expected"), [(0.0, 2.0), (0.25, 4.0), (1.0, 10.0)])
def test_the_blend_leads_from_the_safe_torque_to_the_wanted_one(share: float, expected: float) -> None:
    tau = np.array([10.0])
    blend(tau, np.array([2.0]), share)
    assert tau[0] == pytest.approx(expected)


@pytest.mark.parametrize(
    ("distance", "speed"), [(1.0, 2.0), (0.2, 2.0), (0.1, 1.0), (0.0, 0.0), (-0.1, -1.0), (-9.0, -2.0), (np.inf, 2.0)]
)
def test_towards_a_limit_a_joint_slows_down_and_beyond_it_it_comes_back(distance: float, speed: float) -> None:
    assert approach_speed(distance, 2.0, 10.0) == pytest.approx(speed)


def clamped(tau: float, q: float, v: float, nonlinear: float = 0.0) -> float:
    """One joint of 2 kg m^2 between -1 and 1 rad, 2 rad/s, 50 N m."""
    torque = np.array([tau])
    limits = -ONE, ONE, 2.0 * ONE, 50.0 * ONE
    clamp_at_limits(torque, q * ONE, v * ONE, nonlinear * ONE, 2.0 * ONE, *limits, 10.0, 100.0)
    return float(torque[0])


@pytest.mark.parametrize("tau", [-50.0, 0.0, 50.0])
@pytest.mark.parametrize("nonlinear", [-40.0, 0.0, 40.0])
def test_at_rest_far_from_its_limits_a_joint_gets_all_its_effort(tau: float, nonlinear: float) -> None:
    assert clamped(tau, 0.0, 0.0, nonlinear) == tau


def test_no_torque_drives_a_joint_into_its_limit_nor_beyond_its_speed() -> None:
    assert clamped(50.0, 1.0, 0.0) == 0.0  # at the limit
    assert clamped(50.0, 1.0, 0.0, nonlinear=7.0) == 7.0  # but its weight is carried
    assert clamped(-50.0, 1.0, 0.0) == -50.0  # and it may leave
    assert clamped(50.0, 0.0, 2.0) == 0.0
    assert clamped(-50.0, 0.0, -2.0) == 0.0
    assert clamped(0.0, 0.0, 2.1) == pytest.approx(-2.0 * 100.0 * 0.1)  # braked
    assert clamped(0.0, 0.95, 1.0) == pytest.approx(-2.0 * 100.0 * 0.5)  # too fast for the way that is left


def test_a_joint_that_is_driven_with_all_its_might_stops_before_its_limit() -> None:
    q, v, dt, mass = 0.0, 0.0, 0.001, 2.0
    fastest = 0.0
    for _ in range(3000):
        v += dt * clamped(50.0, q, v) / mass
        q += dt * v
        fastest = max(fastest, v)
    assert 0.99 < q <= 1.0
    assert 1.5 < fastest <= 2.0 + 1e-9


def repelled(q: float, v: float = 0.0, lower: float = -1.0, upper: float = 1.0) -> float:
    torque = np.zeros(1)
    repel(torque, q * ONE, v * ONE, 2.0 * ONE, lower * ONE, upper * ONE, 0.05, 20.0)
    return float(torque[0])


def test_repulsion_grows_within_the_margin_and_is_nowhere_else() -> None:
    assert repelled(0.0) == repelled(0.95) == repelled(-0.95) == 0.0
    assert repelled(1.0) == pytest.approx(-2.0 * 400.0 * 0.05)
    assert repelled(-1.0) == pytest.approx(2.0 * 400.0 * 0.05)
    assert repelled(0.975) == pytest.approx(0.5 * repelled(1.0))
    assert repelled(5.0) == repelled(1.0)  # what lies far beyond is not shot back
    assert repelled(0.95, lower=-np.inf, upper=np.inf) == 0.0


def test_repulsion_pushes_only_and_a_joint_leaves_the_margin_slowly() -> None:
    assert repelled(1.0, v=-10.0) == 0.0
    q, v, dt = 1.0, 0.0, 0.001
    for _ in range(2000):
        v += dt * repelled(q, v) / 2.0
        q += dt * v
    assert q < 0.951
    assert abs(v) < 0.4 * 20.0 * 0.05  # an undamped spring would throw it out at frequency times depth


def test_the_margin_is_a_tenth_of_a_short_range() -> None:
    assert repelled(0.002, lower=0.0, upper=0.02) == 0.0
    assert repelled(0.001, lower=0.0, upper=0.02) > 0.0


def test_effort_and_rate_are_one_interval_that_is_never_empty() -> None:
    low, high = np.empty(4), np.empty(4)
    previous = np.array([np.nan, 0.0, 9.5, 30.0])  # the last one cannot have left: its limit has been lowered since
    torque_bounds(np.full(4, 10.0), previous, np.full(4, 1.0), low, high)
    np.testing.assert_allclose(low, [-10.0, -1.0, 8.5, 9.0])
    np.testing.assert_allclose(high, [10.0, 1.0, 10.0, 10.0])
    torque_bounds(np.full(4, 10.0), previous, np.zeros(4), low, high)
    np.testing.assert_allclose(low[1:], high[1:])


def test_torques_within_their_bounds_pass_and_others_are_brought_there() -> None:
    tau = np.array([-9.0, 1.0, 9.0])
    assert keep_within(tau, np.array([-5.0, -5.0, -5.0]), np.array([5.0, 5.0, 2.0]))
    np.testing.assert_array_equal(tau, [-5.0, 1.0, 2.0])
    assert not keep_within(tau, np.full(3, -5.0), np.full(3, 5.0))


WIDE = -np.full(3, 100.0), np.full(3, 100.0)


def test_power_is_limited_in_proportion_and_what_brakes_or_carries_is_left_alone() -> None:
    tau, v, weight = np.array([30.0, 20.0, -10.0]), np.array([1.0, 1.0, 1.0]), np.array([10.0, 0.0, 0.0])
    assert injected_power(tau, v, weight) == pytest.approx(30.0)
    assert limit_power(tau, v, weight, 10.0, *WIDE)
    np.testing.assert_allclose(tau, [20.0, 10.0, -10.0])
    assert injected_power(tau, v, weight) == pytest.approx(10.0)
    assert not limit_power(tau, v, weight, 10.1, *WIDE)


def test_lifting_its_own_weight_costs_a_robot_no_power() -> None:
    tau = np.array([40.0])
    assert not limit_power(tau, 5.0 * ONE, np.array([40.0]), 1.0, *(bound[:1] for bound in WIDE))
    assert tau[0] == 40.0


def test_the_rate_wins_over_the_power_limit() -> None:
    tau, v = np.array([50.0, 30.0]), np.ones(2)
    low, high = np.array([48.0, -50.0]), np.array([50.0, 50.0])
    assert limit_power(tau, v, np.zeros(2), 60.0, low, high)
    assert (tau >= low).all()
    assert tau.sum() == pytest.approx(60.0)  # the joint that may yields more
    tau = np.array([50.0, 30.0])
    limit_power(tau, v, np.zeros(2), 10.0, low, high)
    np.testing.assert_allclose(tau, [48.0, 0.0])  # as little as the bounds permit


@pytest.mark.parametrize(
    ("wanted", "given", "share"),
    [
        ([1.0, -1.0], [0.0, 0.0], 1.0),
        ([20.0, 1.0], [0.0, 0.0], 0.5),
        ([20.0, 1.0], [5.0, 0.0], 0.25),
        ([-20.0, 1.0], [5.0, 0.0], 0.75),
        ([0.0, 0.0], [12.0, 0.0], 1.0),
        ([1.0, 20.0], [12.0, 0.0], 0.5),  # the first joint is past helping and must not hold up the second
    ],
)
def test_fit_is_the_largest_share_within_the_limits(wanted: list, given: list, share: float) -> None:
    assert fit(np.array(wanted), np.array(given), np.array([10.0, 10.0])) == pytest.approx(share)
