# SPDX-License-Identifier: Apache-2.0
"""One request to reproduce a movement: wait for the frames, move, settle, judge the end.

A retrieval says where to be. An execution knows what was requested, when it may begin, and when it is done: once the
phase is 1. A movement that goes back waits at its start, from where it may go forward again. One that waits for a robot
which is held, or which cannot get to its reference, is aborted in the end, and so is one that waits for frames (see
`waiting`). An execution still gives references after its end, so that the robot stays at the place that it has
reached.
"""

from __future__ import annotations

import enum
import math
from collections.abc import Mapping

from tpgmm_core.common.text import listed
from tpgmm_core.common.types import Array
from tpgmm_core.geometry.frame import Frame
from tpgmm_core.geometry.gaussian import Gaussian
from tpgmm_core.model.reference import Reference
from tpgmm_core.retrieval.approach import PEAK, Approach, way_time
from tpgmm_core.retrieval.continued import Continued
from tpgmm_core.retrieval.interface import Retrieval
from tpgmm_core.retrieval.outcome import ExecutionConfig, Outcome, distance, judged
from tpgmm_core.retrieval.waiting import Waiting

_SECOND = 1_000_000_000
_PROGRESS = 0.01
"""A movement stands still when it advances by less than this share of what its speed requires."""


class Stage(enum.Enum):
    """How far an execution has come."""

    STARTING = "starting"
    MOVING = "moving"
    SETTLING = "settling"
    ENDED = "ended"


