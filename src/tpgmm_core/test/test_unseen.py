# SPDX-License-Identifier: Apache-2.0
"""Masks of the API by the rule of recordings: a frame that is not seen stays, goes with the hand, or is not known."""

from __future__ import annotations

import numpy as np
import pytest

from tpgmm_core import Demonstration, Frame
from tpgmm_core.common.types import Array
from tpgmm_core.geometry.pose import compose
from tpgmm_core.observation.unseen import STAYS, WITH_HAND, hold_unseen, last_seen

TIMES = 0.1 * np.arange(31)
HAND = np.column_stack([0.1 * TIMES, 0.0 * TIMES, 0.0 * TIMES + 0.3, np.tile([1.0, 0.0, 0.0, 0.0], (31, 1))])
IN_HAND = np.array([0.0, 0.0, 0.05, 0.0, 0.0, 0.0, 1.0])


def demonstration(poses: Array, seen: Array) -> Demonstration:
    """What is not seen is anywhere."""
    anywhere = np.where(seen[:, None], poses, poses + np.array([9.0, 9.0, 9.0, 0, 0, 0, 0]))
    frames = {"thing": Frame.from_pose(anywhere[:, :3], anywhere[:, 3:]).with_time()}
    return Demonstration(TIMES, np.column_stack([TIMES, HAND]), frames, {"thing": seen})


def places(held: Demonstration) -> Array:
    return held.frames["thing"].b[:, 1:4]


MOVING = HAND + np.array([0.0, 0.2, 0.0, 0, 0, 0, 0])  # beside the hand, and turned with it
SEEN = (TIMES < 0.95) | ((TIMES > 1.95) & (TIMES < 2.45))


def test_a_frame_stays_where_it_was_last_seen_and_only_what_was_seen_is_used() -> None:
    held = hold_unseen(demonstration(MOVING, SEEN), {"thing": STAYS})
    assert held.is_visible("thing").all() and not held.visible
    last = np.maximum.accumulate(np.where(SEEN, np.arange(31), 0))
    np.testing.assert_allclose(places(held), MOVING[last, :3], atol=1e-12)


def test_after_a_time_it_is_not_known_and_before_it_was_seen_neither() -> None:
    held = hold_unseen(demonstration(MOVING, SEEN), {"thing": 0.35})
    age = TIMES - TIMES[np.maximum.accumulate(np.where(SEEN, np.arange(31), 0))]
    np.testing.assert_array_equal(held.is_visible("thing"), age < 0.36)
    late = hold_unseen(demonstration(MOVING, TIMES > 0.95), {"thing": STAYS})
    np.testing.assert_array_equal(late.is_visible("thing"), TIMES > 0.95)
    soon = hold_unseen(demonstration(MOVING, TIMES > 0.35), {"thing": STAYS})
    assert soon.is_visible("thing").all(), "the recorder was switched on in another order"


def test_what_was_seen_to_move_with_the_hand_goes_on_with_it() -> None:
    carried = compose(HAND, np.broadcast_to(IN_HAND, HAND.shape))
    held = hold_unseen(demonstration(carried, TIMES < 1.45), {"thing": WITH_HAND})
    hidden = TIMES > 1.4 + 0.25
    np.testing.assert_allclose(places(held)[hidden], carried[hidden, :3], atol=1e-9)
    assert held.is_visible("thing").all()
    still = np.tile(carried[14], (31, 1))
    held = hold_unseen(demonstration(still, TIMES < 1.45), {"thing": WITH_HAND})
    np.testing.assert_allclose(places(held), still[:, :3], atol=1e-9)


def test_other_frames_and_those_that_never_move_remain_and_what_makes_no_sense_is_refused() -> None:
    seen = demonstration(MOVING, SEEN)
    assert hold_unseen(seen, {}).visible == {"thing": pytest.approx(SEEN)}
    rest = Frame.from_pose(MOVING[0, :3], MOVING[0, 3:]).with_time()
    fixed = Demonstration(TIMES, seen.data, {"thing": rest}, {"thing": SEEN})
    assert hold_unseen(fixed, {"thing": STAYS}).is_visible("thing").all()
    for unseen, reason in (
        ({"box": STAYS}, "unseen names 'box'; the demonstration has"),
        ({"thing": -1.0}, "expected STAYS, WITH_HAND or a time"),
        ({"thing": "gone"}, "expected STAYS, WITH_HAND or a time"),
    ):
        with pytest.raises(ValueError, match=reason):
            hold_unseen(seen, unseen)
    with pytest.raises(ValueError, match="was never seen"):
        hold_unseen(demonstration(MOVING, np.zeros(31, bool)), {"thing": STAYS})
    scaled = Demonstration(
        TIMES, seen.data, {"thing": Frame(2.0 * seen.frames["thing"].A, seen.frames["thing"].b)}, {"thing": SEEN}
    )
    with pytest.raises(ValueError, match="has to be a frame of a pose"):
        hold_unseen(scaled, {"thing": WITH_HAND})


def test_the_latest_observation_counts() -> None:
    which, known = last_seen(np.array([10, 20]) * 10**9, np.array([5, 10, 15, 20, 30]) * 10**9, 7.0)
    assert which.tolist() == [0, 0, 0, 1, 1] and known.tolist() == [False, True, True, True, False]
