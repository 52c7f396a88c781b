# SPDX-License-Identifier: Apache-2.0
"""`Track`: what is known of one frame: whose observation is believed, and how far it is trusted while none comes."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from tpgmm_core.observation.clocks import LeadMeter
from tpgmm_core.observation.gate import LeapGate
from tpgmm_core.observation.health import FrameHealth, FrameRecord
from tpgmm_core.observation.motion import SeenMotion
from tpgmm_core.observation.pose_filter import PoseFilter
from tpgmm_core.observation.streams import SECOND
from tpgmm_core.observation.tracked import FrameStatus, TrackingConfig

SAID_ONCE = "said once, by a publisher that keeps it (transient local): it holds as long as that is there"


@dataclass(slots=True)
class Track:
    """What is known of one frame.

    Parameters
    ----------
    config
        the timeouts
    fixed
        whether it never moves and is never lost

    Attributes
    ----------
    pose
        (7,) of its last observation, filtered; None before the first one
    stamp_ns, seen_ns
        when that was, ROS time, and when it came, steady time
    confidence
        0..1
    covariance, stretch
        (6, 6) and (3, 3), as its last observation says
    unknown_after
        how long it is known where it was last seen, s; None: as long as `config` says
    lasts
        whether its last observation was said once, and holds as long as somebody keeps it
    """

    config: TrackingConfig
    fixed: bool = False
    filter: PoseFilter = field(init=False)
    gate: LeapGate = field(init=False)
    clock: LeadMeter = field(default_factory=LeadMeter)
    record: FrameRecord = field(default_factory=FrameRecord)
    motion: SeenMotion = field(default_factory=SeenMotion)
    pose: NDArray[np.float64] | None = None
    stamp_ns: int = 0
    seen_ns: int = 0
    confidence: float = 0.0
    covariance: NDArray[np.float64] | None = None
    stretch: NDArray[np.float64] | None = None
    unknown_after: float | None = None
    lasts: bool = False

    def __post_init__(self) -> None:
        """What poses pass through."""
        self.filter = PoseFilter(0.0 if self.fixed else self.config.filter_time)
        self.gate = LeapGate(self.config.motion)

    def fix(self, pose: NDArray[np.float64]) -> None:
        """Take the frame as fixed at a pose (7,) from now on."""
        self.fixed, self.pose, self.confidence, self.stamp_ns = True, pose, 1.0, 0

    def judged_observation(self, stamp_ns: int, now_ns: int, lasts: bool) -> tuple[int, str]:
        """The stamp of an observation by ROS time, and why it is refused; empty where it is not.

        Parameters
        ----------
        stamp_ns
            as it came, ROS time
        now_ns
            ROS time now
        lasts
            it was said once, and is kept for those who come later: its stamp does not matter, and it is not averaged
            with others. What comes so often that it could not be held meanwhile is a stream like any other

        Returns
        -------
        tuple[int, str]
            the stamp, ns, and the reason in words
        """
        period = self.gate.period
        lasts &= not self.fixed and (period is None or period > self.config.visible_timeout)
        if not lasts:
            self.lasts = False
            return self._judged_stamp(stamp_ns, now_ns)
        self.lasts = True
        self.filter.forget()
        self.motion.forget()
        # when it came, where its own stamp tells nothing; always after the last one
        fresh = -self.config.max_future <= (now_ns - stamp_ns) / SECOND <= self.config.max_age
        return max(stamp_ns if fresh else now_ns, self.stamp_ns + 1), ""

    def _judged_stamp(self, stamp_ns: int, now_ns: int) -> tuple[int, str]:
        if self.fixed:
            return stamp_ns, "fixed frame: its pose never changes, observations are not used"
        age = (now_ns - stamp_ns) / SECOND
        if age < -self.config.max_future:
            corrected = self.clock.corrected(stamp_ns, now_ns)
            if corrected is None:
                allowed = f"{self.config.max_future} s allowed"
                return stamp_ns, f"stamp in the future: {-age:.3f} s ahead of ROS time, {allowed}"
            stamp_ns = corrected
        if age > self.config.max_age and stamp_ns == 0:
            return stamp_ns, "stamp too old: it is 0; the driver must stamp each message with its own time"
        if age > self.config.max_age:
            return stamp_ns, f"stamp too old: {age:.3f} s behind ROS time, {self.config.max_age} s allowed"
        if stamp_ns == self.stamp_ns:
            return stamp_ns, "repeated stamp: the same observation came before"
        if stamp_ns < self.stamp_ns:
            return stamp_ns, "stamp out of order: older than the observation that is known already"
        return stamp_ns, ""

    def take(
        self,
        given: Sequence[float] | NDArray[np.float64],
        pose: NDArray[np.float64],
        stamp_ns: int,
        steady_ns: int,
        covariance: NDArray[np.float64] | None,
        stretch: NDArray[np.float64] | None,
    ) -> None:
        """Use an observation that was judged good.

        Parameters
        ----------
        given
            the pose as it came
        pose
            the same (7,), checked
        stamp_ns, steady_ns
            when it was seen, ROS time, and when it came, steady time
        covariance, stretch
            see `FrameTracker.observe`
        """
        self.pose, self.stamp_ns, self.seen_ns = self.filter.observe(pose, stamp_ns), stamp_ns, steady_ns
        self.covariance = None if covariance is None or np.isnan(covariance).any() else covariance
        self.stretch = stretch
        self.motion.take(self.pose, stamp_ns, self.filter.noise)
        self.record.take(given, pose, stamp_ns, self.filter)
        self.record.odd_covariances += self.covariance is None and covariance is not None

    def unseen(self, steady_ns: int) -> float:
        """Time since its last observation came, s, at a steady time; infinite where none came."""
        return math.inf if self.pose is None else (steady_ns - self.seen_ns) / SECOND

    def is_known(self, unseen: float) -> bool:
        """Whether it keeps its weight, so long unseen, s."""
        hold_time = self.config.hold_time if self.unknown_after is None else self.unknown_after
        return self.pose is not None and unseen <= self.config.visible_timeout + hold_time

    def fade(self, trusted: bool, change: float) -> None:
        """Let the confidence rise where the frame is trusted, or else fall, by a change of it."""
        self.confidence = min(1.0, self.confidence + change) if trusted else max(0.0, self.confidence - change)

    def status(self, unseen: float) -> FrameStatus:
        """Seen, remembered or lost, so long unseen, s."""
        if unseen <= self.config.visible_timeout:
            return FrameStatus.VISIBLE
        return FrameStatus.HELD if self.confidence > 0.0 and self.pose is not None else FrameStatus.MISSING

    def health(self, steady_ns: int, more: Sequence[str]) -> FrameHealth:
        """How well it is observed, at a steady time; with more notes."""
        period, record = self.gate.period, self.record
        return FrameHealth(
            age=None if self.pose is None else self.unseen(steady_ns),
            rate=None if period is None else 1.0 / period,
            noise=self.filter.noise,
            refused=dict(record.refused),
            notes=(*record.notes(self.clock.lead_ns), *((SAID_ONCE,) if self.lasts else ()), *more),
            doubts=record.doubts(),
            trouble=record.trouble,
        )

    def forget(self) -> None:
        """Forget all observations; what is fixed stays."""
        if self.fixed:
            return
        self.pose, self.stamp_ns, self.seen_ns, self.confidence = None, 0, 0, 0.0
        self.covariance, self.stretch, self.lasts = None, None, False
        for part in (self.filter, self.gate, self.clock, self.record, self.motion):
            part.forget()
