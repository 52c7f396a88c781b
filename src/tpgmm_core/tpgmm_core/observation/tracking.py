# SPDX-License-Identifier: Apache-2.0
"""`FrameTracker`: what is known of each frame right now: seen, remembered or lost, and how far it can be trusted.

A frame that is not seen for a moment keeps its last pose. Its confidence, which scales its precision in the product
of Gaussians (Eqs. 5, 6), falls to zero slowly and rises slowly, so that a frame that disappears or comes back never
makes the movement jump. A frame may also stay where it was last seen (`unknown_after`): then its pose is known worse
with the time out of sight and the speed that it was seen to have (`motion`). Or it moves with the hand, if it was seen
to (`in_hand`). A noisy pose is averaged while the frame is at rest (`pose_filter`). What is no pose, lies about its
time, or leaps is refused (`poses`, `clocks`, `gate`). `track` is all of this for one frame.

Two clocks enter, as arguments: the *stamp* of an observation (ROS time, when the camera saw it) and the *steady* time
of its arrival. The status follows the steady clock, which no clock step can stall; stamps are checked when they come.
"""

from __future__ import annotations

import math
from collections import defaultdict
from collections.abc import Collection, Iterable, Mapping, Sequence

import numpy as np
from numpy.typing import ArrayLike, NDArray

