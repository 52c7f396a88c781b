# SPDX-License-Identifier: Apache-2.0
"""A movement waits for an arm that was let go of, and neither for ever nor against what the user says."""

from __future__ import annotations

import numpy as np
import pytest

from tpgmm_workbench.desk import pace
from tpgmm_workbench.desk.pace import FAR, NEAR, PATIENCE, Pace
from tpgmm_workbench.graph.movement import RunView
from tpgmm_workbench.session.view import GraphView, ReferenceView

HAND = np.array([0.6, 0.2, 0.1, 0.0, 1.0, 0.0, 0.0])
RUNS = RunView("running", 0.4)


class Movement:
    def __init__(self) -> None:
        self.speeds: list[float] = []

    def set_speed(self, speed: float) -> None:
        self.speeds.append(speed)


class Clock:
    now = 100.0

    def monotonic(self) -> float:
        return self.now


@pytest.fixture
def clock(monkeypatch: pytest.MonkeyPatch) -> Clock:
    clock = Clock()
    monkeypatch.setattr(pace, "time", clock)
    return clock


def away(distance: float) -> GraphView:
    reference = HAND.copy()
    reference[0] += distance
    return GraphView(hand=HAND, reference=ReferenceView(reference, np.eye(6)))


def let_go(distance: float, speed: float = 0.5) -> tuple[Pace, Movement]:
    """Of an arm so far from its reference, m."""
    movement = Movement()
    found = Pace(movement)  # type: ignore[arg-type]
    found.set(speed)
    found.begin()
    found.watch(RUNS, away(distance), True)
    found.watch(RUNS, away(distance), False)
    assert movement.speeds[:2] == [speed, speed]
    del movement.speeds[:2]
    return found, movement


def test_time_stands_still_until_the_arm_is_back_and_goes_on_as_the_user_says(clock: Clock) -> None:
    found, movement = let_go(0.4)
    assert movement.speeds == [0.0] and found.is_waiting and "40 cm to go" in found.words and found.speed == 0.5
    for distance in np.arange(0.4, NEAR, -0.01):
        clock.now += 0.9 * PATIENCE  # slow, but it comes
        found.watch(RUNS, away(float(distance)), False)
    assert movement.speeds == [0.0]
    found.watch(RUNS, GraphView(), False)  # nothing is known for a moment
    assert found.is_waiting
    found.watch(RUNS, away(0.9 * NEAR), False)
    assert movement.speeds == [0.0, 0.5] and not found.is_waiting and not found.words


def test_an_arm_that_does_not_come_back_is_not_waited_for(clock: Clock) -> None:
    found, movement = let_go(0.4)
    clock.now += 1.1 * PATIENCE
    found.watch(RUNS, away(0.399), False)
    assert movement.speeds == [0.0, 0.5] and "40 cm are left" in found.words
    found.watch(RUNS, away(0.399), False)
    assert movement.speeds == [0.0, 0.5]


def test_an_arm_that_is_near_or_that_nobody_led_is_not_waited_for(clock: Clock) -> None:
    found, movement = let_go(0.9 * FAR)
    found.watch(RUNS, away(0.4), False)  # it lags: nobody led it
    assert not movement.speeds and not found.words


@pytest.mark.parametrize("what", ["pause", "speed", "grab", "end"])
def test_what_the_user_says_ends_the_waiting(clock: Clock, what: str) -> None:
    found, movement = let_go(0.4)
    if what == "pause":
        found.pause()
        assert found.is_paused and movement.speeds[-1] == 0.0
    elif what == "speed":
        found.set(-1.0)
    elif what == "grab":
        found.watch(RUNS, away(0.4), True)
    else:
        found.watch(RunView("stopped", 0.4), away(0.4), False)
    assert not found.is_waiting
    count = len(movement.speeds)
    found.watch(RUNS if what != "end" else RunView("stopped", 0.4), away(0.01), what == "grab")
    assert len(movement.speeds) == count
    if what == "pause":
        found.watch(RUNS, away(0.4), True)
        found.watch(RUNS, away(0.4), False)
        assert not found.is_waiting, "a pause is a pause"
