# SPDX-License-Identifier: Apache-2.0
"""What a controller does about the age and the validity of its inputs."""

from __future__ import annotations

import math

import pytest

from tpgmm_core.control.supervision import ControllerMode, Inputs, Stamp, StreamWatch, Timeouts, decide

TIMEOUTS = Timeouts(joint_state_timeout=0.02, silence_after=0.2, reference_timeout=0.1, hold_time=1.0)
WAITING, ACTIVE, HOLD, DAMPING, FAULT = ControllerMode
MS = 1_000_000


@pytest.mark.parametrize(
    ("inputs", "mode", "reason", "sends"),
    [
        (Inputs(None, "", None, ""), WAITING, "no joint state yet", False),
        (Inputs(None, "", 0.0, ""), WAITING, "no joint state yet", False),
        (Inputs(0.0, "", None, ""), DAMPING, "no reference yet", True),
        (Inputs(0.0, "", None, "not finite"), DAMPING, "refused: not finite", True),
        (Inputs(0.0, "", 0.0, ""), ACTIVE, "following", True),
        (Inputs(0.02, "", 0.1, ""), ACTIVE, "following", True),
        (Inputs(0.0, "", 0.05, "not finite"), ACTIVE, "following", True),
        (Inputs(0.0, "", 0.11, ""), HOLD, "no reference for 0.1 s", True),
        (Inputs(0.0, "", 1.1, "not finite"), HOLD, "refused: not finite", True),
        (Inputs(0.0, "", 1.11, ""), DAMPING, "no reference for 1.1 s", True),
        (Inputs(0.0, "", math.inf, ""), DAMPING, "no reference for 1.1 s", True),
        (Inputs(0.021, "", 0.0, ""), DAMPING, "no new joint state for 0.02 s", True),
        (Inputs(0.22, "", 0.0, ""), DAMPING, "no new joint state for 0.02 s", True),
        (Inputs(0.221, "", 0.0, ""), WAITING, "no new joint state for 0.22 s: silent", False),
        (Inputs(math.inf, "", 0.0, ""), WAITING, "silent", False),
        (Inputs(0.0, "NaN", 0.0, ""), FAULT, "joint state refused: NaN", True),
        (Inputs(0.221, "NaN", 0.0, ""), FAULT, "joint state refused: NaN", False),
        (Inputs(None, "NaN", 0.0, ""), FAULT, "joint state refused: NaN", False),
    ],
)
def test_each_age_and_each_fault_has_its_mode_and_its_reason(
    inputs: Inputs, mode: ControllerMode, reason: str, sends: bool
) -> None:
    decision = decide(inputs, TIMEOUTS)
    assert (decision.mode, decision.sends) == (mode, sends)
    assert reason in decision.reason


def test_the_numbers_of_the_modes_are_those_of_the_message() -> None:
    assert [mode.name for mode in sorted(ControllerMode)] == ["WAITING", "ACTIVE", "HOLD", "DAMPING", "FAULT"]
    assert sorted(ControllerMode) == [0, 1, 2, 3, 4]


@pytest.mark.parametrize("name", ["joint_state_timeout", "silence_after", "reference_timeout", "hold_time"])
@pytest.mark.parametrize("value", [-1.0, math.nan, math.inf])
def test_timeouts_that_make_no_sense_are_refused_by_name(name: str, value: float) -> None:
    with pytest.raises(ValueError, match=name):
        Timeouts(**{name: value})


@pytest.mark.parametrize(
    ("stamp_ms", "now_ms", "kind"),
    [
        (101, 1, Stamp.NEW),
        (100, 1, Stamp.REPEATED),
        (100, 1000, Stamp.REPEATED),  # a stamp that stands still never becomes news
        (99, 20, Stamp.OLD),
        (99, 21, Stamp.RESTARTED),
        (99, -10, Stamp.OLD),  # a simulated clock that comes after the message
        (99, -51, Stamp.RESTARTED),  # the clock that watches jumped too
        (150, 1, Stamp.NEW),
        (151, 1, Stamp.FUTURE),
    ],
)
def test_a_stamp_tells_new_from_repeated_overtaken_restarted_and_future(
    stamp_ms: int, now_ms: int, kind: Stamp
) -> None:
    watch = StreamWatch()
    watch.accept(100 * MS, 0)
    assert watch.judge(stamp_ms * MS, now_ms * MS, 100 * MS, timeout=0.02, max_future=0.05) is kind


def test_before_the_first_message_any_stamp_is_new_and_before_the_clock_is_known_none_is_future() -> None:
    watch = StreamWatch()
    assert watch.age(7) is None
    assert watch.judge(0, 0, 100 * MS, 0.02, 0.05) is Stamp.NEW
    assert watch.judge(10**18, 0, 0, 0.02, 0.05) is Stamp.NEW
    assert watch.judge(10**18, 0, 1, 0.02, 0.05) is Stamp.FUTURE


def test_an_age_is_that_of_the_arrival_and_infinite_after_a_jump_of_the_clock() -> None:
    watch = StreamWatch()
    watch.accept(5, 100 * MS)
    assert watch.age(130 * MS) == pytest.approx(0.03)
    assert watch.age(99 * MS) == 0.0
    assert watch.age(49 * MS) == math.inf
