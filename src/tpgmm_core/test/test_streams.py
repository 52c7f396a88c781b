# SPDX-License-Identifier: Apache-2.0
"""What the stamps of a stream say, how often it comes, and who gives the beat."""

from __future__ import annotations

import math

import numpy as np
import pytest

from tpgmm_core.observation.streams import (
    RESTARTED_AFTER,
    SECOND,
    Beat,
    ClockWatch,
    Leader,
    RateMeter,
    Stamp,
    StreamWatch,
)

MS = 1_000_000


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


@pytest.mark.parametrize("seed", range(3))
def test_of_messages_that_overtake_each_other_each_newer_one_is_taken_once_and_none_is_a_restart(seed: int) -> None:
    rng, watch = np.random.default_rng(seed), StreamWatch()
    sent = np.arange(4000) * MS
    delays = np.where(rng.random(4000) < 0.01, rng.uniform(0, 10, 4000), 0.0)
    order = np.argsort(sent + delays * MS, kind="stable")
    taken = []
    for i in order.tolist():
        now_ns = int(sent[i] + delays[i] * MS)
        kind = watch.judge(int(sent[i]), now_ns, 0, RESTARTED_AFTER, math.inf)
        assert kind in (Stamp.NEW, Stamp.OLD)
        if kind is Stamp.NEW:
            watch.accept(int(sent[i]), now_ns)
            taken.append(int(sent[i]))
    assert taken == sorted(set(taken)) and len(taken) > 3900


def test_the_rate_is_that_of_most_messages_whatever_pauses_and_jitter_there_are() -> None:
    rng, meter = np.random.default_rng(0), RateMeter()
    now = 0
    for i in range(200):
        assert (meter.measured() is None) == (i <= 16)
        meter.add(now)
        meter.add(now)  # one that comes twice has no interval
        now += round(20 * MS * rng.uniform(0.8, 1.2)) + (500 * MS if i % 10 == 9 else 0)
    measured = meter.measured()
    assert measured == pytest.approx(0.02, rel=0.1)


def test_a_period_is_said_as_it_was_until_it_is_another_one() -> None:
    meter = RateMeter(size=8, enough=4)
    said = set()
    for period in (20.0, 20.5, 19.6, 21.0):
        for _ in range(8):
            meter.add((meter._last_ns or 0) + round(period * MS))
        said.add(meter.period())
    assert said == {0.02}
    for _ in range(8):
        meter.add((meter._last_ns or 0) + 10 * MS)
    assert meter.period() == pytest.approx(0.01)


def test_who_names_most_joints_gives_the_beat_until_it_is_silent() -> None:
    leader = Leader(patience=0.5)
    arm, gripper, other = ["a", "b", "c"], ["f"], ["x", "y", "z"]
    assert leader.is_led_by(gripper, 0)  # nobody else is there yet
    assert leader.is_led_by(arm, MS)
    assert not leader.is_led_by(gripper, 2 * MS)
    assert not leader.is_led_by(other, 3 * MS)
    assert leader.is_led_by(list(arm), 400 * MS)
    assert not leader.is_led_by(gripper, 800 * MS)
    assert leader.is_led_by(gripper, 901 * MS)
    assert leader.is_led_by(arm, 902 * MS)


def test_a_step_between_two_messages_has_a_time_between_them_and_time_never_goes_back() -> None:
    beat = Beat()
    assert beat.between(0) is None
    beat.take(990 * MS, 0)
    assert beat.between(MS) is None
    beat.take(1000 * MS, 5 * MS)
    assert beat.between(6 * MS) is None
    beat.take(1010 * MS, 15 * MS)
    assert beat.between(15 * MS) is None
    assert beat.between(19 * MS) == 1014 * MS
    assert beat.between(18 * MS) is None and beat.between(19 * MS) is None  # what would be sent has been sent
    assert beat.between(20 * MS) == 1015 * MS
    assert beat.between(24 * MS) is None  # the next message is near
    assert beat.between(22 * MS, 0.0021) is None and beat.between(22 * MS, 0.0019) is not None  # it would take too long
    assert not beat.take(1012 * MS, 23 * MS)  # it came earlier than expected, after a step that was later
    assert beat.step_ns == 1017 * MS
    assert beat.take(1022 * MS, 30 * MS) and beat.step_ns == 1022 * MS
    beat.take(5022 * MS, 4030 * MS)  # after a pause
    beat.take(5032 * MS, 4040 * MS)
    assert beat.between(4060 * MS) is None and beat.between(4045 * MS) == 5037 * MS
    beat.take(10 * MS, 40 * MS, restarted=True)
    assert beat.step_ns == 10 * MS and beat.between(42 * MS) is None


@pytest.mark.parametrize(
    ("back", "set_back"), [(-1.0, False), (0.0, False), (0.03, False), (0.2, True), (3600.0, True)]
)
def test_a_clock_that_is_set_back_is_noticed_once(back: float, set_back: bool) -> None:
    watch = ClockWatch()
    assert not watch.was_set_back(5000 * SECOND)
    later = round((5001.0 - back) * SECOND)
    assert not watch.was_set_back(5001 * SECOND)
    assert watch.was_set_back(later) == set_back
    assert not watch.was_set_back(later + 1)
