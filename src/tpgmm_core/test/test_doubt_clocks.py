# SPDX-License-Identifier: Apache-2.0
"""Clocks of recordings: what is found in the order of writing, put right, said or refused."""

import numpy as np
import pytest

from tpgmm_core.common.types import Nanoseconds
from tpgmm_core.doubt.clocks import ClockError, CommonClock, common_clock, gaps
from tpgmm_core.doubt.stamps import TopicTimes

START = 1_750_000_000.0


def ns(seconds: object) -> Nanoseconds:
    return np.round(np.asarray(seconds, dtype=float) * 1e9).astype(np.int64)


def topic(name: str, seconds: object, stamps: object = None, start: float = START) -> TopicTimes:
    recorded = np.asarray(seconds, dtype=float)
    stamped = recorded if stamps is None else np.asarray(stamps, dtype=float)
    return TopicTimes(name, name, ns(stamped + start * (stamped != 0)), ns(recorded + start * (recorded != 0)))


def seconds(clock: CommonClock, name: str) -> np.ndarray:
    return (clock.times[name] - clock.times["hand"][0]) * 1e-9


T = np.linspace(1.0, 5.0, 81) + 0.013


def test_stamps_are_taken_where_all_are_sane() -> None:
    late = T + np.random.default_rng(0).uniform(0.0, 0.03, len(T))
    clock = common_clock(topic("hand", late, T), [topic("object", late, T)])
    assert not clock.by_recorder and not clock.notes and not clock.doubts
    np.testing.assert_allclose(seconds(clock, "object"), T - T[0], atol=1e-6)


@pytest.mark.parametrize("start", [0.0, 351.0])
def test_what_was_recorded_at_time_zero_is_left_out(start: float) -> None:
    early = np.concatenate([np.zeros(4), T])
    clock = common_clock(topic("hand", early, start=start), [topic("object", early[::3], start=start)])
    assert list(clock.kept["hand"]) == list(range(4, 85)) and clock.times["object"][0] > 0
    (doubt,) = clock.doubts
    assert doubt.kind == "clock" and "first 4 of 85 messages of hand were recorded at time 0" in doubt.text
    np.testing.assert_allclose(seconds(clock, "hand"), T - T[0], atol=1e-6)


def test_a_frame_that_was_sent_once_before_the_clock_came_is_not_lost() -> None:
    clock = common_clock(topic("hand", np.concatenate([np.zeros(4), T])), [topic("object", [0.0])])
    assert list(clock.kept["object"]) == [0] and clock.times["object"][0] <= clock.times["hand"][0]


def test_zero_from_the_recorder_alone_does_no_harm() -> None:
    recorded = T.copy()
    recorded[0] = 0.0
    clock = common_clock(topic("hand", recorded, T), [topic("object", recorded, T)])
    assert not clock.doubts and len(clock.times["hand"]) == 81


@pytest.mark.parametrize(("step", "place"), [(-0.8, 40), (-0.15, 20), (-300.0, 60), (300.0, 30)])
def test_a_clock_that_steps_in_the_middle_is_refused(step: float, place: int) -> None:
    stepped = T + step * (np.arange(81) >= place)
    words = rf"clock steps by {step:+.2f} s|clock steps by {step + 0.05:+.2f} s"
    with pytest.raises(ClockError, match=words.replace("+", r"\+")) as raised:
        common_clock(topic("hand", stepped), [topic("object", stepped)])
    assert f"before message {place} of hand" in str(raised.value)


@pytest.mark.parametrize("step", [-0.8, 500.0, -500.0])
def test_a_few_messages_behind_a_step_are_left_out(step: float) -> None:
    stepped = T + step * (np.arange(81) >= 78)
    clock = common_clock(topic("hand", stepped), [topic("object", stepped)])
    assert len(clock.times["hand"]) == 78 and "3 of 81 messages of hand" in clock.doubts[0].text


