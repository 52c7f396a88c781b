# SPDX-License-Identifier: Apache-2.0
"""`Preview`: where a model would go in a situation, the whole robot over time, and a verdict before anything moves."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from tpgmm_core import Demonstration, LearnedMixture
from tpgmm_core.choice.reproducing import as_seen_by, reproduce_gaussians
from tpgmm_core.common.text import listed
from tpgmm_core.common.types import Array
from tpgmm_core.model.derived_frames import DerivedFrames
from tpgmm_core.retrieval.calibrated import covariance_scale
from tpgmm_core.retrieval.interface import demonstrated_duration
from tpgmm_core.retrieval.methods import make_retrieval, method_of
from tpgmm_core.retrieval.novelty import NoveltyScale
from tpgmm_core.robot.model import RobotModel
from tpgmm_workbench.project.errors import ProjectError
from tpgmm_workbench.project.joints_along import joints_along
from tpgmm_workbench.project.self_collision import SelfCollision
from tpgmm_workbench.project.situations import frames_of, how_new

FAR_M, FAR_RAD = 0.01, 0.1
"""A pose that the joints miss by more is out of reach."""
NEAR_LIMIT = 0.02
"""A joint is at its limit where it is nearer than this share of its range."""
NEW = 2.0
"""A situation that is so many times as new as the newest that a model was judged by is too new."""
STARTS_M = 0.05
"""A hand that is nearer to the begin of the movement is there."""
ROOM = 1.05
"""A movement that is too fast is advised to take so many times the time that it needs at least."""
COLLISION_STRIDE = 4
"""Every so many poses of the path are looked at for parts that meet."""


@dataclass(frozen=True, slots=True)
class Check:
    """One question about a movement.

    Parameters
    ----------
    name
        of the question
    is_good
        the answer; None: it cannot be known
    words
        the same in words
    advised
        duration that would make it good, s; None where no duration does, or none is needed
    """

    name: str
    is_good: bool | None
    words: str
    advised: int | None = None


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
        reachable, position limits, speed limits, self-collision, novelty, start; in this order
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
    def advised(self) -> int | None:
        """Duration in which the joints are fast enough, s; None where they are in this one."""
        return next((check.advised for check in self.checks if check.advised is not None), None)

    @property
    def words(self) -> str:
        """The verdict: what is bad, or that nothing is; then what cannot be known."""
        bad = [check.words for check in self.checks if check.is_good is False]
        unknown = [check.words for check in self.checks if check.is_good is None]
        return "; ".join([*(bad or ["it can be done as shown"]), *unknown])


def preview(
    model: LearnedMixture,
    frames: Mapping[str, Array],
    q: Array,
    robot: RobotModel,
    endpoint: str,
    duration: float | None = None,
    count: int = 100,
    shapes: SelfCollision | None = None,
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
    shapes
        of the robot, made once; None: whether it meets itself is not known

    Returns
    -------
    Preview
        path, joints and verdict

    Raises
    ------
    ProjectError
        for a frame that the model needs and nobody gives, and for a model over joints
    """
    data = robot.create_data()
    data.update(np.asarray(q, float))
    hand = data.pose(endpoint)
    learned = demonstrated_duration(model)
    path, covariances = _reference(model, frames, hand, np.linspace(0.0, learned, count))
    times = np.linspace(0.0, learned if duration is None else duration, count)
    joints, missing = joints_along(robot, endpoint, path, q)
    moving = robot.indices(robot.endpoints[endpoint].joints)
    checks = (
        _reachable(times, missing),
        _positions(robot, joints[:, moving], [robot.joint_names[i] for i in moving], times),
        _speeds(robot, joints, times),
        _collision(shapes, joints, times),
        _novelty(model, frames, hand),
        _start(hand, path[0]),
    )
    return Preview(times, path, covariances, joints, checks)


def _reference(model: LearnedMixture, frames: Mapping[str, Array], hand: Array, times: Array) -> tuple[Array, Array]:
    needed = DerivedFrames.of_metadata(model.metadata_).observed(model.frame_names_)
    if missing := [name for name in needed if name not in frames]:
        raise ProjectError(f"the model needs {listed(missing)}, whose poses are not known: bring them into view")
    known = frames_of({name: np.asarray(frames[name], float) for name in needed})
    data = np.column_stack([times, np.tile(hand, (len(times), 1))])
    if not known:
        known = frames_of({"base": np.array([0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0])})
    situation = as_seen_by(model, Demonstration(times, data, known))
    try:
        path, covariances = reproduce_gaussians(model, situation)
    except ValueError as error:
        raise ProjectError(f"the model has no answer in this situation: {error}") from error
    if path.shape[1] != 7:
        raise ProjectError("the model is over joints, or positions alone; a preview needs one of poses")
    return path, covariances * covariance_scale(model, method_of(model).name)


