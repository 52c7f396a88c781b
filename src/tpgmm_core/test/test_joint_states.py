# SPDX-License-Identifier: Apache-2.0
"""Joint states out of messages of one driver or of several, beside those of others."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tpgmm_core.observation.joint_states import JointSample, JointStateAssembler, JointStateError

JOINTS = ["a", "b", "c"]
MS = 1_000_000
NAN = math.nan


class Bench:
    """An assembler of positions and velocities, which are 10 times the positions."""

    def __init__(self, max_spread: float = 0.02) -> None:
        self.assembler = JointStateAssembler(JOINTS, ["position", "velocity"], max_spread)

    def take(self, stamp_ms: float, **positions: float) -> JointSample | None:
        values = np.array(list(positions.values()))
        return self.assembler.take(list(positions), [values, 10.0 * values], round(stamp_ms * MS))

    def expect(self, stamp_ms: float, positions: list[float], sample: JointSample | None) -> None:
        assert sample is not None and sample.stamp_ns == round(stamp_ms * MS)
        np.testing.assert_array_equal(sample.values[0], positions)
        np.testing.assert_array_equal(sample.values[1], 10.0 * np.array(positions))


def test_a_whole_message_is_a_state_in_whatever_order_and_with_whatever_others() -> None:
    bench = Bench()
    bench.expect(1, [1, 2, 3], bench.take(1, a=1, b=2, c=3))
    bench.expect(2, [1, 2, 3], bench.take(2, c=3, x=NAN, a=1, y=math.inf, b=2))
    bench.expect(2, [4, 5, 6], bench.take(2, b=5, a=4, c=6))  # a repeated stamp is not for it to judge


@pytest.mark.parametrize(
    ("names", "columns"),
    [
        (["f", "g"], [[0.1, 0.2], [0.0, 0.0]]),
        (["f", "f"], [[0.1, 0.2], [0.0, 0.0]]),  # even where they make no sense: they are not ours
        (["f"], [[NAN, 1.0], []]),
        ([], [[], []]),
    ],
)
def test_joints_of_others_are_no_state_and_no_fault_and_take_nothing_away(
    names: list[str], columns: list[list[float]]
) -> None:
    bench = Bench()
    assert bench.assembler.take(names, columns, 0) is None
    words = bench.assembler.incomplete()
    assert words == f"none of its joints arrived; the last message names {', '.join(names) or 'nothing'}"
    assert bench.take(1, a=1, b=2) is None
    assert bench.assembler.take(names, columns, 5 * MS) is None
    assert "missing c" in bench.assembler.incomplete()
    bench.expect(1, [1, 2, 3], bench.take(2, c=3))


def test_a_state_in_parts_is_complete_once_all_have_come_anew_and_is_as_old_as_its_oldest_part() -> None:
    bench = Bench()
    for tick in (0, 10, 20):
        assert bench.take(tick + 0.3, b=tick + 2) is None
        assert "missing a, c" in bench.assembler.incomplete()
        bench.expect(tick + 0.2, [tick + 1, tick + 2, tick + 3], bench.take(tick + 0.2, a=tick + 1, c=tick + 3))
    # one that comes more often than the others makes no state by itself, and its newest value counts
    for fast in range(5):
        assert bench.take(30 + fast, a=fast) is None
    bench.expect(33, [4, 7, 8], bench.take(33, b=7, c=8))


def test_a_part_that_is_too_old_beside_the_others_completes_nothing_and_is_named() -> None:
    bench = Bench()
    assert bench.take(0, a=1) is None
    assert bench.take(21, b=2, c=3) is None
    assert bench.assembler.incomplete() == "a came 0.021 s earlier than the others; 0.02 s is allowed"
    bench.expect(21, [4, 2, 3], bench.take(22, a=4))


def test_an_overtaken_part_is_passed_over_and_time_that_jumps_back_is_followed() -> None:
    bench = Bench()
    assert bench.take(10, a=1, b=2) is None
    assert bench.take(9, a=8, b=9) is None
    bench.expect(10, [1, 2, 3], bench.take(10, c=3))
    assert bench.take(-1000, a=4, b=5) is None
    bench.expect(-1000, [4, 5, 6], bench.take(-999, c=6))


@pytest.mark.parametrize(
    ("names", "columns", "words"),
    [
        (["a", "b", "c"], [[1, NAN, 3], [0, 0, 0]], "position of b is not finite"),
        (["b", "a", "x"], [[1, 2, 3], [0, math.inf, 0]], "velocity of a is not finite"),
        (["a", "b", "c"], [[1, 2, 3], []], "velocity is empty, but needed"),
        (["a", "b", "c"], [[1, 2], [0, 0, 0]], "position has 2 numbers for 3 joint names"),
        (["a", "b", "a"], [[1, 2, 3], [0, 0, 0]], "a is named twice"),
    ],
)
def test_own_joints_that_cannot_be_used_are_refused_with_the_reason_and_the_next_message_is_taken(
    names: list[str], columns: list[list[float]], words: str
) -> None:
    bench = Bench()
    for _ in range(2):
        with pytest.raises(JointStateError, match=words):
            bench.assembler.take(names, columns, 0)
    bench.expect(1, [1, 2, 3], bench.take(1, a=1, b=2, c=3))


def test_joints_that_stop_are_named_while_the_others_go_on() -> None:
    bench = Bench()
    bench.expect(0, [1, 2, 3], bench.take(0, a=1, b=2, c=3))
    for tick in range(1, 50):
        assert bench.take(tick, a=1, b=2) is None
    assert bench.assembler.incomplete().startswith("missing c;")


@given(st.lists(st.tuples(st.sets(st.sampled_from("abcxy")), st.integers(-5, 60)), max_size=60))
def test_whatever_comes_a_state_is_never_older_than_its_stamp_and_its_parts_are_near_each_other(
    messages: list[tuple[set[str], int]],
) -> None:
    bench = Bench(0.01)
    for names, stamp in messages:
        sample = bench.take(stamp, **{name: float(stamp) for name in names})
        if sample is not None:  # each value is the stamp that it came with
            assert sample.stamp_ns == round(min(sample.values[0]) * MS)
            assert np.ptp(sample.values[0]) <= 10.0
