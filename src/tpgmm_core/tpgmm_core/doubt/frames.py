# SPDX-License-Identifier: Apache-2.0
"""Frames that cannot be what the task takes them for: tags that change places, on the hand, or with inverted poses."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import combinations

import numpy as np

from tpgmm_core.common.types import Array
from tpgmm_core.doubt.doubts import Doubt, RawDemonstration, evenly_chosen
from tpgmm_core.geometry import quaternion
from tpgmm_core.geometry.pose import compose, inverse

APART_M, NEAR_M = 0.1, 0.03
"""Frames this far apart change places where each is then this near to where the other was."""
SWAP_S = 0.35
"""No hand exchanges two objects in this time."""
MOVES_M, RIGID_M, RIGID_RAD = 0.1, 0.01, 0.1
"""A frame is on the hand that moves by so much, where it keeps its place in it as well as this."""
SHARES = 50
AGREE, BETTER = np.array([[0.02], [0.1]]), 3.0
"""Poses of the hand in inverted poses agree within this, m and rad, and so many times better than as they are given."""
LEAST, MOST = 4, 60
"""Recordings from which on it is judged how they agree, and that are looked at, evenly chosen."""


def doubts_of_swaps(one: RawDemonstration) -> list[Doubt]:
    """Two frames that change places at once: tags or tracks were confused.

    Parameters
    ----------
    one
        a recording

    Returns
    -------
    list[Doubt]
        the first exchange of each two frames
    """
    found = []
    late = np.searchsorted(one.times, one.times + SWAP_S)
    k = np.flatnonzero(late < len(one.times))
    late = late[k]
    for a, b in combinations(one.frames, 2):
        p, q = one.frames[a][:, :3], one.frames[b][:, :3]
        seen = np.ones(len(p), bool)
        for name in (a, b):
            seen &= one.visible.get(name, seen)
        is_swap = (np.linalg.norm(p[k] - q[k], axis=1) > APART_M) & seen[k]
        is_swap &= (np.linalg.norm(p[late] - q[k], axis=1) < NEAR_M) & (np.linalg.norm(q[late] - p[k], axis=1) < NEAR_M)
        if is_swap.any():
            seconds = one.times[late[int(np.argmax(is_swap))]]
            text = (
                f"the frames {a} and {b} change places at {seconds:.2f} s: what sees them confuses them, "
                "and which is which before or after is not known. Correct it and record again, or leave the bag out"
            )
            found.append(Doubt("speed", (one.name,), text))
    return found


def doubts_of_frames_on_the_hand(shown: Sequence[RawDemonstration]) -> list[Doubt]:
    """Frames that move with the hand from the first to the last sample of every recording.

    Parameters
    ----------
    shown
        one or more

    Returns
    -------
    list[Doubt]
        one for each such frame
    """
    found = []
    for name in shown[0].frames:
        if all(name in one.frames and _is_on_the_hand(one, name) for one in shown):
            text = (
                f"the frame {name} moves with the hand, all the time: seen from it, nothing moves, and during the "
                "movement it goes wherever the hand goes, so that it cannot guide it. Is its tag on the gripper? Leave "
                "the frame out of the task file, or observe what the hand goes to"
            )
            found.append(Doubt("still", (), text))
    return found


def _is_on_the_hand(one: RawDemonstration, name: str) -> bool:
    if one.extent < MOVES_M or not one.visible.get(name, np.ones(1, bool)).all():
        return False
    poses = one.frames[name]
    fresh = np.flatnonzero(np.diff(poses, axis=0).any(axis=1)) + 1  # in between, it holds what was seen last
    if len(fresh) < LEAST:
        return False
    seen = compose(inverse(one.movement[fresh]), poses[fresh])
    way = np.linalg.norm(seen[:, :3] - np.median(seen[:, :3], axis=0), axis=1)
    turn = quaternion.angle_between(seen[:1, 3:], seen[:, 3:])
    moved = np.linalg.norm(np.ptp(poses[:, :3], axis=0))
    step = np.quantile(np.linalg.norm(np.diff(one.movement[:, :3], axis=0), axis=1), 0.95)
    rigid = max(RIGID_M, 1.5 * float(step))
    return bool(
        moved > max(MOVES_M, 5.0 * rigid) and np.quantile(way, 0.95) < rigid and np.quantile(turn, 0.95) < RIGID_RAD
    )


def doubts_of_inverse_poses(shown: Sequence[RawDemonstration]) -> list[Doubt]:
    """Frames in whose inverted poses demonstrations agree, and in whose own and the base they do not.

    Parameters
    ----------
    shown
        demonstrations of one task

    Returns
    -------
    list[Doubt]
        one for each such frame
    """
    if len(shown) < LEAST:
        return []
    shown = evenly_chosen(shown, MOST)
    samples = [np.linspace(0, len(one.times) - 1, SHARES).round().astype(int) for one in shown]
    hand = np.array([one.movement[at] for one, at in zip(shown, samples, strict=True)])
    found = []
    for name in shown[0].frames:
        if not all(name in one.frames and one.visible.get(name, np.ones(1, bool))[-1] for one in shown):
            continue
        place = np.array([one.frames[name][at] for one, at in zip(shown, samples, strict=True)])
        place[..., 3:] = quaternion.normalize(place[..., 3:])
        turned = place.copy()
        turned[..., 3:] = quaternion.conjugate(place[..., 3:])
        flat = place.copy()
        flat[..., 3:] = quaternion.IDENTITY
        own = _spreads(compose(inverse(place), hand))
        given = np.min([own, _spreads(compose(inverse(flat), hand)), _spreads(hand)], axis=0)
        ways = {"poses are inverted": inverse(place), "quaternions are conjugated": turned}
        spreads = {what: _spreads(compose(inverse(poses), hand)) for what, poses in ways.items()}
        what, other = min(spreads.items(), key=lambda item: item[1][0].min())
        is_odd = own.min(axis=1, keepdims=True) > AGREE  # as it is given, it sees no part of the movement alike
        agrees = is_odd & (other < AGREE) & (given > BETTER * np.maximum(other, AGREE / 2.0))
        if not agrees.any():
            continue
        kind, k = np.unravel_index(int(np.argmax(agrees)), agrees.shape)
        scale, unit = (1.0, "m") if kind == 0 else (180.0 / np.pi, "deg")
        text = (
            f"the frame {name}: its {what}, it seems. Seen from it, recordings differ by {scale * given[kind, k]:.2g} "
            f"{unit}, and by {scale * other[kind, k]:.2g} {unit} if that is undone. A pose is that of the frame in the "
            "base, not of the base in the frame; nothing was changed. Correct its publisher, or the transform of the "
            "camera"
        )
        found.append(Doubt("order", (), text))
    return found


def _spreads(poses: Array) -> Array:
    """How far poses (M, S, 7) are from their mean, (2, S): m, and rad."""
    way = poses[..., :3] - poses[..., :3].mean(axis=0)
    q = poses[..., 3:]
    mean = np.linalg.eigh(np.einsum("msi,msj->sij", q, q))[1][..., -1]
    turn = quaternion.angle_between(mean[None], q)
    return np.sqrt(np.stack([np.mean(np.sum(way**2, axis=-1), axis=0), np.mean(turn**2, axis=0)]))
