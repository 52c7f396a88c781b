# SPDX-License-Identifier: Apache-2.0
"""What a controller does about the age and the validity of its inputs."""

from __future__ import annotations

import math

import pytest

from tpgmm_core.control.supervision import ControllerMode, Inputs, Timeouts, decide, slow_states

TIMEOUTS = Timeouts(joint_state_timeout=0.02, silence_after=0.2, reference_timeout=0.1, hold_time=1.0)
WAITING, ACTIVE, HOLD, DAMPING, FAULT = ControllerMode


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
    ("age", "mode", "reason"),
    [
        (None, WAITING, "no joint state yet (missing a)"),
        (0.021, DAMPING, "gravity compensation at the last known position (missing a)"),
        (0.221, WAITING, "silent (missing a)"),
    ],
)
def test_what_came_instead_of_joint_states_is_part_of_the_reason(
    age: float | None, mode: ControllerMode, reason: str
) -> None:
    decision = decide(Inputs(age, "", 0.0, "", "missing a"), TIMEOUTS)
    assert decision.mode is mode and decision.reason.endswith(reason)


@pytest.mark.parametrize(
    ("period", "advice"),
    [
        (0.001, []),
        (0.0051, []),  # what is measured is not taken too literally
        (
            0.02,
            ["joint_state_timeout is 0.02 s, but joint states come every 0.02 s (measured): set it to 0.06 s or more"],
        ),
    ],
)
def test_joint_states_that_are_too_slow_for_the_settings_are_told_with_what_to_set(
    period: float, advice: list[str]
) -> None:
    found = slow_states(period, "measured", TIMEOUTS, 0.005)
    assert found[: len(advice)] == advice and len(found) == 2 * len(advice)
    if advice:
        assert found[1].startswith("max_time_step is 0.005 s") and found[1].endswith("set it to 0.02 s or more")
        enough = Timeouts(joint_state_timeout=0.06)
        assert slow_states(period, "measured", enough, 0.02) == []
