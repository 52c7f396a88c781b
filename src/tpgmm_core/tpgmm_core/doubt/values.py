# SPDX-License-Identifier: Apache-2.0
"""Values that no arm and no object has: units that are mixed or no metres, leaps, hands that never move."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from tpgmm_core.common.text import one_line
from tpgmm_core.common.types import Array
from tpgmm_core.doubt.doubts import Doubt, RawDemonstration
from tpgmm_core.geometry import quaternion

LARGEST_M = 20.0
"""No arm moves further: positions that span more are in another unit."""
MIXED = 30.0
"""What differs by more than this factor is in another unit: millimetres by 1000, centimetres by 100, inches by 39."""
FAR_M = 50.0
FASTEST = 5.0
"""m/s: faster than arms that are led by hand, or that handle things."""
FASTEST_TURN = 20.0
"""rad/s."""
LEAP_M, LEAP_RAD = 0.05, 0.5
LEAP = 6.0
"""A step that is so many times as fast as the fastest of 98 % of all steps is a leap."""
ZIGZAG_M, ZIGZAG = 0.005, 0.3
"""Poses this far off the line between their neighbours, and by so little off that of every second one: two by turns."""
MOST_TURN = 4.0 * np.pi
"""rad: no joint of an arm is two turns away from its zero."""
BEYOND_LIMITS = 0.1
"""rad or m: encoders and soft stops are less far off."""
ROUNDED_M, REPEATED = 0.005, 4.0
"""Positions in steps of so much, which as many samples have, are rounded: slower ones repeat what they received."""
WINDOW_S = 0.02
"""Speeds are means over this time, since those of two samples are mostly noise at high rates."""


def doubts_of_units(shown: Sequence[RawDemonstration]) -> list[Doubt]:
    """Units by magnitude: mixed ones are refused, the same everywhere but no metres are said.

    Parameters
    ----------
    shown
        one or more

    Returns
    -------
    list[Doubt]
        what makes no sense
    """
    found = _mixed_recordings(shown)
    frames = dict.fromkeys(frame for one in shown for frame in one.frames)
    for frame in frames:
        with_it = [one for one in shown if frame in one.frames and len(one.seen(frame))]
        odd = [one for one in with_it if _is_in_another_unit(one, frame)]
        if odd:
            about = () if len(odd) == len(shown) else tuple(one.name for one in odd)
            hand, place = odd[0].movement[:, :3], odd[0].seen(frame)[:, :3]
            text = (
                f"the frame {frame} and the movement are in different units, or far apart: the hand moves by "
                f"{odd[0].extent:.3g} with coordinates up to {np.abs(hand).max():.3g}, the frame has coordinates up to "
                f"{np.abs(place).max():.3g}; publish both in m"
            )
            found.append(Doubt("units", about, text, refuses=True))
    large = [one for one in shown if one.extent > LARGEST_M]
    if large and not found:
        about = () if len(large) == len(shown) else tuple(one.name for one in large)
        text = (
            f"positions span {np.median([one.extent for one in large]):.4g}, which is too far for an arm in m: they "
            "look like millimetres, centimetres or inches. The model will be in that unit, and settings in m, such as "
            "reg_covar, will be wrong; publish poses in m (REP 103)"
        )
        found.append(Doubt("units", about, text))
    return found


def _mixed_recordings(shown: Sequence[RawDemonstration]) -> list[Doubt]:
    extents = np.array([one.extent for one in shown])
    moving = np.flatnonzero(extents > 1e-6)
    if len(moving) < 2:
        return []
    usual = float(np.exp(np.median(np.log(extents[moving]))))
    if len(moving) == 2:
        usual = float(extents[moving].min())
    odd = [i for i in moving.tolist() if not 1.0 / MIXED < extents[i] / usual < MIXED]
    if not odd:
        return []
    names = tuple(shown[i].name for i in odd)
    text = (
        f"the hand moves by {extents[odd[0]]:.4g}, and by {usual:.3g} in the other recordings: the units differ, or it "
        "hardly moves in one of them; leave that one out, or record all in m"
    )
    return [Doubt("units", names, text, refuses=True)]


def _is_in_another_unit(one: RawDemonstration, frame: str) -> bool:
    place, extent = one.seen(frame)[:, :3], one.extent
    if extent > LARGEST_M:  # millimetres, by the look of it: then what is in metres is near the origin
        return bool(np.abs(place).max() < LARGEST_M < np.linalg.norm(one.movement[:, :3], axis=1).min())
    hand = one.movement[np.linspace(0, len(one.movement) - 1, 20).round().astype(int), :3]
    nearest = np.linalg.norm(hand[:, None] - place[None, :: max(1, len(place) // 20)], axis=2).min()
    return bool(nearest > max(FAR_M, MIXED * extent))


def doubts_of_speed(one: RawDemonstration) -> list[Doubt]:
    """Leaps of the movement, and speeds that no arm has.

    Parameters
    ----------
    one
        a recording

    Returns
    -------
    list[Doubt]
        the first leap of the position, and of the orientation
    """
    if one.extent > LARGEST_M or len(one.times) < 3:
        return []
    step = max(1, round(WINDOW_S / float(np.median(np.diff(one.times)))))
    step = min(step, len(one.times) - 1)
    seconds = one.times[step:] - one.times[:-step]
    ways = np.linalg.norm(one.movement[step:, :3] - one.movement[:-step, :3], axis=1)
    turns = quaternion.angle_between(one.movement[:-step, 3:], one.movement[step:, 3:])
    found = []
    for amounts, least, fastest, what, unit, scale in (
        (ways, LEAP_M, FASTEST, "the hand moves", "m", 1.0),
        (turns, LEAP_RAD, FASTEST_TURN, "the hand turns", "deg", 180.0 / np.pi),
    ):
        speeds = amounts / seconds
        leaps = (amounts > least) & ((speeds > fastest) | (speeds > LEAP * _usual(speeds)))
        if leaps.any():
            k = int(np.argmax(leaps))
            text = (
                f"{what} by {scale * amounts[k]:.3g} {unit} within {1e3 * seconds[k]:.0f} ms at "
                f"{one.times[k] - one.times[0]:.2f} s, and similarly in {np.count_nonzero(leaps)} of {len(leaps)} "
                "steps, which is too fast for an arm; its publisher jumps, or messages are in the wrong order"
            )
            found.append(Doubt("speed", (one.name,), text))
    return found


def _usual(amounts: Array) -> float:
    return float(np.quantile(amounts, 0.98))


def doubts_of_turns_taken(one: RawDemonstration) -> list[Doubt]:
    """A hand that goes to and fro with every message, as where two publishers take turns on its topic.

    Parameters
    ----------
    one
        a recording

    Returns
    -------
    list[Doubt]
        one at most
    """
    if len(one.times) < 5:
        return []
    near, far = (_off_the_line(one.movement[:, :3], k) for k in (1, 2))
    if near <= ZIGZAG_M or far >= ZIGZAG * near:
        return []
    text = (
        f"the hand goes to and fro by {near:.3g} m with every message, and every second pose goes on smoothly: two "
        "programs publish on its topic. Stop one of them, and record again"
    )
    return [Doubt("speed", (one.name,), text)]


def _off_the_line(places: Array, k: int) -> float:
    """Median distance of places (T, 3) from the middle between those k samples before and after."""
    return float(np.median(np.linalg.norm(places[k:-k] - 0.5 * (places[: -2 * k] + places[2 * k :]), axis=1)))


def doubts_of_joint_units(joints: Sequence[str], positions: Array) -> tuple[Doubt, ...]:
    """Positions of joints that are no rad, by magnitude.

    Degrees of a movement that stays near zero cannot be told from rad.

    Parameters
    ----------
    joints
        n names
    positions
        (T, n)

    Returns
    -------
    tuple[Doubt, ...]
        one at most
    """
    most = np.abs(positions).max(axis=0)
    k = int(np.argmax(most))
    if most[k] <= MOST_TURN:
        return ()
    turns = most[k] / (2.0 * np.pi)
    text = (
        f"the joint {one_line(joints[k])} is {most[k]:.4g} from its zero, which in rad is {turns:.0f} turns: it seems "
        "to be in degrees, or in steps of an encoder. Nothing was changed; publish rad (REP 103), and record again"
    )
    return (Doubt("units", (), text),)


def doubts_of_joint_limits(joints: Sequence[str], positions: Array, lower: Array, upper: Array) -> tuple[Doubt, ...]:
    """Positions that a robot's joints cannot have.

    Parameters
    ----------
    joints
        n names
    positions
        (T, n), rad or m
    lower, upper
        (n,) limits

    Returns
    -------
    tuple[Doubt, ...]
        one at most, about the joint that is furthest beyond
    """
    past = np.maximum(positions - upper, lower - positions)
    row, k = map(int, np.unravel_index(int(np.argmax(past)), past.shape))
    if past[row, k] <= BEYOND_LIMITS:
        return ()
    text = (
        f"the joint {one_line(joints[k])} is at {positions[row, k]:.3g}, beyond its limits {lower[k]:.3g} to "
        f"{upper[k]:.3g}: is this another robot, another zero, or another unit than rad and m? Correct the robot file "
        "of the task, or what publishes the joint states"
    )
    return (Doubt("units", (), text),)


def doubts_of_rounding(one: RawDemonstration) -> list[Doubt]:
    """Positions that are all multiples of a coarse step.

    Parameters
    ----------
    one
        a recording

    Returns
    -------
    list[Doubt]
        one at most
    """
    axis = int(np.argmax(np.ptp(one.movement[:, :3], axis=0)))
    values = np.unique(one.movement[:, axis])
    if not 4 <= len(values) <= len(one.times) / REPEATED:
        return []
    steps = np.diff(values)
    counts = steps / steps.min()
    if steps.min() < ROUNDED_M or np.abs(counts - counts.round()).max() > 1e-3:
        return []
    text = (
        f"its positions go in steps of {steps.min():.3g} m: they are rounded, so that between steps the hand seems to "
        "stand still. Publish all digits, and record again"
    )
    return [Doubt("speed", (one.name,), text)]


def doubts_of_stillness(one: RawDemonstration) -> list[Doubt]:
    """A movement all of whose poses are the same, bit by bit: the publisher repeats its last one."""
    if (one.movement == one.movement[0]).all():
        text = "the hand has the same pose in every message: its publisher had stopped updating it; record it again"
        return [Doubt("still", (one.name,), text)]
    return []
