# SPDX-License-Identifier: Apache-2.0
"""What is known of each frame right now: seen, remembered or lost, and how far it can be trusted.

A frame that is not seen for a moment keeps its last pose. Its confidence, which scales its precision in the product
of Gaussians (Eqs. 5, 6), falls to zero slowly and rises slowly, so that a frame that disappears or comes back never
makes the movement jump. A noisy pose is averaged while the frame is at rest (`pose_filter`).

Two clocks enter, as arguments: the *stamp* of an observation (ROS time, when the camera saw it) and the *steady* time
of its arrival. The status follows the steady clock, which no clock step can stall; stamps are checked when they come.
"""

from __future__ import annotations

import enum
import math
from collections.abc import Iterable
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import ArrayLike, NDArray

from tpgmm_core.common.settings import check_settings, setting
from tpgmm_core.observation.pose_filter import PoseFilter

_SECOND = 1_000_000_000
#: Largest number of a pose: beyond the size of the Earth, m, and any length of a quaternion.
MAX_NUMBER = 1e8


class FrameStatus(enum.IntEnum):
    """Statuses as in ``tpgmm_msgs/TaskFrame``."""

    VISIBLE = 0
    HELD = 1
    MISSING = 2


@dataclass(frozen=True, slots=True, kw_only=True)
class TrackingConfig:
    """When a frame counts as seen, remembered or lost, s.

    Without an observation for ``visible_timeout`` a frame is HELD: it keeps its confidence for ``hold_time``, loses it
    over ``fade_time``, and then is MISSING. Stamps too far from ROS time are refused: a camera with a wrong clock, a
    queue that was held up, an old bag.
    """

    visible_timeout: float = setting(
        0.25, 0.001, 60.0, "A frame that was not seen for this long is held at its last pose, s"
    )
    hold_time: float = setting(2.0, 0.0, 3600.0, "How long a held frame keeps its full weight, s")
    fade_time: float = setting(
        0.5, 0.01, 60.0, "Time over which it then loses its weight, and gains it when seen again, s"
    )
    max_future: float = setting(0.05, 0.0, 60.0, "Poses with stamps further in the future are refused, s")
    max_age: float = setting(1.0, 0.001, 3600.0, "Poses with older stamps are refused, s")
    filter_time: float = setting(
        1.0, 0.0, 60.0, "Noisy poses are averaged over this time while the frame is at rest, s; 0: never"
    )

    def __post_init__(self) -> None:
        """Raise ValueError for a value out of its range."""
        check_settings(self)


@dataclass(frozen=True, slots=True)
class TrackedFrame:
    """One frame as it is known at one moment.

    Parameters
    ----------
    name
        of the frame
    status
        VISIBLE, HELD or MISSING
    confidence
        0..1, 0 where MISSING
    stamp_ns
        ROS time of the observation that the pose comes from, ns
    pose
        ``[x, y, z, qx, qy, qz, qw]`` in the base frame, m, filtered; None as long as it was never seen
    """

    name: str
    status: FrameStatus
    confidence: float
    stamp_ns: int
    pose: NDArray[np.float64] | None


@dataclass(slots=True)
class _Track:
    fixed: bool
    filter: PoseFilter
    pose: NDArray[np.float64] | None = None
    stamp_ns: int = 0
    seen_ns: int = 0  # steady
    confidence: float = 0.0
    refused: dict[str, int] = field(default_factory=dict)


