# SPDX-License-Identifier: Apache-2.0
"""Quaternions that look as if they were written w, x, y, z, where x, y, z, w is read.

Read in the wrong order, a rotation R becomes P R^T Q with constant rotations P and Q: angles between rotations stay as
they are. So a movement by itself, however smooth, says nothing. What can tell:

- demonstrations agree in some frame in the one order, and disagree in the other: where the hand is in the frame of an
  object that is turned from one recording to the next, and how it is turned there;
- objects stand upright and are turned about the vertical in the one order, and hang upside down and are turned about
  their horizontal x axis in the other;
- one recording, or some of them, are turned far from all others in the one order, and are among them in the other;
- all that was observed, hand and objects, begins near no rotation in the one order, and upside down in the other; or
  an orientation that nobody measured is 1 0 0 0, bit by bit.

A hand alone that points downwards is 1 0 0 0 in the right order, as no rotation is in the wrong one: nothing is said.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from tpgmm_core.common.text import listed
from tpgmm_core.common.types import Array
from tpgmm_core.doubt.doubts import Doubt, RawDemonstration
from tpgmm_core.geometry import quaternion

MOVEMENT = "the movement"
SHARES = 50
LEAST = 3
"""Recordings from which on it is judged how they agree."""
TURNED_RAD = 0.3
"""By which a frame has to be turned from recording to recording, so that its orders can be told apart."""
AGREE_M, AGREE_RAD = 0.02, 0.15
BETTER = 3.0
"""How many times nearer to one another demonstrations have to be in the other order."""
NEAR_IDENTITY = 0.97
"""|w| of rotations by less than 28 degrees."""
NEAR_AXIS = 0.1
ODD, AMONG = 2.5, 1.5
"""One is odd whose nearest is so many times as far as those of the others are, and among them within so many times."""
ODD_RAD = 1.5
"""By which one recording has to be turned from all others, so that its order is doubted alone."""


def doubts_of_quaternion_order(shown: Sequence[RawDemonstration]) -> list[Doubt]:
    """A suspicion, where one is likely: nothing is corrected.

    Parameters
    ----------
    shown
        one or more

    Returns
    -------
    list[Doubt]
        one about all of them; else those that are about single ones, which are not as the others
    """
    common = [name for name in shown[0].frames if all(len(one.seen(name)) for one in shown if name in one.frames)]
    frames = [name for name in common if all(name in one.frames for one in shown)]
    reasons: dict[str, str] = {}
    for name in frames:
        reason = _unmeasured([one.seen(name) for one in shown])
        reason = reason or _upside_down([one.seen(name) for one in shown]) or _places_agree(shown, name)
        if reason:
            reasons[name] = reason
    others = [one.movement for one in shown]
    reason = _unmeasured(others) or next(
        filter(None, (_turns_agree(shown, name, name in reasons) for name in frames)), ""
    )
    if reason:
        reasons[MOVEMENT] = reason
    if not reasons and frames and all(_begins_so([one.seen(name)[:1] for one in shown]) for name in frames):
        if _begins_so([one.movement[:1] for one in shown]):
            reasons[listed([MOVEMENT, *frames])] = (
                "all begin near 1 0 0 0, which means upside down in the order x, y, z, w, and no rotation in w, x, y, z"
            )
    if reasons:
        return [_suspicion((), reasons)]
    odd = [_suspicion((shown[i].name,), found) for i, found in _odd_ones(shown, frames).items()]
    return odd or _odd_part(shown)


def _suspicion(about: tuple[str, ...], reasons: Mapping[str, str]) -> Doubt:
    text = (
        f"quaternions seem to be in the order w, x, y, z, but are read as x, y, z, w: "
        f"{'; '.join(f'{name}: {why}' for name, why in reasons.items())}. Nothing was changed. If this is true, "
        "convert arrays with --orientation wxyz, or correct the publisher of the poses (geometry_msgs/Quaternion is "
        "x, y, z, w) and record again"
    )
    return Doubt("order", about, text)


def _odd_ones(shown: Sequence[RawDemonstration], frames: Sequence[str]) -> dict[int, dict[str, str]]:
    """Recordings whose turns are far from those of all others, and near them in the other order; by what is so."""
    found: dict[int, dict[str, str]] = {}
    if len(shown) < LEAST + 1:
        return found
    streams = {MOVEMENT: [one.movement[[0, -1], 3:] for one in shown]}
    streams |= {name: [quaternion.normalize(one.seen(name)[[0, -1], 3:]) for one in shown] for name in frames}
    for name, turns in streams.items():
        q = np.array(turns)
        near, who = _two_nearest(q)
        for i in range(len(shown)):
            without = np.where(who == i, near[1], near[0])
            apart = np.delete(without, i, axis=0).max(axis=0)
            angles, in_order = near[0, i], _nearest(w_first(q[i]), np.delete(q, i, axis=0))
            is_odd = angles > np.maximum(ODD_RAD, ODD * apart)
            if (is_odd & (in_order < np.maximum(AGREE_RAD, AMONG * apart))).any():
                k = int(np.argmax(angles - in_order))
                as_read, other = angles[k], in_order[k]
                found.setdefault(i, {})[name] = (
                    f"as it is read, it is {np.degrees(as_read):.0f} deg from how it is in any other recording, and "
                    f"with w first {np.degrees(other):.0f} deg from the nearest"
                )
    # a hand that points downwards and takes hold turned by half a turn is as one in the other order: frames must say it
    return {i: reasons for i, reasons in found.items() if set(reasons) != {MOVEMENT}}


def _odd_part(shown: Sequence[RawDemonstration]) -> list[Doubt]:
    """Several recordings whose hand begins far from all others, and among them in the other order."""
    q = np.array([one.movement[:1, 3:] for one in shown])
    in_order = (quaternion.angle_between(q[:1], q) <= quaternion.angle_between(q[:1], w_first(q)))[:, 0]
    is_odd = in_order if 2 * in_order.sum() < len(q) else ~in_order
    same, other = q[~is_odd], q[is_odd]
    if len(other) < 2:
        return []
    apart = max(float(_nearest(one, np.delete(same, j, axis=0))[0]) for j, one in enumerate(same))
    given = min(float(_nearest(one, same)[0]) for one in other)
    turned = max(float(_nearest(w_first(one), same)[0]) for one in other)
    if given < max(ODD_RAD, AMONG * apart, BETTER * turned):
        return []
    names = tuple(one.name for one, odd in zip(shown, is_odd.tolist(), strict=True) if odd)
    reason = (
        f"as it is read, it begins {np.degrees(given):.0f} deg or more from how it begins in the other recordings, and "
        f"with w first at most {np.degrees(turned):.0f} deg from the nearest"
    )
    return [_suspicion(names, {MOVEMENT: reason})]


def _nearest(q: Array, others: Array) -> Array:
    """Angles (S,) of rotations (S, 4) from the nearest of others (M, S, 4)."""
    return np.asarray(quaternion.angle_between(q[None], others).min(axis=0))


def _two_nearest(q: Array) -> tuple[Array, NDArray[np.intp]]:
    """Angles (2, M, S) of each of rotations (M, S, 4) from the two nearest others, and which (M, S) is the nearest."""
    near, who = np.empty((2, *q.shape[:2])), np.empty(q.shape[:2], np.intp)
    for j, one in enumerate(q):
        angles = quaternion.angle_between(one[None], q)
        angles[j] = np.inf
        who[j] = angles.argmin(axis=0)
        near[:, j] = np.partition(angles, 1, axis=0)[:2]
    return near, who


def w_first(q: Array) -> Array:
    """Quaternions (..., 4) read in the other order: what stands first is taken for w."""
    return np.roll(q, -1, axis=-1)


def _unmeasured(poses: Sequence[Array]) -> str:
    """The number 1 0 0 0, in all samples: what is written where no orientation is known, in the other order."""
    is_so = all((np.abs(each[:, 3:]) == [1.0, 0.0, 0.0, 0.0]).all() for each in poses)
    return "is 1 0 0 0 in every sample, which is the default value in the order w, x, y, z" if is_so else ""


def _upside_down(poses: Sequence[Array]) -> str:
    q = np.concatenate([each[:, 3:] for each in poses])
    q = q * np.where(q[:, :1] < 0.0, -1.0, 1.0)
    angles = 2.0 * np.arctan2(q[:, 3], q[:, 0])
    if np.abs(q[:, 1:3]).max() > NEAR_AXIS or np.ptp(angles) < TURNED_RAD or np.mean(q[:, 0]) < 0.8:
        return ""
    return (
        "as x, y, z, w, it is upside down and turns about its horizontal x axis; as w, x, y, z, it is "
        f"upright and turns about the vertical axis, by {np.degrees(np.ptp(angles)):.0f} deg in total"
    )


def _places_agree(shown: Sequence[RawDemonstration], frame: str) -> str:
    """Whether the hand is at the same place of a frame in the other order only."""
    found = _at_shares(shown, frame)
    if found is None:
        return ""
    hand, place = found
    way = hand[..., :3] - place[..., :3]
    spreads = []
    for q in (place[..., 3:], w_first(place[..., 3:])):
        seen = np.einsum("msji,msj->msi", quaternion.rotation_matrix(q), way)
        spreads.append(np.sqrt(np.mean(np.sum((seen - seen.mean(axis=0)) ** 2, axis=-1), axis=0)).min())
    is_upright = np.abs(place[..., 3]).mean() > np.abs(place[..., 6]).mean()
    if not is_upright or spreads[1] > AGREE_M or spreads[0] < max(AGREE_M, BETTER * spreads[1]):
        return ""
    return (
        f"the positions of the hand relative to it differ by {spreads[0]:.2g} m between recordings, and with w first "
        f"by {spreads[1]:.2g} m"
    )


def _turns_agree(shown: Sequence[RawDemonstration], frame: str, frame_is_w_first: bool) -> str:
    """Whether the hand is turned alike in a frame in the other order only."""
    found = _at_shares(shown, frame)
    if found is None:
        return ""
    hand, place = (poses[..., 3:] for poses in found)
    place = w_first(place) if frame_is_w_first else place
    given, other = (_spread(quaternion.multiply(quaternion.conjugate(place), q)).min() for q in (hand, w_first(hand)))
    if other > AGREE_RAD or given < max(2.0 * AGREE_RAD, BETTER * other):
        return ""
    return (
        f"relative to the frame {frame}, its orientations differ by {np.degrees(given):.0f} deg between recordings, "
        "and "
        f"with w first by {np.degrees(other):.0f} deg"
    )


def _at_shares(shown: Sequence[RawDemonstration], frame: str) -> tuple[Array, Array] | None:
    """Poses of the hand and of a frame, (M, S, 7), where all saw it; None where its order cannot be told."""
    samples = [np.linspace(0, len(one.times) - 1, SHARES).round().astype(int) for one in shown]
    hand, place = (
        np.array([poses[at] for poses, at in zip(each, samples, strict=True)])
        for each in ([one.movement for one in shown], [one.frames[frame] for one in shown])
    )
    were_seen = [
        one.visible.get(frame, np.ones(len(one.times), bool))[at] for one, at in zip(shown, samples, strict=True)
    ]
    seen = np.all(were_seen, axis=0)
    if len(shown) < LEAST or not seen.any():
        return None
    hand, place = hand[:, seen], place[:, seen]
    place[..., 3:] = quaternion.normalize(place[..., 3:])
    return (hand, place) if _spread(place[..., 3:]).max() > TURNED_RAD else None


def _spread(q: Array) -> Array:
    """Mean angle (S,) of rotations (M, S, 4) from their mean."""
    mean = np.linalg.eigh(np.einsum("msi,msj->sij", q, q))[1][..., -1]
    return np.asarray(quaternion.angle_between(mean[None], q).mean(axis=0))


def _begins_so(first: Sequence[Array]) -> bool:
    return all(bool((np.abs(poses[:, 3]) > NEAR_IDENTITY).all()) for poses in first)
