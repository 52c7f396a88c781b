# SPDX-License-Identifier: Apache-2.0
"""Which motions are swings that do not settle, and which are none."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from tpgmm_core.control.oscillation import SwingWatch

LIMITS = np.array([2.0, 4.0])


def alarm(speed: Callable[[float], float], moves: float = 0.0, asked: float = 0.0, seconds: float = 4.0) -> float:
    """Time of the first alarm about the second joint, s; infinite without one. The first joint stands still."""
    watch = SwingWatch(LIMITS)
    for tick in range(round(1e3 * seconds)):
        if watch.step(np.array([0.0, LIMITS[1] * speed(1e-3 * tick)]), moves, asked, 0.001):
            assert watch.joint == 1
            return 1e-3 * tick
    return float("inf")


@pytest.mark.parametrize("frequency", [1.5, 5.0, 20.0])
def test_swings_that_grow_are_an_alarm_when_they_are_large_enough(frequency: float) -> None:
    at = alarm(lambda t: 0.02 * np.exp(frequency * t) * np.sin(2.0 * np.pi * frequency * t))
    # 0.15 of the limit is reached after 2 swings; half a swing later it is known
    assert 1.5 / frequency < at < 3.0 / frequency


def test_the_time_of_half_a_swing_is_told() -> None:
    watch = SwingWatch(LIMITS)
    for tick in range(2000):
        if watch.step(
            np.array([0.0, 0.3 * np.exp(1e-3 * tick) * np.sin(2.0 * np.pi * 4.0 * 1e-3 * tick)]), 0.0, 0.0, 0.001
        ):
            break
    assert watch.half_period == pytest.approx(0.125, abs=0.01)


def test_swings_that_do_not_die_out_are_an_alarm() -> None:
    assert alarm(lambda t: 0.5 * np.sin(2.0 * np.pi * 4.0 * t)) < 1.5


@pytest.mark.parametrize(
    "name, speed",
    [
        ("a push, damped as an LQR does", lambda t: 0.9 * np.exp(-20.0 * t) * np.sin(20.0 * t)),
        ("a swing that dies out slowly", lambda t: 0.9 * 0.7 ** (8.0 * t) * np.sin(2.0 * np.pi * 4.0 * t)),
        ("noise", lambda t: 0.02 * np.sin(1e7 * t)),
        ("small swings", lambda t: 0.1 * np.sin(2.0 * np.pi * 4.0 * t)),
        ("to and fro, slowly", lambda t: 0.8 * np.sin(2.0 * np.pi * 0.8 * t)),
        ("one way", lambda t: 0.8 * np.sin(2.0 * np.pi * 4.0 * t) ** 2),
    ],
)
def test_other_motions_are_none(name: str, speed: Callable[[float], float]) -> None:
    assert alarm(speed) == float("inf")


def test_a_reference_may_ask_for_swings() -> None:
    def shakes(t: float) -> float:
        return float(0.5 * np.sin(2.0 * np.pi * 3.0 * t))

    assert alarm(shakes, moves=1.0, asked=0.8) == float("inf")
    assert alarm(shakes, moves=1.0, asked=0.1) < 2.0
    assert alarm(shakes, moves=0.0, asked=0.0) < 2.0  # in the null space, which the hand does not feel