class Execution:
    """Steps a retrieval from the request to its end.

    Parameters
    ----------
    retrieval
        a fresh one of the model that was requested
    config
        when it counts as begun and as done
    hold
        where another movement follows: the end counts as reached once the robot has been near it for so long, s; one
        that is not near once `settle_time` has passed has not come to the end. None: it is judged then alone
    """

    def __init__(self, retrieval: Retrieval, config: ExecutionConfig | None = None, hold: float | None = None) -> None:
        self.retrieval = retrieval
        self._waits_for_frames = isinstance(retrieval, Waiting)
        self.config = config or ExecutionConfig()
        self._hold = hold
        self._former: tuple[Execution, float] | None = None
        self.stage = Stage.STARTING
        self.outcome: Outcome | None = None
        self.reference: Reference | None = None
        self._asked_ns: int | None = None
        self._reference_ns = 0
        self._settling_ns = 0
        self._near_ns: int | None = None  # since when the robot is at the end
        self._first_pose: Array | None = None  # of the robot, since the movement began
        self._settling_pose: Array | None = None
        self._progress_phase = 0.0
        self._stalled_ns = self._waited_ns = 0
        self._stopped_ns: int | None = None

    def step(
        self,
        time_ns: int,
        frames: Mapping[str, Frame],
        pose: Array | None = None,
        weights: Mapping[str, float] | None = None,
    ) -> Reference | None:
        """The reference at a time; None before the movement may begin.

        Parameters
        ----------
        time_ns
            now, ns
        frames
            as for ``Retrieval.step``
        pose
            where the robot is: (7,), or its configuration (n,) for movements of joints; None where not known
        weights
            as for ``Retrieval.step``

        Returns
        -------
        Reference | None
            None before the movement may begin, and while no frame is known, unless the retrieval is a `Waiting`
        """
        if self._asked_ns is None:
            self._asked_ns = time_ns
        if self.stage is Stage.STARTING and not self._begin(time_ns, frames, pose, weights):
            return None
        if self.stage is Stage.ENDED and self.reference is None:
            return None
        if not (frames or self._waits_for_frames):
            return None
        at = time_ns if self._stopped_ns is None else self._stopped_ns
        self.reference = self.retrieval.step(at, frames, pose, weights)
        since, self._reference_ns = at - self._reference_ns, at
        if self._first_pose is None:
            self._first_pose = pose
        if self.stage is Stage.MOVING and self.reference.phase >= 1.0:
            self.stage = Stage.SETTLING
            self._settling_ns, self._settling_pose, self._near_ns = time_ns, pose, None
        elif self.stage is Stage.SETTLING and self.reference.phase < 1.0:
            self.stage = Stage.MOVING  # it was told to go back
        if self.reference.waits and self.stage is not Stage.ENDED:
            self._watch_waiting(time_ns, self.reference, since)
            return self.reference
        self._waited_ns = 0
        if self.stage is Stage.SETTLING:
            self._judge(time_ns, self.reference, pose)
        elif self.stage is Stage.MOVING:
            self._watch_progress(time_ns, self.reference.phase, since)
        return self.reference

    def stop(self, time_ns: int, reason: str) -> None:
        """End it here: the reference stays where it is now.

        Parameters
        ----------
        time_ns
            now, ns
        reason
            for the outcome
        """
        if self.stage is not Stage.ENDED:
            self._stopped_ns = time_ns
            self._end(reason)

    def take_over(self, retrieval: Retrieval, pose: Array | None = None, blend_time: float = 0.15) -> None:
        """Continue with another retrieval, at the same share of the movement and without a jump of the reference.

        Parameters
        ----------
        retrieval
            a fresh one, of another model or another method
        pose
            as for ``step``
        blend_time
            time constant with which the difference of the references dies out, s

        Raises
        ------
        ValueError
            when its references are on another manifold; the present retrieval then continues
        """
        waits = isinstance(retrieval, Waiting)
        if self.reference is not None:
            continued = Continued(retrieval, self.reference, self._reference_ns, blend_time)
            retrieval.start(self._reference_ns, pose, self.reference.phase)
            retrieval = continued
        retrieval.speed = self.retrieval.speed
        self.retrieval = retrieval
        self._waits_for_frames = waits

    def follow(self, former: Execution, blend_time: float = 0.15) -> None:
        """Begin where another movement has ended, without a jump of the reference or of its covariance.

        Call it before the first step. The former one goes on giving references until this one has begun. Where this
        movement begins elsewhere, the difference dies out with `blend_time`. Where that would be faster than
        `transition_speed` or `transition_rate`, the reference goes to the beginning first: see `Approach`.

        Parameters
        ----------
        former
            of the same manifold; stepped before this one at each time
        blend_time
            time constant, s
        """
        self._former = former, blend_time

    def _begin(
        self, time_ns: int, frames: Mapping[str, Frame], pose: Array | None, weights: Mapping[str, float] | None
    ) -> bool:
        assert self._asked_ns is not None
        missing = [name for name in self.retrieval.frame_names if name not in frames]
        if not missing:
            self.retrieval.start(time_ns, pose)
            if self._former is not None:
                first = self.retrieval.step(time_ns, frames, pose, weights).gaussian
                self._continue(time_ns, pose, first, *self._former)
                self._former = None
            self._reference_ns = time_ns
            self.stage = Stage.MOVING
            return True
        if time_ns - self._asked_ns > self.config.start_timeout * _SECOND:
            self._end(
                f"frames not seen within {self.config.start_timeout:g} s: {listed(missing)}; "
                "check that their poses are published and accepted",
            )
        return False

    def _continue(
        self, time_ns: int, pose: Array | None, first: Gaussian, former: Execution, blend_time: float
    ) -> None:
        """Start from the last reference of another movement, and not from the own `first` one."""
        last, config = former.reference, self.config
        if last is None:
            return
        apart = first.manifold.log(first.mean, last.gaussian.mean)
        time = way_time(first.manifold, apart, config.transition_speed, config.transition_rate)
        if (
            time > math.e * blend_time
        ):  # a spring from rest is fastest after blend_time, at 1 / (e blend_time) of the way
            seconds = PEAK * time
            self.retrieval = Approach(self.retrieval, time_ns, seconds, apart, pose)
            self._stalled_ns = -round(seconds * _SECOND)
        self.retrieval = Continued(self.retrieval, last, former._reference_ns, blend_time)

    def _watch_progress(self, time_ns: int, phase: float, since_ns: int) -> None:
        """Abort a movement that has not advanced for too long, unless it is paused or back at its start."""
        speed, timeout = self.retrieval.speed, self.config.stall_timeout
        if speed == 0.0 or (speed < 0.0 and phase <= 0.0):
            return
        if abs(phase - self._progress_phase) >= _PROGRESS * abs(speed) * timeout / self.retrieval.duration:
            self._progress_phase, self._stalled_ns = phase, 0
            return
        self._stalled_ns += max(0, since_ns)
        if self._stalled_ns > timeout * _SECOND:
            self._stopped_ns = time_ns
            self._end(
                f"the movement has stalled for {timeout:g} s at phase {phase:.2f}: "
                "is the robot held, or are the references out of its reach?",
                is_missed=True,
            )

    def _watch_waiting(self, time_ns: int, reference: Reference, since_ns: int) -> None:
        """Abort a movement that has waited for frames for too long, unless it is paused; its end waits as well."""
        self._settling_ns = time_ns
        self._waited_ns += max(0, since_ns) if self.retrieval.speed else 0
        timeout = self.config.unknown_timeout
        if self._waited_ns > timeout * _SECOND:
            self._stopped_ns = time_ns
            self._end(f"waited for {timeout:g} s at phase {reference.phase:.2f}: {reference.waits}")

    def _judge(self, time_ns: int, reference: Reference, pose: Array | None) -> None:
        gaussian = reference.gaussian
        near = pose is not None and distance(self.config, gaussian.manifold, gaussian.mean, pose) <= 1.0
        waits = time_ns - self._settling_ns < self.config.settle_time * _SECOND
        if self._hold is not None and near:
            self._near_ns = time_ns if self._near_ns is None else self._near_ns
            waits = time_ns - self._near_ns < self._hold * _SECOND
        else:
            self._near_ns = None
        if waits:
            return
        self.stage = Stage.ENDED
        self.outcome = judged(self.config, gaussian, (self._first_pose, self._settling_pose, pose))

    def _end(self, reason: str, is_missed: bool = False) -> None:
        self.stage, self.outcome = Stage.ENDED, Outcome(False, reason, is_missed=is_missed)
