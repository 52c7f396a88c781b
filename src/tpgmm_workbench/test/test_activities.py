# SPDX-License-Identifier: Apache-2.0
"""What may be done when: each answer is a reason in words, or none."""

from __future__ import annotations

from dataclasses import replace

import pytest

from tpgmm_workbench.project.activities import Action, Activity, Facts, may

READY = Facts(demonstrations=3, has_model=True, can_undo=True)


def test_a_newcomer_is_led_from_teaching_to_running() -> None:
    fresh = Facts()
    assert may("record", fresh) == ""
    assert "show 2 more" in may("train", fresh)
    assert "show 1 more" in may("train", replace(fresh, demonstrations=1))
    assert may("train", replace(fresh, demonstrations=2)) == ""
    assert "train one first" in may("run", replace(fresh, demonstrations=2))
    assert may("run", READY) == may("preview", READY) == may("undo", READY) == ""
    assert may("redo", READY) == "nothing was undone" and may("redo", replace(READY, can_redo=True)) == ""


@pytest.mark.parametrize("activity", Activity)
@pytest.mark.parametrize("drives", [True, False])
def test_stop_may_always_be_pressed_from_every_page(activity: Activity, drives: bool) -> None:
    facts = Facts(activity, has_robot=False, missing_frames=("object",), fault="broken", drives=drives)
    assert may(Action.STOP, facts) == ""


@pytest.mark.parametrize(
    ("facts", "words"),
    [
        (replace(READY, activity=Activity.TEACHING), "being recorded"),
        (replace(READY, missing_frames=("object",)), "not seen: object"),
        (replace(READY, has_robot=False), "no joint states"),
        (replace(READY, fault="the state is too old"), "the state is too old"),
        (replace(READY, drives=False), "another page drives"),
        (replace(READY, is_read=False, has_model=False), "still being read"),
    ],
)
def test_running_is_refused_with_the_reason(facts: Facts, words: str) -> None:
    assert words in may("run", facts)


def test_what_only_a_simulator_has_is_offered_only_there() -> None:
    assert may("drag_hand", READY) == ""
    assert "lead the real arm" in may("drag_hand", replace(READY, is_simulated=False))


def test_a_paused_movement_goes_on_and_a_running_one_may_be_corrected() -> None:
    running = replace(READY, activity=Activity.RUNNING)
    assert may("run", replace(READY, activity=Activity.PAUSED)) == ""
    assert "end that first" in may("run", running)
    assert may("coach", running) == may("pause", running) == ""
    assert "only while" in may("coach", READY)
    assert may("end_coaching", replace(READY, activity=Activity.COACHING)) == ""
