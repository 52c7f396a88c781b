# SPDX-License-Identifier: Apache-2.0
"""Demonstrations that are not like the others: in duration, in length, in what they show; and copies.

What a demonstration shows is compared as frames see it. Some frame should see it where it saw the others: the distance
of a demonstration from the others, at each share of the time, is the median of those from each of them, in the frame in
which this is least. A demonstration that is far from the others by this measure, for a while, and far more than they
are from one another, shows something else. Nothing is fitted.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import NDArray

from tpgmm_core.common.types import Array
from tpgmm_core.doubt.doubts import Doubt, RawDemonstration
from tpgmm_core.geometry import quaternion
from tpgmm_core.geometry.pose import compose, inverse

FACTOR = 3.0
"""Durations and lengths that differ from the median by more are said."""
SHORTEST_M = 0.02
SHARES = 50
AHEAD = 5
"""Shares by which demonstrations may be ahead of one another."""
FROM_START = 1
"""Number of the view from the first pose."""
MOST = 30
"""Demonstrations that each one is held against."""
LASTS = 0.1
"""Share of the time for which a demonstration has to be elsewhere."""
FURTHER = 3.0
"""How many times as far as the others from one another."""
APART_M, APART_SHARE, APART_RAD = 0.03, 0.15, 0.8
"""What is less, also in shares of the movement's extent, is how movements differ."""


def doubts_of_durations(shown: Sequence[RawDemonstration]) -> list[Doubt]:
    """Durations and lengths of paths that differ from the median by factors; from three recordings on."""
    if len(shown) < 3:
        return []
    found = []
    for kind, values, unit, least in (
        ("duration", np.array([one.duration for one in shown]), "s", 0.0),
        ("length", np.array([one.length for one in shown]), "m", SHORTEST_M),
    ):
        usual = float(np.median(values))
        for one, value in zip(shown, values.tolist(), strict=True):
            if max(value, usual) > least and not usual / FACTOR <= value <= usual * FACTOR:
                what = "takes" if kind == "duration" else "its path is"
                text = (
                    f"{what} {value:.3g} {unit}, the others {usual:.3g} {unit} (median); check that it "
                    "holds one complete movement; trim it, or leave it out"
                )
                found.append(Doubt(kind, (one.name,), text))
    return found


def doubts_of_copies(shown: Sequence[RawDemonstration]) -> list[Doubt]:
    """Recordings that hold the same movement, number by number: one counts twice."""
    first: dict[bytes, str] = {}
    found = []
    for one in shown:
        key = one.movement.tobytes()
        if key in first:
            found.append(Doubt("copy", (first[key], one.name), "hold exactly the same movement; leave out one of them"))
        first.setdefault(key, one.name)
    return found


def doubts_of_misfits(shown: Sequence[RawDemonstration]) -> list[Doubt]:
    """Demonstrations that no frame sees where it sees the others: named, with when and how far; from three on.

    Parameters
    ----------
    shown
        demonstrations of one task

    Returns
    -------
    list[Doubt]
        one for each demonstration that does not fit
    """
    if len(shown) < 3:
        return []
    positions, turns = distances_from_others(shown)
    extent = float(np.median([one.extent for one in shown]))
    found = []
    for i, one in enumerate(shown):
        parts = []
        for distances, least, scale, form, unit in (
            (positions, max(APART_M, APART_SHARE * extent), 1.0, ".2f", "m"),
            (turns, APART_RAD, 180.0 / np.pi, ".0f", "deg"),
        ):
            usual = np.median(distances, axis=0)
            limit = np.maximum(least, FURTHER * np.maximum(usual, np.median(usual)))
            begin, end = _longest_run(distances[i] > limit)
            if end - begin >= LASTS * SHARES:
                most = begin + int(np.argmax(distances[i][begin:end]))
                seconds = one.duration * np.array([begin, end - 1, most]) / (SHARES - 1)
                parts.append(
                    f"from {seconds[0]:.2f} to {seconds[1]:.2f} s it is {scale * distances[i][most]:{form}} {unit} "
                    f"(at {seconds[2]:.2f} s) from where the others are, which differ by {scale * usual[most]:{form}}"
                )
        if parts:
            way = _other_way(i, shown)
            text = (
                f"does not fit the others in any frame: {'; '.join(parts)}{way}. If it shows something else, leave it "
                "out; if not, record more like it"
            )
            found.append(Doubt("misfit", (one.name,), text))
    return found


def distances_from_others(shown: Sequence[RawDemonstration]) -> tuple[Array, Array]:
    """How far each demonstration is from the others, in the frame that sees it nearest to them.

    Where the movement begins is a frame for positions only if the task has it, and one for orientations in any case.

    Parameters
    ----------
    shown
        M of one task, two or more

    Returns
    -------
    tuple[Array, Array]
        distances (M, SHARES), m, and angles (M, SHARES), rad, at even shares of the time
    """
    views = _views(shown)
    # a hand that begins turned otherwise turns on the way; one that begins elsewhere comes another way
    known = [view for k, view in enumerate(views) if k != FROM_START or any(one.from_start for one in shown)]
    return _distances(known, _way), _distances(views, _turn)


