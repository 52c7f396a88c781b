# SPDX-License-Identifier: Apache-2.0
"""A hand that is grabbed and let go of: a correction begins and ends by itself, and what cannot be known is said."""

from __future__ import annotations

from concurrent.futures import Future
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from tpgmm_core.control.yielding import HELD
from tpgmm_core.observation.external_torques import MeasuredForce
from tpgmm_core.observation.touch import FREE_TIME, HOLD_TIME, RELEASE_TIME, Touch
from tpgmm_workbench.desk import coaching
from tpgmm_workbench.desk.coaching import Coaching
from tpgmm_workbench.desk.view import DeskView
from tpgmm_workbench.graph.movement import RunView
from tpgmm_workbench.page import robot_words
from tpgmm_workbench.project.activities import Activity
from tpgmm_workbench.project.coach import Run
from tpgmm_workbench.session.view import ControllerView, GraphView

THRESHOLD, PERIOD = 15.0, 0.03
HAND = np.array([0.6, 0.2, 0.1, 0.0, 1.0, 0.0, 0.0])


class Clock:
    """Goes on by itself, each time that it is asked."""

    def __init__(self) -> None:
        self.now = 100.0

    def monotonic(self) -> float:
        self.now += PERIOD
        return self.now


def states(touch: Touch, forces: list[tuple[float | None, float]], now: float = 0.0) -> list[bool]:
    """Whether the hand is held after each force, which lasts for so many s."""
    held = []
    for force, lasts in forces:
        end = now + lasts
        while now < end:
            touch.take(now, force)
            now += PERIOD
        held.append(touch.is_held)
    return held


def test_a_force_that_lasts_is_a_hold_until_it_is_gone_for_a_while() -> None:
    touch = Touch(THRESHOLD)
    free, knock, hold = (2.0, 2.0 * FREE_TIME), (40.0, 0.5 * HOLD_TIME), (20.0, 2.0 * HOLD_TIME)
    wavers, slips = (9.0, 2.0 * RELEASE_TIME), (2.0, 0.5 * RELEASE_TIME)
    assert states(touch, [free, knock, free, hold, wavers, slips, hold, (2.0, 2.0 * RELEASE_TIME)]) == [
        False, False, False, True, True, True, True, False,
    ]  # fmt: skip


def test_a_push_from_the_beginning_is_a_weight_or_a_bad_measurement_and_no_hold() -> None:
    touch = Touch(THRESHOLD)
    assert states(touch, [(25.0, 5.0), (9.0, 5.0), (25.0, 5.0)]) == [False] * 3 and not touch.is_ready
    assert states(touch, [(2.0, 2.0 * FREE_TIME), (25.0, 1.0)], now=100.0) == [False, True]


@pytest.mark.parametrize(("threshold", "force"), [(0.0, 100.0), (THRESHOLD, None)])
def test_nobody_holds_a_hand_that_is_not_felt(threshold: float, force: float | None) -> None:
    touch = Touch(threshold)
    assert states(touch, [(0.0, 1.0), (force, 5.0)]) == [False, False] and not touch.is_ready


def test_what_is_known_stops_with_what_is_measured() -> None:
    touch = Touch(THRESHOLD)
    assert states(touch, [(1.0, 1.0), (25.0, 1.0), (None, 0.1)]) == [False, True, False] and not touch.is_ready


class Background:
    def run(self, work: Any, then: Any) -> None:
        job: Future[Any] = Future()
        try:
            job.set_result(work())
        except ValueError as error:
            job.set_exception(error)
        then(job)


class Project:
    model = None


