# SPDX-License-Identifier: Apache-2.0
"""Where a recording is cut: between rests of a hand, and by a signal."""

from __future__ import annotations

import numpy as np
import pytest

from tpgmm_core.common.types import Array
from tpgmm_core.geometry import quaternion
from tpgmm_core.observation.takes import Rest, repeats_every, takes_between_rests, takes_by_signal


def go(
    *places: float, rate: float = 100.0, rest: float = 2.0, way: float = 3.0, turn: float = 0.0
) -> tuple[Array, Array]:
    """The hand stays at each place x for `rest` s, and needs `way` s to the next: times (T,), poses (T, 7)."""
    moments = np.cumsum([0.0, *[step for _ in places for step in (rest, way)][:-1]])
    times = np.arange(0.0, moments[-1], 1.0 / rate)
    x = np.interp(times, moments, np.repeat(places, 2))
    angles = turn * np.interp(times, moments, np.repeat(np.arange(len(places)), 2))
    turns = quaternion.exp(np.stack([0.0 * angles, 0.0 * angles, angles], axis=1))
    return times, np.hstack([np.stack([x, 0.0 * x, 0.0 * x], axis=1), turns])


def test_takes_are_between_rests_with_half_a_pause_at_both_sides() -> None:
    times, poses = go(0.0, 0.5, 0.0)
    noisy = poses.copy()
    noisy[:, :3] += np.random.default_rng(0).normal(0.0, 2e-3, (len(times), 3))
    for shown in (poses, noisy):
        takes = takes_between_rests(times, shown, Rest(pause=1.0))
        # a cell of 0.05 s, and the centimetre that counts as rest
        np.testing.assert_allclose(takes, [(1.5, 5.5), (6.5, 10.5)], atol=0.2)
    flipped = poses * np.where(np.arange(len(times)) % 7 == 0, -1.0, 1.0)[:, None] ** [0, 0, 0, 1, 1, 1, 1]
    assert takes_between_rests(times, flipped, Rest()) == takes_between_rests(times, poses, Rest()), (
        "the sign is no turn"
    )


def test_a_turn_on_the_spot_is_a_movement_and_a_short_pause_none() -> None:
    assert len(takes_between_rests(*go(0.0, 0.0, 0.0, turn=1.0), Rest(pause=1.0))) == 2
    assert len(takes_between_rests(*go(0.0, 0.5, 0.0, rest=0.8), Rest(pause=1.0))) == 1
    assert len(takes_between_rests(*go(0.0, 0.5, 0.0), Rest(pause=1.0), shortest=5.0)) == 0
    assert takes_between_rests(*go(0.0, 0.0), Rest()) == []
    assert takes_between_rests(np.array([0.0, 0.1]), np.tile([0.0] * 6 + [1.0], (2, 1)), Rest()) == [(0.0, 0.1)]


def test_messages_that_cease_while_the_hand_stays_are_a_rest() -> None:
    times, poses = go(0.0, 0.5, 0.0, rest=4.0)
    kept = (times < 7.5) | (times > 10.5)
    np.testing.assert_allclose(
        takes_between_rests(times[kept], poses[kept], Rest()), [(3.5, 7.5), (10.5, 14.5)], atol=0.2
    )


def test_a_signal_says_what_a_take_is() -> None:
    times, holds = np.array([1.0, 2.0, 5.0, 5.1, 6.0, 9.0]), np.array([False, True, False, True, False, True])
    span = (0.0, 12.0)
    assert takes_by_signal(times, holds, span) == [(2.0, 5.0), (5.1, 6.0), (9.0, 12.0)]
    assert takes_by_signal(times, holds, span, pause=0.2) == [(2.0, 6.0), (9.0, 12.0)]
    assert takes_by_signal(times, holds, span, shortest=1.0) == [(2.0, 5.0), (9.0, 12.0)]
    assert takes_by_signal(times, holds, span, until_next=True, pause=0.2) == [(2.0, 9.0), (9.0, 12.0)]
    assert takes_by_signal(times, holds, (3.0, 5.5), shortest=0.1) == [(3.0, 5.0), (5.1, 5.5)]
    assert takes_by_signal(times[:0], holds[:0], span) == []


@pytest.mark.parametrize(
    ("places", "every"),
    [
        ((0.0, 0.5, 0.0, 0.5, 0.0), 2),  # there, and led back
        ((0.0, 0.5, 0.01, 0.6, 0.02, 0.4), 2),
        ((0.0, 0.5, 1.0, 0.3), None),  # one movement with pauses
        ((0.0, 0.5), None),
        ((0.0, 0.5, 0.0), None),  # there and back: nothing comes twice
    ],
)
def test_what_is_shown_again_and_again_is_seen(places: tuple[float, ...], every: int | None) -> None:
    times, poses = go(*places)
    assert repeats_every(times, poses, takes_between_rests(times, poses, Rest())) == every


def test_a_movement_that_ends_where_it_began_counts_each_time() -> None:
    times = np.arange(0.0, 21.0, 0.01)
    phase = np.clip(times % 7.0 - 2.0, 0.0, 3.0) / 3.0
    poses = np.tile([0.0] * 6 + [1.0], (len(times), 1))
    poses[:, 0], poses[:, 1] = 0.2 * np.cos(2.0 * np.pi * phase), 0.2 * np.sin(2.0 * np.pi * phase)
    takes = takes_between_rests(times, poses, Rest())
    assert len(takes) == 3 and repeats_every(times, poses, takes) == 1


def test_a_rest_needs_sizes_above_0() -> None:
    with pytest.raises(ValueError, match=r"way is 0.0, expected more than 0"):
        Rest(way=0.0)
