# SPDX-License-Identifier: Apache-2.0
"""What a controller does about the age of its reference."""

from __future__ import annotations

import math

import pytest

from tpgmm_core.supervision import ControllerMode, ReferenceTimeouts, mode_of

TIMEOUTS = ReferenceTimeouts(reference_timeout=0.1, hold_time=1.0)


@pytest.mark.parametrize(
    ("age", "mode", "reason"),
    [
        (None, ControllerMode.DAMPING, "no reference yet"),
        (0.0, ControllerMode.ACTIVE, "following"),
        (0.1, ControllerMode.ACTIVE, "following"),
        (0.11, ControllerMode.HOLD, "no reference for 0.1 s"),
        (1.1, ControllerMode.HOLD, "no reference for 0.1 s"),
        (1.11, ControllerMode.DAMPING, "no reference for 1.1 s"),
        (math.inf, ControllerMode.DAMPING, "no reference for 1.1 s"),
    ],
)
def test_a_reference_is_followed_then_held_then_let_go_of(age: float | None, mode: ControllerMode, reason: str) -> None:
    found, words = mode_of(age, TIMEOUTS)
    assert found is mode and reason in words


def test_the_numbers_of_the_modes_are_those_of_the_message() -> None:
    assert [mode.name for mode in sorted(ControllerMode)] == ["WAITING", "ACTIVE", "HOLD", "DAMPING", "FAULT"]
    assert sorted(ControllerMode) == [0, 1, 2, 3, 4]


@pytest.mark.parametrize("settings", [{"reference_timeout": 0.0}, {"reference_timeout": math.nan}, {"hold_time": -1.0}])
def test_timeouts_that_make_no_sense_are_refused_by_name(settings: dict[str, float]) -> None:
    with pytest.raises(ValueError, match=next(iter(settings))):
        ReferenceTimeouts(**settings)
