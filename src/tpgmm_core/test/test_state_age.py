# SPDX-License-Identifier: Apache-2.0
"""How late states are taken for, by their stamps."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from tpgmm_core.control.state_age import MOST_SUSPECTED, StateAge

MS = 1_000_000
START = 1_000_000 * MS


def told(ages_ms: Callable[[int], float], count: int, period_ms: int = 1) -> StateAge:
    """After so many states of these ages."""
    age = StateAge()
    for k in range(count):
        stamp_ns = START + k * period_ms * MS
        age.take(stamp_ns, stamp_ns + round(ages_ms(k) * MS))
    return age


def test_states_that_become_old_count_within_some_ten_milliseconds() -> None:
    assert told(lambda k: 0.5 if k < 1000 else 30.0, 1040).usual > 0.025


def test_one_late_state_hardly_counts_and_is_forgotten() -> None:
    late = told(lambda k: 30.0 if k == 500 else 0.5, 501)
    assert late.usual < 0.0025
    assert told(lambda k: 30.0 if k == 500 else 0.5, 4000).usual < 0.0006


def test_jitter_counts_with_its_late_part() -> None:
    ages = 20.0 + np.random.default_rng(0).uniform(-10.0, 10.0, 3000)
    assert 0.025 < told(lambda k: ages[k], 3000).usual < 0.03


@pytest.mark.parametrize("period_ms", [1, 2, 20])
def test_the_delay_of_the_loop_is_age_period_and_what_lies_before_the_motors(period_ms: int) -> None:
    age = told(lambda k: 10.0, 600, period_ms)
    assert age.delay(0.002) == pytest.approx(0.010 + 0.002 + 1e-3 * period_ms, rel=1e-3)


def test_of_clocks_that_cannot_be_compared_no_age_is_guessed() -> None:
    age = StateAge()
    age.take(START, 0)  # that of the stamps is not known
    assert age.age is None and age.usual == 0.0
    age.take(START + MS, 10**18, of_another_clock=True)
    assert age.age is None and age.usual == 0.0
    age.take(START + 2 * MS, START)  # a little ahead
    assert age.age == 0.0


def test_what_swings_tell_of_doubles_with_each_time_up_to_a_bound_and_is_forgotten() -> None:
    age = told(lambda k: 0.5, 100)
    age.suspect(0.02)
    assert age.delay(0.0) == pytest.approx(0.021, rel=1e-2)
    age.suspect(0.02)
    assert age.suspected == pytest.approx(0.04)
    age.suspect(10.0)
    assert age.suspected == MOST_SUSPECTED
    for k in range(100, 90_000):
        age.take(START + k * MS, START + k * MS)
    assert age.suspected < 0.06