def pairwise_distances(shown: Sequence[RawDemonstration]) -> tuple[Array, Array]:
    """How far each two demonstrations are from one another, in the frame that sees them nearest to one another.

    Where the movement begins is a frame only if the task has it: the mean of two that begin elsewhere is neither.

    Parameters
    ----------
    shown
        M of one task, two or more

    Returns
    -------
    tuple[Array, Array]
        distances (M, M, SHARES), m, and angles (M, M, SHARES), rad, at even shares of the time
    """
    views = _views(shown)
    if not any(one.from_start for one in shown):
        del views[FROM_START]
    way, turn = ([_between(view, view, apart) for view in views] for apart in (_way, _turn))
    return np.asarray(np.min(way, axis=0)), np.asarray(np.min(turn, axis=0))


def _way(one: Array, other: Array) -> Array:
    return np.asarray(np.linalg.norm(one[..., :3] - other[..., :3], axis=-1))


def _turn(one: Array, other: Array) -> Array:
    return np.asarray(quaternion.angle_between(one[..., 3:], other[..., 3:]))


def _views(shown: Sequence[RawDemonstration]) -> list[Array]:
    """Poses (M, S, 7) as each frame sees them, as the base does, and as the first pose of the movement does."""
    samples = [
        np.abs(np.linspace(one.times[0], one.times[-1], SHARES)[:, None] - one.times).argmin(axis=1) for one in shown
    ]
    poses = np.array([one.movement[at] for one, at in zip(shown, samples, strict=True)])
    views = [poses, compose(inverse(poses[:, :1]), poses)]
    for frame in dict.fromkeys(frame for one in shown for frame in one.frames):
        if all(frame in one.frames for one in shown):
            places = np.array([one.frames[frame][at] for one, at in zip(shown, samples, strict=True)])
            places[..., 3:] = quaternion.normalize(places[..., 3:])
            views.append(compose(inverse(places), poses))
            turned = places.copy()
            turned[..., 3:] = quaternion.IDENTITY
            views.append(compose(inverse(turned), poses))
    return views


def _distances(views: Sequence[Array], distance: Callable[[Array, Array], Array]) -> Array:
    """How far each demonstration is from the others in the frame in which it is nearest, (M, S).

    A pose is held against those at nearly the same share of the time: some are a little ahead of the others.
    """
    found = []
    for view in views:
        others = view[: MOST * (len(view) // MOST) or None : max(1, len(view) // MOST)]
        itself = int(len(others) == len(view))
        middle = itself + (len(others) - itself - 1) // 2
        parts = [view[k : k + MOST] for k in range(0, len(view), MOST)]  # the memory is that of one part
        found.append(np.concatenate([np.sort(_between(part, others, distance), axis=1)[:, middle] for part in parts]))
    return np.asarray(np.min(found, axis=0))


def _between(view: Array, others: Array, distance: Callable[[Array, Array], Array]) -> Array:
    """Distances (M, N, S) of poses (M, S, 7) from others (N, S, 7) at nearly the same share of the time."""
    shares = np.arange(SHARES)
    between = np.full((len(view), len(others), SHARES), np.inf)
    for shift in range(-AHEAD, AHEAD + 1):
        moved = others[:, np.clip(shares + shift, 0, SHARES - 1)]
        between = np.minimum(between, distance(view[:, None], moved[None]))
    return between


def _longest_run(is_far: NDArray[np.bool_]) -> tuple[int, int]:
    """First and last + 1 of the longest run of True."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], is_far, [False]]).astype(int)))
    runs = list(zip(edges[::2].tolist(), edges[1::2].tolist(), strict=True))
    return max(runs, key=lambda run: run[1] - run[0], default=(0, 0))


def _other_way(i: int, shown: Sequence[RawDemonstration]) -> str:
    """Words for a demonstration that turns the other way round."""
    turns = np.array([_turned(one) for one in shown])
    others = np.median(np.delete(turns, i, axis=0), axis=0)
    mine, usual = float(np.linalg.norm(turns[i])), float(np.linalg.norm(others))
    if min(mine, usual) < 1.0 or turns[i] @ others > -0.5 * mine * usual:
        return ""
    return (
        f"; it turns by {np.degrees(mine):.0f} deg in the opposite direction to the others ({np.degrees(usual):.0f} "
        "deg)"
    )


def _turned(one: RawDemonstration) -> Array:
    """The sum of all turns of a movement about the axes of its first pose, (3,) rad: more than half a turn counts."""
    first = quaternion.conjugate(one.movement[0, 3:])
    relative = quaternion.multiply(first, one.movement[:, 3:])
    steps = quaternion.log(quaternion.multiply(quaternion.conjugate(relative[:-1]), relative[1:]))
    return np.asarray(steps.sum(axis=0))