def _reachable(times: Array, missing: Array) -> Check:
    far = np.flatnonzero((missing[:, 0] > FAR_M) | (missing[:, 1] > FAR_RAD))
    if not len(far):
        return Check("reachable", True, "the hand reaches all of the path")
    most = far[np.argmax(missing[far, 0])]
    return Check(
        "reachable",
        False,
        f"out of reach from {times[far[0]]:.1f} to {times[far[-1]]:.1f} s: {1e3 * missing[most, 0]:.0f} mm and "
        f"{np.degrees(missing[most, 1]):.0f} deg are missing at {times[most]:.1f} s; move the objects nearer",
    )


def _positions(robot: RobotModel, q: Array, names: list[str], times: Array) -> Check:
    joints = robot.indices(names)
    lower, upper = robot.lower_limits[joints], robot.upper_limits[joints]
    ranges = upper - lower
    room = np.minimum(q - lower, upper - q) / np.where(np.isfinite(ranges), ranges, 1.0)
    i, k = np.unravel_index(int(np.argmin(room)), room.shape)
    if room[i, k] > NEAR_LIMIT:
        return Check("joint limits", True, f"joints stay within their limits; {names[k]} comes nearest")
    return Check(
        "joint limits", False, f"{names[k]} is at its limit ({q[i, k]:.2f} of {lower[k]:.2f} to {upper[k]:.2f}) at "
        f"{times[i]:.1f} s; start from another posture, or move the objects",
    )  # fmt: skip


def _speeds(robot: RobotModel, q: Array, times: Array) -> Check:
    speeds = np.abs(np.diff(q, axis=0)) / np.diff(times)[:, None] / robot.velocity_limits
    i, k = np.unravel_index(int(np.argmax(speeds)), speeds.shape)
    words = f"{robot.joint_names[k]} needs {speeds[i, k]:.0%} of its speed limit at {times[i]:.1f} s"
    if speeds[i, k] <= 1.0:
        return Check("speed limits", True, words)
    advised = math.ceil(ROOM * speeds[i, k] * times[-1])
    return Check("speed limits", False, f"{words}: give it {advised} s", advised)


def _collision(shapes: SelfCollision | None, q: Array, times: Array) -> Check:
    problem = "its shapes were not asked for" if shapes is None else shapes.problem
    if shapes is None or problem:
        return Check("self-collision", None, f"it is not known whether the robot collides with itself: {problem}")
    meeting = shapes.first(q, COLLISION_STRIDE)
    if meeting is None:
        return Check("self-collision", True, "the robot does not collide with itself")
    one, other = meeting.links
    return Check("self-collision", False, f"{one} collides with {other} at {times[meeting.at]:.1f} s")


def _start(hand: Array, first: Array) -> Check:
    away = float(np.linalg.norm(hand[:3] - first[:3]))
    if away <= STARTS_M:
        return Check("start", True, "the hand is where the movement begins")
    return Check(
        "start",
        None,
        f"the hand is {100.0 * away:.0f} cm from where the movement begins, and will move there quickly: lead it "
        "there first",
    )


def _novelty(model: LearnedMixture, frames: Mapping[str, Array], hand: Array) -> Check:
    scale = NoveltyScale.of_model(model)
    if scale is None:
        return Check("novelty", None, "how new this situation is, is not known: train with three demonstrations")
    known = frames_of({name: np.asarray(pose, float) for name, pose in frames.items()})
    known |= DerivedFrames.of_metadata(model.metadata_).frames(known, hand)
    seen = {name: known[name] for name in model.frame_names_ if name in known}
    novelty = scale.judge(make_retrieval(model, horizon_steps=0), seen, hand)
    words = f"this situation is {how_new(novelty.score, len(scale.distances))}"
    if novelty.score <= NEW:
        return Check("novelty", True, words)
    return Check("novelty", False, f"{words}; show a demonstration like it, or move the objects to where they were")