@pytest.mark.parametrize("step", [-0.8, 400.0])
def test_where_only_one_clock_steps_the_other_is_taken(step: float) -> None:
    stepped = T + step * (np.arange(81) >= 40)
    by_stamps = common_clock(topic("hand", stepped, T), [topic("object", stepped, T)])
    by_recorder = common_clock(topic("hand", T, stepped), [topic("object", T, stepped)])
    for clock in (by_stamps, by_recorder):
        np.testing.assert_allclose(seconds(clock, "hand"), T - T[0], atol=1e-6)
    assert by_recorder.by_recorder and len(by_recorder.notes) == 1 and not by_stamps.by_recorder


def test_messages_that_overtook_one_another_are_put_in_order() -> None:
    stamps = T.copy()
    stamps[[10, 11]] = stamps[[11, 10]]
    recorded = T.copy()
    recorded[[10, 11]] = recorded[11] - [0.0, 0.02]
    clock = common_clock(topic("hand", recorded, np.zeros(81)), [])
    assert (np.diff(clock.times["hand"]) >= 0).all() and list(clock.kept["hand"][10:12]) == [11, 10]
    assert not clock.doubts


@pytest.mark.parametrize("lag", [0.4, 4.0, 60.0, 86400.0, -5.0])
@pytest.mark.parametrize("jitter", [0.0, 0.02])
def test_a_steady_lag_is_said_and_set_right(lag: float, jitter: float) -> None:
    came = T + np.random.default_rng(1).uniform(0.0, jitter, len(T))
    clock = common_clock(topic("hand", T), [topic("object", came, T - lag)])
    np.testing.assert_allclose(seconds(clock, "object"), T - T[0] + jitter / 2, atol=0.01)
    (doubt,) = clock.doubts
    assert doubt.kind == "lag" and "by a constant time" in doubt.text and "object is stamped" in doubt.text


@pytest.mark.parametrize("latency", [0.03, 0.2])
def test_latency_of_perception_is_no_lag(latency: float) -> None:
    came = T + latency * np.random.default_rng(2).uniform(0.7, 1.3, len(T))
    clock = common_clock(topic("hand", T), [topic("object", came, T)])
    assert not clock.doubts
    np.testing.assert_allclose(seconds(clock, "object"), T - T[0], atol=1e-6)


def test_slow_perception_is_said_and_left_as_it_is() -> None:
    came = np.sort(T + np.random.default_rng(3).uniform(0.4, 0.7, len(T)))
    clock = common_clock(topic("hand", T), [topic("object", came, T)])
    assert "slow perception" in clock.doubts[0].text
    np.testing.assert_allclose(seconds(clock, "object"), T - T[0], atol=1e-6)


@pytest.mark.parametrize("lag", [0.5 * T, 4.0 + 3.0 * (T > 3.0), 10.0 * np.sin(T) + 20.0])
def test_a_lag_that_is_not_steady_is_refused(lag: np.ndarray) -> None:
    stamps = np.sort(T - lag + 50.0)
    with pytest.raises(ClockError, match="object is stamped .* by a varying time"):
        common_clock(topic("hand", T + 50.0), [topic("object", T + 50.0, stamps)])


def test_simulated_time_at_any_speed_is_no_lag() -> None:
    """All stamps are of one clock, which goes at 0.3 of the recorder's speed."""
    stamps = 100.0 + 0.3 * T
    clock = common_clock(topic("hand", T, stamps - START), [topic("object", T[::3], stamps[::3] - START)])
    assert not clock.doubts and not clock.by_recorder


@pytest.mark.parametrize(
    ("stamps", "words"),
    [
        (1000.0 * T, "run 1e+03 times as fast"),  # ms written as s
        (1e-6 * T, "e-06 times as fast"),  # us written as ps, say
        (np.floor(T), "the same stamp in 16 messages"),  # the part of a second is never filled in
        (np.floor(2.0 * T) / 2.0, "the same stamp in"),
    ],
)
def test_stamps_in_another_unit_or_rounded_are_not_used(stamps: np.ndarray, words: str) -> None:
    clock = common_clock(topic("hand", T, stamps), [topic("object", T[::3])])
    assert clock.by_recorder and words in clock.notes[0]
    assert seconds(clock, "hand") == pytest.approx(T - T[0], abs=1e-6)


