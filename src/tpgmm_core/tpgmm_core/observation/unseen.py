# SPDX-License-Identifier: Apache-2.0
"""Where frames are that are not seen, in demonstrations: the same rule for recordings and for masks of the API."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from tpgmm_core.common.types import Array, Nanoseconds
from tpgmm_core.geometry.frame import Frame
from tpgmm_core.model.demonstration import Demonstration
from tpgmm_core.observation.in_hand import carried_poses
from tpgmm_core.observation.streams import SECOND
from tpgmm_core.observation.tracked import TrackingConfig

STAYS = math.inf
"""For `hold_unseen`: it is where it was last seen, for ever."""
WITH_HAND = "with hand"
"""For `hold_unseen`: the same, or with the hand if it was last seen to move with it."""
START_TOLERANCE_S = 0.5
"""Topics start in any order when a recorder is switched on: a frame seen so soon was there all along."""


def last_seen(
    seen: Nanoseconds, at: Nanoseconds, unknown_after: float | None = None
) -> tuple[NDArray[np.intp], NDArray[np.bool_]]:
    """Which observation says where a frame is.

    Parameters
    ----------
    seen
        (S,) ns, increasing: times of the observations, at least one
    at
        (T,) ns, increasing
    unknown_after
        so long after an observation it is not known any more where the frame is, s; None: it is for ever

    Returns
    -------
    tuple[NDArray[np.intp], NDArray[np.bool_]]
        numbers (T,) of the latest observations, or of the first one before that; and where (T,) the frame is known: not
        before it was first seen, unless that was within `START_TOLERANCE_S` of the first time
    """
    latest = np.searchsorted(seen, at, side="right") - 1
    known = latest >= 0
    if seen[0] - at[0] <= START_TOLERANCE_S * SECOND:
        known[:] = True
    latest = np.maximum(latest, 0)
    if unknown_after is not None:
        known &= at - seen[latest] <= unknown_after * SECOND
    return latest, known


def hold_unseen(demonstration: Demonstration, unseen: Mapping[str, float | str]) -> Demonstration:
    """A demonstration whose frames are where they must be while they are not seen, as in recordings.

    Without this, a frame that is masked says nothing: neither to what is learned nor to what is reproduced.

    Parameters
    ----------
    demonstration
        with masks of what was seen; what its frames hold at other samples is not used
    unseen
        frame name → `STAYS`; the time in s after which it is not known any more; or `WITH_HAND`, for data
        [time, x, y, z, qx, qy, qz, qw] of the hand and frames of poses. Other frames remain as they are

    Returns
    -------
    Demonstration
        masks are False only where it is not known where a frame was

    Raises
    ------
    ValueError
        a frame that there is not or that was never seen, a negative time, or data and frames that are no poses.
    """
    at = np.round(SECOND * demonstration.times).astype(np.int64)
    frames, visible = dict(demonstration.frames), dict(demonstration.visible or {})
    for name, rule in unseen.items():
        if name not in frames:
            raise ValueError(f"unseen names {name!r}; the demonstration has {sorted(frames)}")
        if rule != WITH_HAND and not (isinstance(rule, int | float) and rule >= 0.0):
            raise ValueError(f"unseen[{name!r}] is {rule!r}; expected STAYS, WITH_HAND or a time >= 0 s")
        mask = demonstration.is_visible(name)
        if not mask.any():
            raise ValueError(f"frame {name!r} was never seen: nothing says where it is; leave it out")
        samples = np.flatnonzero(mask)
        which, known = last_seen(at[samples], at, None if isinstance(rule, str) else float(rule))
        if frames[name].is_time_varying:
            held = frames[name].at(samples[which])
            if rule == WITH_HAND:
                hand, poses = _hand(demonstration), _poses(name, held)
                timeout = TrackingConfig().visible_timeout
                carried, _ = carried_poses(at, hand, at[samples], poses[samples], poses, timeout)
                held = Frame.from_pose(carried[:, :3], carried[:, 3:]).with_time()
            frames[name] = held
        elif rule in (STAYS, WITH_HAND):
            known[:] = True  # it never moves: one look says where it is
        visible[name] = known
    return replace(demonstration, frames=frames, visible={n: mask for n, mask in visible.items() if not mask.all()})


def _hand(demonstration: Demonstration) -> Array:
    """(T, 7), in the common frame."""
    if demonstration.data.shape[1] != 8:
        raise ValueError(f"with the hand, the data is [time, pose], of 8 dimensions; got {demonstration.data.shape[1]}")
    return demonstration.data[:, 1:]


def _poses(name: str, frame: Frame) -> Array:
    """(T, 7), where a frame of [time, pose] is."""
    # where the frame sees the pose that is its own: the origin, not turned
    origin = np.array([0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0])
    poses: Array = (frame.A @ origin + frame.b)[:, 1:]
    again = Frame.from_pose(poses[:, :3], poses[:, 3:]).with_time()
    if not (np.allclose(again.A, frame.A, atol=1e-6) and np.allclose(again.b, frame.b, atol=1e-6)):
        raise ValueError(f"with the hand, {name!r} has to be a frame of a pose: Frame.from_pose(...).with_time()")
    return poses
