# SPDX-License-Identifier: Apache-2.0
"""Demonstrations that fall into two groups, each of which agrees in itself: two tasks, two ways, two conventions.

One that is alone is found by `agreement`; where there are as many of one kind as of the other, none is odd.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from tpgmm_core.common.types import Array
from tpgmm_core.doubt.agreement import APART_M, APART_RAD, APART_SHARE, FURTHER, LASTS, SHARES, pairwise_distances
from tpgmm_core.doubt.doubts import Doubt, RawDemonstration, evenly_chosen

Members = NDArray[np.bool_]

FEWEST = 2
"""Demonstrations of a group."""
MOST = 60
"""Demonstrations that are compared, evenly chosen where there are more."""


def doubts_of_groups(shown: Sequence[RawDemonstration]) -> list[Doubt]:
    """Two groups whose members are all far from those of the other, for a while, in every frame.

    Parameters
    ----------
    shown
        demonstrations of one task

    Returns
    -------
    list[Doubt]
        one at most, about the smaller group
    """
    some = evenly_chosen(shown, MOST)
    if len(some) < 2 * FEWEST:
        return []
    positions, turns = pairwise_distances(some)
    extent = float(np.median([one.extent for one in some]))
    for distances, least, scale, form, unit in (
        (positions, max(APART_M, APART_SHARE * extent), 1.0, ".2f", "m"),
        (turns, APART_RAD, 180.0 / np.pi, ".0f", "deg"),
    ):
        found = _two_groups(distances, least)
        if found is None:
            continue
        smaller, share, apart = found
        names = tuple(one.name for one, is_in in zip(some, smaller.tolist(), strict=True) if is_in)
        text = (
            f"{len(names)} of {len(some)} demonstrations agree among themselves, and are {scale * apart:{form}} {unit} "
            f"or more from all others, at {100.0 * share:.0f} % of the time, in every frame: two tasks, two ways to do "
            "it, or two conventions of the poses (order of quaternions, handedness). A mean of both fits neither; "
            "train on each group by itself"
        )
        return [Doubt("misfit", names, text)]
    return []


def _two_groups(distances: Array, least: float) -> tuple[Members, float, float] | None:
    """The smaller group (M,) of distances (M, M, S), when it is farthest from the other, and how far that is."""
    best: tuple[Members, float, float] | None = None
    count = 0
    for s in range(SHARES):
        d = distances[..., s]
        members = _nearest_tree_cut(d)
        if min(members.sum(), (~members).sum()) < FEWEST:
            continue
        apart = float(d[np.ix_(members, ~members)].min())
        # each has to be near some of its own: the longest step within a group
        step = max(_longest_step(d[np.ix_(group, group)]) for group in (members, ~members))
        if apart > max(least, FURTHER * step):
            count += 1
            smaller = members if 2 * members.sum() <= len(members) else ~members
            if best is None or apart > best[2]:
                best = smaller, s / (SHARES - 1), apart
    return best if count >= LASTS * SHARES else None


def _nearest_tree_cut(d: Array) -> Members:
    """Whom (M,) the longest step of the tree of nearest neighbours separates from the last one that it reached."""
    order, steps = _tree(d)
    k = int(np.argmax(steps))
    members = np.zeros(len(d), np.bool_)
    members[order[k + 1 :]] = True
    return members


def _longest_step(d: Array) -> float:
    return float(max(_tree(d)[1], default=0.0))


def _tree(d: Array) -> tuple[list[int], list[float]]:
    """Prim's tree of distances (M, M): in which order nodes are reached, and by how long a step (M - 1)."""
    reached, order, steps = np.zeros(len(d), np.bool_), [0], []
    reached[0] = True
    near = d[0].copy()
    for _ in range(len(d) - 1):
        j = int(np.argmin(np.where(reached, np.inf, near)))
        steps.append(float(near[j]))
        order.append(j)
        reached[j] = True
        near = np.minimum(near, d[j])
    return order, steps
