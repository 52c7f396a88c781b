# SPDX-License-Identifier: Apache-2.0
"""What a signal said last holds for ever where it is said on change, and not where it was said all the time before."""

from __future__ import annotations

import pytest

from tpgmm_core.observation.signals import PAUSE, STEADY, SignalWatch
from tpgmm_core.observation.streams import SECOND


def heard(said: list[tuple[float, bool]]) -> SignalWatch:
    watch = SignalWatch()
    for seconds, value in said:
        watch.hear(value, round(SECOND * (100.0 + seconds)))
    return watch


def ceased(watch: SignalWatch, seconds: float) -> bool:
    return watch.has_ceased(round(SECOND * (100.0 + seconds)))


def all_the_time(rate: float, seconds: float) -> list[tuple[float, bool]]:
    return [(step / rate, True) for step in range(round(rate * seconds) + 1)]


@pytest.mark.parametrize("rate", [2.0, 30.0, 1000.0])
def test_one_that_comes_all_the_time_has_ceased_after_a_pause_and_goes_on_when_it_is_back(rate: float) -> None:
    watch = heard(all_the_time(rate, 6.0))
    assert not ceased(watch, 6.0 + 0.9 * PAUSE)
    assert ceased(watch, 6.0 + 1.1 * PAUSE)
    watch.hear(True, round(SECOND * 120.0))
    assert not ceased(watch, 20.5) and ceased(watch, 21.5)


@pytest.mark.parametrize(
    "said",
    [
        [],
        [(0.0, True)],
        [(10.0 * step, step % 2 == 0) for step in range(100)],
        [(0.1 * step, step % 2 == 0) for step in range(100)],
        all_the_time(100.0, 0.8 * STEADY),
        [(1.5 * step, True) for step in range(100)],
    ],
    ids=["nothing", "once", "on change", "on fast changes", "as long as it moves", "seldom"],
)
def test_one_that_is_not_said_all_the_time_holds_for_ever(said: list[tuple[float, bool]]) -> None:
    assert not ceased(heard(said), 1e5)
