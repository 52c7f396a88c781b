# SPDX-License-Identifier: Apache-2.0
"""`Preview`: where a model would go in a situation, the whole robot over time, and a verdict before anything moves."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from tpgmm_core import TPGMM
from tpgmm_core.common.types import Array
from tpgmm_core.robot.model import RobotModel


@dataclass(frozen=True, slots=True)
class Check:
    """One question about a movement: its name, whether the answer is good (None: it cannot be known), and in words."""

    name: str
    is_good: bool | None
    words: str


@dataclass(frozen=True, slots=True, eq=False)
class Preview:
    """Where a model would go.

    Parameters
    ----------
    times
        (T,) s from the start
    path
        (T, 7) reference poses of the end point in the base frame
    covariances
        (T, 6, 6) of the poses, about the fixed axes; as calibrated
    q
        (T, nv) joints along the path, in the robot's order, within the limits of their positions
    checks
        reachable, position limits, speed limits, self-collision, novelty; in this order
    """

    times: Array
    path: Array
    covariances: Array
    q: Array
    checks: tuple[Check, ...]

    @property
    def may_run(self) -> bool:
        """Whether no answer is bad; what cannot be known does not count."""
        return all(check.is_good is not False for check in self.checks)

    @property
    def words(self) -> str:
        """The verdict: what is bad, or that nothing is."""
        bad = [check.words for check in self.checks if check.is_good is False]
        return "; ".join(bad) if bad else "it can be done as shown"


def preview(
    model: TPGMM,
    frames: Mapping[str, Array],
    q: Array,
    robot: RobotModel,
    endpoint: str,
    duration: float | None = None,
    count: int = 100,
) -> Preview:
    """See where a model would go, and whether the robot can.

    Parameters
    ----------
    model
        of a task of poses
    frames
        name -> pose (7,) in the base frame: those that are seen, and the fixed ones of the task
    q
        (nv,), where the robot is
    robot
        the robot
    endpoint
        that follows the movement
    duration
        of the movement, s; None: as demonstrated
    count
        number of poses

    Returns
    -------
    Preview
        path, joints and verdict

    Raises
    ------
    ProjectError
        for a frame that the model needs and nobody gives, and for a model over joints
    """
    raise NotImplementedError
