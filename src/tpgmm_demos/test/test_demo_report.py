# SPDX-License-Identifier: Apache-2.0
"""What the demo's report makes of recorded torques: of a jump, of a silent controller, of a machine that is late."""

from __future__ import annotations

import numpy as np
import pytest

from tpgmm_demos.demo.recording import Series
from tpgmm_demos.demo.report import AFTERWARDS, largest_jump, longest_silence, usual_jump

ORIGIN_NS = 5_000_000_000
HIDDEN = (6.0, 7.0)


def torques(*jumps: tuple[float, float], slope: float = 20.0) -> Series:
    """Ten seconds of two joints at 1 kHz: one rises by `slope` (N m/s), the other jumps at times by N m."""
    times = 1e-3 * np.arange(10_000)
    jumping = sum((size * (times >= at) for at, size in jumps), np.zeros(len(times)))
    return Series(ORIGIN_NS + np.round(1e9 * times).astype(np.int64), np.column_stack([slope * times, jumping]))


def without(series: Series, start: float, end: float) -> Series:
    times = series.times(ORIGIN_NS)
    kept = (times < start) | (times > end)
    return Series(series.stamps_ns[kept], series.values[kept])


def test_a_jump_is_found_where_it_is() -> None:
    series = torques((6.5, 3.0))
    assert largest_jump(series, ORIGIN_NS, *HIDDEN) == pytest.approx(3.0)
    assert largest_jump(series, ORIGIN_NS, HIDDEN[1], HIDDEN[1] + AFTERWARDS) == pytest.approx(0.0, abs=1e-9)


def test_a_torque_that_changes_fast_does_not_jump_and_one_that_begins_to_does() -> None:
    assert largest_jump(torques(slope=900.0), ORIGIN_NS, *HIDDEN) == pytest.approx(0.0, abs=1e-6)
    limited = torques(*((6.5 + 0.001 * i, 1.5) for i in range(30)))  # a jump of 45 N m, spread by a limit
    assert largest_jump(limited, ORIGIN_NS, *HIDDEN) == pytest.approx(1.5)


def test_torques_that_are_missing_share_their_change_out_over_the_ticks() -> None:
    series = without(torques((6.205, 3.0)), 6.2, 6.2094)
    assert largest_jump(series, ORIGIN_NS, *HIDDEN) == pytest.approx(3.0 / 11.0)


def test_a_silent_controller_shows_neither_that_there_was_no_jump_nor_that_it_was_there() -> None:
    silent = without(torques(), 5.9, 20.0)
    assert largest_jump(silent, ORIGIN_NS, *HIDDEN) is None
    assert longest_silence(silent, ORIGIN_NS, HIDDEN[1] + AFTERWARDS) == pytest.approx(1.6, abs=0.002)
    assert longest_silence(torques(), ORIGIN_NS, HIDDEN[1] + AFTERWARDS) < 0.0021
    assert longest_silence(without(torques(), 2.0, 2.3), ORIGIN_NS, 7.5) == pytest.approx(0.3, abs=0.002)
    nothing = without(torques(), -1.0, 20.0)
    assert longest_silence(nothing, ORIGIN_NS, 7.5) == 7.5 and usual_jump(nothing, ORIGIN_NS, HIDDEN) == 0.0


def test_one_jump_elsewhere_does_not_excuse_another_and_a_machine_that_is_always_late_does() -> None:
    assert usual_jump(torques((2.2, 9.0)), ORIGIN_NS, HIDDEN) == pytest.approx(0.0, abs=1e-9)
    assert usual_jump(torques((6.2, 9.0), (7.1, 9.0)), ORIGIN_NS, HIDDEN) == pytest.approx(0.0, abs=1e-9)
    late = torques(*((0.25 + 0.5 * i, 1.5) for i in range(20)))
    assert usual_jump(late, ORIGIN_NS, HIDDEN) == pytest.approx(1.5)