class Watched:
    """A run that goes on and on, whose hand is held as one says."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch, threshold: float = THRESHOLD, feels: bool = False) -> None:
        self.said: list[str] = []
        self.corrected: list[Run] = []
        monkeypatch.setattr(coaching, "time", Clock())
        monkeypatch.setattr(coaching, "correct", lambda _, run: self.corrected.append(run) or _fail())
        self.coaching = Coaching(Project(), Background(), self.said.append, lambda: None, feels, threshold)  # type: ignore[arg-type]
        self.phase = 0.0

    def go(self, seconds: float, force: float | None, stage: str = "running", says: str = "") -> None:
        for _ in range(round(seconds / PERIOD)):
            self.phase = min(1.0, self.phase + 0.002)
            view = MeasuredForce(why="no effort") if force is None else MeasuredForce(force, "joint torques")
            self.coaching.watch(
                RunView(stage, self.phase),
                GraphView(hand=HAND, force=view, controller=ControllerView("HOLD", says)),
                False,
            )


def _fail() -> None:
    raise ValueError("enough is known")


def test_a_correction_begins_where_the_hand_is_grabbed_and_is_what_it_was_led_to(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    run = Watched(monkeypatch)
    run.go(3.0, 2.0)
    assert not run.coaching.is_on and not run.said
    run.go(2.0, 22.0)
    assert run.coaching.is_on and "held (more than 15 N)" in run.coaching.words and len(run.said) == 1
    began = run.phase
    run.go(2.0, 2.0)
    assert not run.coaching.is_on and "let go of" in run.said[-1]
    run.go(1.0, 2.0, stage="done")
    (found,) = run.corrected
    assert found.is_led is not None and found.phases is not None
    led = found.phases[found.is_led]
    assert len(led) > 10 and led[0] < began - 0.1 and led[-1] == pytest.approx(began, abs=0.004)
    run.phase = 0.0
    run.go(2.0, 2.0)
    run.go(1.0, 2.0, stage="done")
    assert len(run.corrected) == 1, "a run in which nobody takes hold of the hand corrects nothing"


def test_an_arm_that_yields_is_held_as_its_controller_says_with_less_force_than_it_took(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    run = Watched(monkeypatch)
    run.go(1.0, 1.0)
    run.go(1.0, 9.0)
    assert not run.coaching.is_on
    run.go(1.0, 9.0, says=f"{HELD} 15 N: the arm is soft")
    assert run.coaching.is_on
    run.go(1.0, 9.0)
    assert run.coaching.is_on
    run.go(2.0, 1.0)
    assert not run.coaching.is_on and "let go of" in run.said[-1]


def test_a_correction_that_was_asked_for_ends_when_that_is_asked_for(monkeypatch: pytest.MonkeyPatch) -> None:
    run = Watched(monkeypatch)
    run.go(1.0, 1.0)
    run.coaching.begin()
    run.go(1.0, 22.0)
    run.go(3.0, 1.0)
    assert run.coaching.is_on
    run.coaching.end()
    run.go(1.0, 1.0)
    assert not run.coaching.is_on
    run.go(1.0, 22.0)
    assert run.coaching.is_on
    run.coaching.end()  # who ends it while the hand is still held has to let go of it first
    run.go(3.0, 22.0)
    assert not run.coaching.is_on


@pytest.mark.parametrize(("threshold", "force"), [(0.0, 90.0), (THRESHOLD, None)])
def test_nothing_begins_by_itself_where_it_is_off_or_cannot_be_known(
    monkeypatch: pytest.MonkeyPatch, threshold: float, force: float | None
) -> None:
    run = Watched(monkeypatch, threshold)
    run.go(1.0, None if force is None else 0.0)
    run.go(3.0, force)
    assert not run.coaching.is_on and not run.said


def test_it_is_told_how_hard_the_hand_is_pushed_and_why_that_cannot_be_known() -> None:
    told = MeasuredForce(7.4, "joint torques")
    view = DeskView(graph=GraphView(force=told), coach_force=THRESHOLD, activity=Activity.RUNNING)
    assert "below 8 N before" in robot_words.force(view)
    view = replace(view, may_grab=True)
    assert "7 N, by joint torques" in robot_words.force(view) and "15 N begin a correction" in robot_words.force(view)
    unknown = replace(view, graph=GraphView(force=MeasuredForce(why="effort is <b>empty</b>")))
    assert "cannot be known: effort is &lt;b&gt;" in robot_words.force(unknown)
    assert robot_words.force(replace(view, coach_force=0.0)) == "" == robot_words.force(DeskView(coach_force=9.0))
