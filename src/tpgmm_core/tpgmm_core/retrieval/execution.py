# SPDX-License-Identifier: Apache-2.0
"""One request to reproduce a movement: wait for the frames, move, settle, judge the end.

A retrieval says where to be. An execution knows what was requested, when it may begin, and when it is done: once the
phase is 1. A movement that goes back waits at its start, from where it may go forward again. One that waits for a robot
which is held, or which cannot get to its reference, is aborted in the end. An execution still gives references after
its end, so that the robot stays at the place that it has reached.
"""

from __future__ import annotations

import enum
import math
from collections.abc import Collection, Mapping
from dataclasses import dataclass

import numpy as np

from tpgmm_core.common.settings import check_settings, setting
from tpgmm_core.common.text import listed
from tpgmm_core.common.types import Array
from tpgmm_core.geometry.frame import Frame
from tpgmm_core.geometry.gaussian import Gaussian
from tpgmm_core.geometry.manifold import Manifold
from tpgmm_core.model.reference import Reference
from tpgmm_core.retrieval.continued import Continued
from tpgmm_core.retrieval.interface import Retrieval

_SECOND = 1_000_000_000
_PROGRESS = 0.01
"""A movement stands still when it advances by less than this share of what its speed requires."""
_HARDLY = 0.1
"""A share of the way below this counts as none."""


@dataclass(frozen=True, slots=True, kw_only=True)
class ExecutionConfig:
    """When an execution counts as begun and as done."""

    start_timeout: float = setting(
        5.0, 0.1, 600.0, "Time after a request within which all frames must have been seen, s"
    )
    settle_time: float = setting(
        1.0, 0.01, 60.0, "Time that the robot has to settle before its error at the end is judged, s"
    )
    stall_timeout: float = setting(
        10.0, 0.1, 600.0, "A movement that stalls for this long, although its speed is not 0, is aborted, s"
    )
    position_tolerance: float = setting(0.01, 1e-4, 1.0, "Largest position error at the end that counts as success, m")
    orientation_tolerance: float = setting(
        0.0873, 1e-3, 3.2, "Largest orientation error at the end that counts as success, rad"
    )
    joint_tolerance: float = setting(
        0.05, 1e-3, 3.2, "Largest error of a joint at the end that counts as success, for movements of joints, rad or m"
    )

    def __post_init__(self) -> None:
        """Raise ValueError for a value out of its range."""
        check_settings(self)


class Stage(enum.Enum):
    """How far an execution has come."""

    STARTING = "starting"
    MOVING = "moving"
    SETTLING = "settling"
    ENDED = "ended"


@dataclass(frozen=True, slots=True)
class Outcome:
    """How an execution ended.

    Parameters
    ----------
    success
        whether the robot came to the end of the movement
    reason
        a sentence for users
    position_error, orientation_error
        of the robot's pose from the end of the reference, m and rad; NaN where not known, as for movements of joints
    is_missed
        whether the robot did not follow the references to their end; a caller who knows more may add why
    """

    success: bool
    reason: str
    position_error: float = math.nan
    orientation_error: float = math.nan
    is_missed: bool = False