class FrameTracker:
    """Observations in, statuses and confidences out.

    Parameters
    ----------
    frames
        names of the frames to track
    fixed
        poses of the frames that never move and are never lost, e.g. the robot's own base
    config
        the timeouts

    Raises
    ------
    ValueError
        for no frames, or a fixed pose that is invalid
    """

    def __init__(
        self,
        frames: Iterable[str],
        fixed: dict[str, ArrayLike] | None = None,
        config: TrackingConfig | None = None,
    ) -> None:
        self.config = config or TrackingConfig()
        memory = self.config.filter_time
        self._tracks = {name: _Track(fixed=False, filter=PoseFilter(memory)) for name in frames}
        for name, pose in (fixed or {}).items():
            checked, reason = check_pose(pose)
            if checked is None:
                raise ValueError(f"frame '{name}': {reason}")
            self._tracks[name] = _Track(fixed=True, filter=PoseFilter(0.0), pose=checked, confidence=1.0)
        if not self._tracks:
            raise ValueError("no frames to track: name at least one")
        if memory > 0.0:
            PoseFilter.compile_kernels()
        self._updated_ns: int | None = None

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the frames that are tracked."""
        return tuple(self._tracks)

    def refusals(self, name: str) -> dict[str, int]:
        """Number of refused observations of a frame so far, by reason."""
        return dict(self._tracks[name].refused)

    def observe(self, name: str, pose: ArrayLike, stamp_ns: int, now_ns: int, steady_ns: int) -> str | None:
        """Add one observation.

        Parameters
        ----------
        name
            the frame
        pose
            ``[x, y, z, qx, qy, qz, qw]`` in the base frame; the quaternion may have any non-zero length
        stamp_ns
            when it was seen, ROS time
        now_ns
            ROS time at arrival
        steady_ns
            steady time at arrival

        Returns
        -------
        str | None
            None if it was used, else why not; the frame then stays as it was

        Raises
        ------
        KeyError
            for an unknown frame
        """
        track = self._tracks[name]
        checked, reason = check_pose(pose)
        if checked is None:
            return self.refuse(name, reason)
        if reason := self._check_stamp(track, stamp_ns, now_ns):
            return self.refuse(name, reason)
        track.pose, track.stamp_ns, track.seen_ns = track.filter.observe(checked, stamp_ns), stamp_ns, steady_ns
        return None

    def refuse(self, name: str, reason: str) -> str:
        """Count an observation that is not used; returns the reason with the frame's name.

        Parameters
        ----------
        name
            the frame
        reason
            its kind, ":", and the details

        Returns
        -------
        str
            the reason, with the frame's name
        """
        kind = reason.split(":", 1)[0]
        refused = self._tracks[name].refused
        refused[kind] = refused.get(kind, 0) + 1
        return f"frame '{name}': {reason}"

    def _check_stamp(self, track: _Track, stamp_ns: int, now_ns: int) -> str:
        if track.fixed:
            return "fixed frame: its pose is given by the task file, observations are not used"
        age = (now_ns - stamp_ns) / _SECOND
        if age < -self.config.max_future:
            return f"stamp in the future: {-age:.3f} s ahead of ROS time, {self.config.max_future} s allowed"
        if age > self.config.max_age:
            return f"stamp too old: {age:.3f} s behind ROS time, {self.config.max_age} s allowed"
        if stamp_ns == track.stamp_ns:
            return "repeated stamp: the same observation came before"
        if stamp_ns < track.stamp_ns:
            return "stamp out of order: older than the observation that is known already"
        return ""

    def forget(self) -> None:
        """Forget all observations (time jumped backwards: a looped bag, a restarted simulation)."""
        for track in self._tracks.values():
            if not track.fixed:
                track.pose, track.stamp_ns, track.seen_ns, track.confidence = None, 0, 0, 0.0
                track.filter.forget()
        self._updated_ns = None

    def update(self, steady_ns: int) -> list[TrackedFrame]:
        """All frames as they are known at a steady time; call it regularly, since confidences change with time."""
        elapsed = 0.0 if self._updated_ns is None else max(0.0, (steady_ns - self._updated_ns) / _SECOND)
        first = self._updated_ns is None
        self._updated_ns = steady_ns
        return [self._update(name, track, steady_ns, elapsed, first) for name, track in self._tracks.items()]

    def _update(self, name: str, track: _Track, steady_ns: int, elapsed: float, first: bool) -> TrackedFrame:
        if track.fixed:
            return TrackedFrame(name, FrameStatus.VISIBLE, 1.0, 0, track.pose)
        config = self.config
        unseen = math.inf if track.pose is None else (steady_ns - track.seen_ns) / _SECOND
        trusted = unseen <= config.visible_timeout + config.hold_time
        # Before the first update no confidence was published, so there is nothing to be continuous with.
        change = 1.0 if first else elapsed / config.fade_time
        if trusted:
            track.confidence = min(1.0, track.confidence + change)
        else:
            track.confidence = max(0.0, track.confidence - change)
        if unseen <= config.visible_timeout:
            status = FrameStatus.VISIBLE
        elif track.confidence > 0.0 and track.pose is not None:
            status = FrameStatus.HELD
        else:
            status = FrameStatus.MISSING
        return TrackedFrame(name, status, track.confidence, track.stamp_ns, track.pose)


def check_pose(pose: ArrayLike) -> tuple[NDArray[np.float64] | None, str]:
    """The pose with its quaternion at unit length, or None and the reason why it is no pose.

    Parameters
    ----------
    pose
        ``[x, y, z, qx, qy, qz, qw]``

    Returns
    -------
    tuple[NDArray[np.float64] | None, str]
        the pose (7,) and an empty text, or None and the reason
    """
    checked = np.array(pose, dtype=np.float64)
    if checked.shape != (7,):
        return None, f"wrong size: shape {checked.shape}, expected 7 numbers x y z qx qy qz qw"
    if not np.isfinite(checked).all():
        return None, f"not finite: {checked.tolist()}"
    if np.abs(checked).max() > MAX_NUMBER:  # squares of larger numbers are not finite, and no camera sees so far
        return None, f"implausibly large: {checked.tolist()}, expected numbers up to {MAX_NUMBER:g} (m)"
    if np.any((checked != 0.0) & (np.abs(checked) < np.finfo(np.float64).tiny)):
        # rclpy copies the bits of a Python int into a float field, without an error
        return None, f"not written as floats: {checked.tolist()}; an int in a float field reads so: write 1.0, not 1"
    length = float(np.linalg.norm(checked[3:]))
    if length < 1e-3:
        return None, f"zero quaternion: {checked[3:].tolist()} has length {length:.3g}, expected 1"
    checked[3:] /= length
    return checked, ""