from tpgmm_core.geometry.pose import pose_error
from tpgmm_core.observation.gate import NOISE_TURN, NOISE_WAY, Leap
from tpgmm_core.observation.health import FrameHealth
from tpgmm_core.observation.in_hand import Hand, carried_covariance
from tpgmm_core.observation.pose_filter import PoseFilter
from tpgmm_core.observation.poses import check_pose
from tpgmm_core.observation.signals import PAUSE, SignalWatch
from tpgmm_core.observation.streams import SECOND
from tpgmm_core.observation.track import Track
from tpgmm_core.observation.tracked import FrameStatus, TrackedFrame, TrackingConfig


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
    unknown_after
        for some of the frames: out of sight they are where they were last seen, for so long, s; `math.inf`: for ever.
        The others keep their weight for the time that `config` says
    with_hand
        those of them that move with the hand while they are not seen, if they were seen to

    Raises
    ------
    ValueError
        for no frames, a fixed pose that is invalid, times that are negative or of other frames, and frames with the
        hand that have no such time
    """

    def __init__(
        self,
        frames: Iterable[str],
        fixed: dict[str, ArrayLike] | None = None,
        config: TrackingConfig | None = None,
        unknown_after: Mapping[str, float] | None = None,
        with_hand: Collection[str] = (),
    ) -> None:
        self.config = config or TrackingConfig()
        self._tracks = {name: Track(self.config) for name in frames}
        for name, seconds in (unknown_after or {}).items():
            if name not in self._tracks or not seconds >= 0.0:
                raise ValueError(
                    f"unknown_after is a time >= 0 s of one of {list(self._tracks)}, got {name}: {seconds}"
                )
            self._tracks[name].unknown_after = seconds
        if not set(with_hand) <= set(unknown_after or {}):
            raise ValueError(f"with_hand names some of {list(unknown_after or {})}, got {list(with_hand)}")
        self._hand = Hand(with_hand)
        self._grippers: defaultdict[str, SignalWatch] = defaultdict(SignalWatch)
        for name, pose in (fixed or {}).items():
            self._tracks[name] = Track(self.config, fixed=True)
            if reason := self.fix(name, pose):
                raise ValueError(reason)
        if not self._tracks:
            raise ValueError("no frames to track: name at least one")
        if self.config.filter_time > 0.0:
            PoseFilter.compile_kernels()
        self._updated_ns: int | None = None

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the frames that are tracked."""
        return tuple(self._tracks)

    def refusals(self, name: str) -> dict[str, int]:
        """Number of refused observations of a frame so far, by reason."""
        return dict(self._tracks[name].record.refused)

    def fix(self, name: str, pose: ArrayLike) -> str | None:
        """Take a frame as fixed from now on, such as one that static transforms lead to.

        Parameters
        ----------
        name
            the frame
        pose
            where it is, in the base frame

        Returns
        -------
        str | None
            None if it is taken so, else why not

        Raises
        ------
        KeyError
            for an unknown frame
        """
        track = self._tracks[name]
        checked, reason = check_pose(pose)
        if checked is None:
            return self.refuse(name, reason)
        track.fix(checked)
        return None

    def observe(
        self,
        name: str,
        pose: Sequence[float] | NDArray[np.float64],
        stamp_ns: int,
        now_ns: int,
        steady_ns: int,
        covariance: NDArray[np.float64] | None = None,
        stretch: NDArray[np.float64] | None = None,
        lasts: bool = False,
    ) -> str | None:
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
        covariance
            (6, 6) of the pose, where its source says one; it is kept, and handed on with the frame. NaN: one that is
            none, which is counted
        stretch
            (3, 3), what the frame's axes do to positions, where its source says it; the same
        lasts
            it was said once, and is kept for those who come later (see `update`): whatever its stamp, it is the present
            place, which no leap and no average makes doubtful. What comes so often that it could not be held meanwhile
            is a stream like any other

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
        stamp_ns, reason = track.judged_observation(stamp_ns, now_ns, lasts)
        if reason:
            return self.refuse(name, reason)
        if (leap := track.gate.judge(checked, stamp_ns)) and not track.lasts:
            return self.refuse(name, self._words(name, leap, checked))
        track.take(pose, checked, stamp_ns, steady_ns, covariance, stretch)
        if name in self._hand:
            self._hand.see(name, checked, stamp_ns)
        return None

    def observe_hand(self, pose: ArrayLike, stamp_ns: int, steady_ns: int) -> str:
        """See the hand, with which frames move.

        Parameters
        ----------
        pose
            (7,) in the base frame
        stamp_ns
            when it was there, ROS time
        steady_ns
            steady time at arrival

        Returns
        -------
        str
            why it is not used; empty where it is
        """
        return self._hand.take(pose, stamp_ns, steady_ns)

    def observe_gripper(self, name: str, closed: bool, stamp_ns: int, steady_ns: int) -> None:
        """Hear whether the gripper that may hold a frame is closed.

        Parameters
        ----------
        name
            the frame
        closed
            whether it is closed
        stamp_ns
            from when on, ROS time
        steady_ns
            steady time at arrival
        """
        self._grippers[name].hear(closed, steady_ns)
        self._hand.grip(name, closed, stamp_ns)

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
        self._tracks[name].record.refuse(reason)
        return f"frame '{name}': {reason}"

    def _words(self, name: str, leap: Leap, pose: NDArray[np.float64]) -> str:
        """Why a pose is refused: kind, ":", details."""
        limits = self.config.motion
        found = f"{leap.way:.3f} m and {math.degrees(leap.turn):.0f} deg in {leap.time:.3f} s"
        allowed = f"{limits.way(leap.time):.3f} m and {math.degrees(limits.turn(leap.time)):.0f} deg are possible"
        until = f"followed once it persists for {limits.leap_time:g} s"
        for other, track in self._tracks.items():
            if other != name and track.pose is not None and _are_near(track.pose, pose):
                return f"swapped identity: leapt by {found} to where '{other}' is; {allowed}, {until}"
        kind = "flip: turned on the spot" if leap.is_flip else "leap"
        return f"{kind}: by {found}; {allowed}, {until}"

    def health(self, steady_ns: int) -> dict[str, FrameHealth]:
        """How well the frames are observed that are not fixed, by name, at a steady time, ns."""
        return {
            name: track.health(steady_ns, self._whereabouts(name, track, steady_ns))
            for name, track in self._tracks.items()
            if not track.fixed
        }

    def _whereabouts(self, name: str, track: Track, steady_ns: int) -> tuple[str, ...]:
        """In words, where a frame is that may move with the hand and is not seen."""
        if name not in self._hand or track.unseen(steady_ns) <= self.config.visible_timeout:
            return ()
        if self._hand.moves(name) and self._is_hand_lost(steady_ns):
            return ("not seen; it was with the hand, whose pose does not come",)
        silence = self._grippers[name].age(steady_ns)
        if self._is_grip_lost(name, steady_ns):
            return (f"not seen; the gripper held it, and has stopped saying so: silent for {silence:.0f} s",)
        since = f"; the gripper spoke last {silence:.0f} s ago" if PAUSE < silence < math.inf else ""
        return (f"not seen; {self._hand.why(name)}{since}",)

    def _is_hand_lost(self, steady_ns: int) -> bool:
        return self._hand.age(steady_ns) > self.config.visible_timeout

    def _is_grip_lost(self, name: str, steady_ns: int) -> bool:
        """Whether a frame is only held by what a gripper said that has stopped speaking since."""
        return self._hand.holds(name) and self._grippers[name].has_ceased(steady_ns)

    def forget(self) -> None:
        """Forget all observations (time jumped backwards: a looped bag, a restarted simulation)."""
        for track in self._tracks.values():
            track.forget()
        self._hand.forget()
        self._grippers.clear()
        self._updated_ns = None

    def update(self, steady_ns: int, kept: Collection[str] = ()) -> list[TrackedFrame]:
        """All frames as they are known; call it regularly, since confidences change with time.

        Parameters
        ----------
        steady_ns
            steady time, ns
        kept
            frames of which somebody keeps what was said once: they are there, until something else is said, unless
            they are in the hand

        Returns
        -------
        list[TrackedFrame]
            in the order of the frames
        """
        for name in kept:
            in_hand = name in self._hand and (self._hand.moves(name) or self._hand.left(name) is not None)
            if (track := self._tracks.get(name)) is not None and track.lasts and not in_hand:
                track.seen_ns = steady_ns
        elapsed = 0.0 if self._updated_ns is None else max(0.0, (steady_ns - self._updated_ns) / SECOND)
        first = self._updated_ns is None
        self._updated_ns = steady_ns
        return [self._update(name, track, steady_ns, elapsed, first) for name, track in self._tracks.items()]

    def _update(self, name: str, track: Track, steady_ns: int, elapsed: float, first: bool) -> TrackedFrame:
        if track.fixed:
            return TrackedFrame(name, FrameStatus.VISIBLE, 1.0, 0, track.pose)
        unseen = track.unseen(steady_ns)
        is_away = unseen > self.config.visible_timeout and name in self._hand
        carried = is_away and self._hand.moves(name)
        # Before the first update no confidence was published, so there is nothing to be continuous with.
        change = 1.0 if first else elapsed / self.config.fade_time
        is_lost = carried and (self._is_hand_lost(steady_ns) or self._is_grip_lost(name, steady_ns))
        track.fade(track.is_known(unseen) and not is_lost, change)
        status = track.status(unseen)
        pose, covariance = track.pose, track.covariance
        place = None
        if is_away:
            place = self._hand.place(name) if carried else self._hand.left(name)
        if place is not None and pose is not None:
            pose, covariance = place, carried_covariance(covariance, pose, place)
        elif status is FrameStatus.HELD and track.unknown_after is not None:
            covariance = track.motion.covariance(covariance, unseen)
        return TrackedFrame(name, status, track.confidence, track.stamp_ns, pose, covariance, track.stretch)


def _are_near(a: NDArray[np.float64], b: NDArray[np.float64]) -> bool:
    way, turn = pose_error(a, b)
    return way <= NOISE_WAY and turn <= NOISE_TURN