class Execution:
    """Steps a retrieval from the request to its end.

    Parameters
    ----------
    retrieval
        a fresh one of the model that was requested
    config
        when it counts as begun and as done
    """

    def __init__(self, retrieval: Retrieval, config: ExecutionConfig | None = None) -> None:
        self.retrieval = retrieval
        self.config = config or ExecutionConfig()
        self.stage = Stage.STARTING
        self.outcome: Outcome | None = None
        self.reference: Reference | None = None
        self._asked_ns: int | None = None
        self._reference_ns = 0
        self._settling_ns = 0
        self._first_pose: Array | None = None  # of the robot, since the movement began
        self._settling_pose: Array | None = None
        self._progress_phase = 0.0
        self._stalled_ns = 0
        self._stopped_ns: int | None = None

    def step(
        self,
        time_ns: int,
        frames: Mapping[str, Frame],
        pose: Array | None = None,
        weights: Mapping[str, float] | None = None,
    ) -> Reference | None:
        """The reference at a time; None before the movement may begin and while no frame is known.

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
            None before the movement may begin and while no frame is known
        """
        if self._asked_ns is None:
            self._asked_ns = time_ns
        if self.stage is Stage.STARTING and not self._begin(time_ns, frames, pose):
            return None
        if self.stage is Stage.ENDED and self.reference is None:
            return None
        if not frames:
            return None
        at = time_ns if self._stopped_ns is None else self._stopped_ns
        self.reference = self.retrieval.step(at, frames, pose, weights)
        since, self._reference_ns = at - self._reference_ns, at
        if self._first_pose is None:
            self._first_pose = pose
        if self.stage is Stage.MOVING and self.reference.phase >= 1.0:
            self.stage = Stage.SETTLING
            self._settling_ns, self._settling_pose = time_ns, pose
        elif self.stage is Stage.SETTLING and self.reference.phase < 1.0:
            self.stage = Stage.MOVING  # it was told to go back
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
            self._end(False, reason)

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
        if self.reference is not None:
            continued = Continued(retrieval, self.reference, self._reference_ns, blend_time)
            retrieval.start(self._reference_ns, pose, self.reference.phase)
            retrieval = continued
        retrieval.speed = self.retrieval.speed
        self.retrieval = retrieval

    def _begin(self, time_ns: int, frames: Collection[str], pose: Array | None) -> bool:
        assert self._asked_ns is not None
        missing = [name for name in self.retrieval.frame_names if name not in frames]
        if not missing:
            self.retrieval.start(time_ns, pose)
            self._reference_ns = time_ns
            self.stage = Stage.MOVING
            return True
        if time_ns - self._asked_ns > self.config.start_timeout * _SECOND:
            self._end(
                False,
                f"frames not seen within {self.config.start_timeout:g} s: {listed(missing)}; "
                "check that their poses are published and accepted",
            )
        return False

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
                False,
                f"the movement has stalled for {timeout:g} s at phase {phase:.2f}: "
                "is the robot held, or are the references out of its reach?",
                is_missed=True,
            )

    def _judge(self, time_ns: int, reference: Reference, pose: Array | None) -> None:
        config = self.config
        if time_ns - self._settling_ns < config.settle_time * _SECOND:
            return
        if pose is None:
            self._end(False, "the robot's pose is not known: no message came on the movement's topic")
            return
        gaussian = reference.gaussian
        near = self._off(gaussian.manifold, gaussian.mean, pose) <= 1.0
        error = gaussian.manifold.log(gaussian.mean, pose)
        if gaussian.manifold.is_euclidean:
            position = orientation = math.nan
            words = f"joints are {np.abs(error).max():.3f} rad or m"
        else:
            position, orientation = float(np.linalg.norm(error[:3])), float(np.linalg.norm(error[3:]))
            words = f"{1e3 * position:.1f} mm and {math.degrees(orientation):.1f} deg"
        words += " from the model's end of the movement"
        if not near:
            words += f"; {self._cause(gaussian, pose)}"
        self._end(near, words, position, orientation, is_missed=not near)

    def _off(self, manifold: Manifold, end: Array, pose: Array) -> float:
        """Distance of a pose or a configuration from another, in tolerances."""
        config, error = self.config, manifold.log(end, pose)
        if manifold.is_euclidean:
            return float(np.abs(error).max()) / config.joint_tolerance
        position, orientation = float(np.linalg.norm(error[:3])), float(np.linalg.norm(error[3:]))
        return max(position / config.position_tolerance, orientation / config.orientation_tolerance)

    def _cause(self, end: Gaussian, pose: Array) -> str:
        """Why the robot is not at the end, as far as its way shows, in words."""
        if self._first_pose is None or self._settling_pose is None:
            return "its pose came only at the end"
        manifold = end.manifold
        left, asked = self._off(manifold, end.mean, pose), self._off(manifold, end.mean, self._first_pose)
        gone, late = self._off(manifold, self._first_pose, pose), self._off(manifold, end.mean, self._settling_pose)
        if asked > 1.0 and gone < _HARDLY * asked:
            return "the robot has hardly moved: is a controller active, and the robot free to move?"
        if left < (1.0 - _HARDLY) * late:
            return "the robot is late and still approaches: ask for a longer duration, or give it more settle_time"
        return "the robot has stopped there: blocked, at its limits, too weak, or out of its reach"

    def _end(
        self,
        success: bool,
        reason: str,
        position: float = math.nan,
        orientation: float = math.nan,
        is_missed: bool = False,
    ) -> None:
        self.stage = Stage.ENDED
        self.outcome = Outcome(success, reason, position, orientation, is_missed)