@pytest.mark.parametrize(("unit", "count"), [("us", 1e6), ("ms", 1e3)])
@pytest.mark.parametrize("wrong", ["hand", "object"])
def test_the_topic_whose_nanoseconds_are_microseconds_is_named(wrong: str, unit: str, count: float) -> None:
    """Its lag goes from 0 to 1 s and back: this is no clock that drifts."""
    stamps = dict.fromkeys(("hand", "object"), T) | {wrong: np.floor(T) + 1e-9 * np.floor(count * (T % 1.0))}
    hand, thing = (topic(name, T, stamped, start=0.0) for name, stamped in stamps.items())
    clock = common_clock(hand, [thing])
    assert clock.by_recorder
    assert clock.notes[0].startswith(f"{wrong} has stamps whose field for nanoseconds counts {unit}")
    assert seconds(clock, "object") == pytest.approx(T - T[0], abs=1e-6)


def test_a_topic_that_comes_at_full_seconds_has_good_stamps() -> None:
    tick = np.arange(1.0, 11.0)
    burst = (tick[:, None] + 1e-4 * np.arange(6)).ravel()
    hand = np.linspace(1.0, 11.0, 201)
    clock = common_clock(topic("hand", hand), [topic("object", burst + 0.02, burst)])
    assert not clock.by_recorder and not clock.notes


def test_recorded_times_in_a_burst_leave_the_stamps_as_they_are() -> None:
    """Bags written by a program have the times at which it wrote."""
    assert not common_clock(topic("hand", 1.0 + 1e-3 * T, T), [topic("object", 1.0 + 1e-3 * T, T)]).by_recorder


def test_pauses_are_found_where_they_are() -> None:
    times = ns(np.concatenate([T[:30], T[30:] + 1.5]))
    ((begin, length),) = gaps(times, 0.5, 10.0)
    assert begin == pytest.approx(29 * 0.05) and length == pytest.approx(1.55)
    assert not gaps(ns(T), 0.5, 10.0) and not gaps(ns(T[:3] * 10), 0.5, 10.0)


def test_a_bag_that_was_written_at_once_is_judged_by_its_stamps() -> None:
    at_once = np.full(81, 1.0)
    clock = common_clock(topic("hand", at_once, T), [topic("object", at_once[::3], T[::3])])
    assert not clock.by_recorder and not clock.doubts
    np.testing.assert_allclose(seconds(clock, "object"), T[::3] - T[0], atol=1e-6)


def test_where_no_clock_went_at_all_that_is_said() -> None:
    still = topic("hand", np.zeros(81), np.zeros(81))
    with pytest.raises(ClockError, match="stamps that never change, and .* the same in all 81 messages: nothing tells"):
        common_clock(still, [topic("object", np.zeros(9), np.zeros(9))])


def test_stamps_before_1970_are_called_so() -> None:
    past = TopicTimes("hand", "hand", ns(T - 1000.0), ns(T + START))
    clock = common_clock(past, [])
    assert clock.by_recorder and clock.notes == ("hand has stamps before 1970: the recorder's times are used instead",)


def test_a_pause_that_stamps_and_recorder_agree_on_may_be_one() -> None:
    paused = T + 40.0 * (np.arange(81) >= 40)
    with pytest.raises(
        ClockError, match=r"steps by \+40.05 s .*, or the recording was paused, as its stamps say the same"
    ):
        common_clock(topic("hand", paused), [])
    with pytest.raises(ClockError) as raised:
        common_clock(topic("hand", T - 40.0 * (np.arange(81) >= 40)), [])
    assert "paused" not in str(raised.value)
