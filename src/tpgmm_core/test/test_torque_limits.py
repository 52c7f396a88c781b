# SPDX-License-Identifier: Apache-2.0
import numpy as np
import pytest

from tpgmm_core.torque_limits import all_finite, clamp, fit, limit_rate


def test_nan_and_infinity_are_found_in_any_array() -> None:
    assert all_finite(np.zeros(2), np.ones(3))
    assert not all_finite(np.zeros(2), np.array([0.0, np.nan]))
    assert not all_finite(np.array([-np.inf]), np.zeros(2))


def test_clamp_keeps_each_torque_within_its_limit() -> None:
    np.testing.assert_array_equal(clamp(np.array([-9.0, 1.0, 9.0]), np.array([5.0, 5.0, 2.0])), [-5.0, 1.0, 2.0])


def test_rate_limit_lets_slow_changes_pass_unchanged_and_shortens_fast_ones() -> None:
    previous, rate = np.array([0.1, 0.2, 0.3]), np.array([10.0, 10.0, 100.0])
    limited = limit_rate(np.array([0.1 + 1e-4, -5.0, 5.0]), previous, rate, dt=0.01)
    np.testing.assert_array_equal(limited, [0.1 + 1e-4, 0.2 - 0.1, 0.3 + 1.0])
    np.testing.assert_array_equal(limit_rate(np.ones(3), previous, rate, dt=0.0), previous)


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
