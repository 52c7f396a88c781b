# SPDX-License-Identifier: Apache-2.0
"""Tasks of the hands, seen from the robot's own bodies, as one Gaussian over the joints: the product of Figure 5.

A task is a single Gaussian in each of several candidate frames, of a hand's pose as that frame sees it. Frames may be
fixed (world, torso) or be a hand, which moves with the joints as the hand that it sees does. About the joint
positions q, a frame sees x + J dq, with the Jacobian of the one motion relative to the other, so that each
Gaussian is one of q too: this is Eq. (9) with an object that is a part of the robot. Their product (Eq. 6), over the
frames of all tasks that are active, is a Gaussian over the joints: tasks that were taught separately are combined
without learning anything.

No one has to specify which frame matters: one in which the demonstration varied has next to no influence.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from tpgmm_core.common.blending import smoothstep
from tpgmm_core.common.types import Array
from tpgmm_core.geometry.gaussian import Gaussian
from tpgmm_core.geometry.kernels import compiled
from tpgmm_core.geometry.kernels_rotation import inverse_left_jacobian, quaternion_difference, rotation
from tpgmm_core.geometry.manifold import POSE
from tpgmm_core.kinematics.joint_space import to_joint_space
from tpgmm_core.learning.learned_mixture import LearnedMixture
from tpgmm_core.model.adaptation import UNCONSTRAINED_VARIANCE
from tpgmm_core.robot.model import RobotModel

BASE_POSE = np.array([0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0])


@dataclass(frozen=True, slots=True, eq=False)
class HandTask:
    """What was learned of one hand.

    Parameters
    ----------
    model
        one component on "R3 x S3"
    endpoint
        the hand, an end point of the robot
    places
        for each frame of the model the end point that it is fixed to, or its constant pose (7,) [x, y, z, qx, qy, qz,
        qw] in the base frame, m

    Raises
    ------
    ValueError
        for another kind of model, frames without a place, and a frame that is the hand itself
    """

    model: LearnedMixture
    endpoint: str
    places: Mapping[str, str | ArrayLike]

    def __post_init__(self) -> None:
        manifold, K = self.model.manifold_, len(self.model.priors_)
        if manifold != POSE or K != 1:
            raise ValueError(f"a task of a hand is one Gaussian on '{POSE}', got {K} on '{manifold}'")
        missing = sorted(set(self.model.frame_names_) - set(self.places))
        if missing:
            raise ValueError(
                f"the poses of the frames {missing} are not known; given are those of {sorted(self.places)}"
            )
        if any(isinstance(place, str) and place == self.endpoint for place in self.places.values()):
            raise ValueError(f"the hand {self.endpoint!r} cannot be the frame of its own task")


@dataclass(frozen=True, slots=True)
class _View:
    """One frame of one task: the hand, the end point that sees it (None: a constant pose), and the learned Gaussian."""

    task: str
    endpoint: str
    observer: str | None
    pose: Array
    mean: Array
    precision: Array


class HandTasks:
    """Tasks that are active together, each with a weight from 0 (not at all) to 1, as Gaussians over some joints.

    Parameters
    ----------
    robot
        whose hands they are
    tasks
        name -> task
    joints
        groups of the robot file or joints by name, in the order of the Gaussian
    rest_deviation
        standard deviation of each joint about the rest posture, rad: a Gaussian by Eq. (7) that was not taught, so weak
        that it only decides what no task does. Without it a push would move the arms for ever
    led
        end points that may have references from elsewhere, such as those of movements: see `at`

    Raises
    ------
    ValueError
        for unknown end points and joints, and a deviation that is not positive
    """

    def __init__(
        self,
        robot: RobotModel,
        tasks: Mapping[str, HandTask],
        joints: Sequence[str],
        rest_deviation: float = 1.0,
        led: Collection[str] = (),
    ) -> None:
        if not 0.0 < rest_deviation < np.inf:
            raise ValueError(f"the deviation about the rest posture is positive and finite, got {rest_deviation}")
        self.names = tuple(tasks)
        self.joints = np.concatenate([robot.indices(group) for group in joints])
        self.joint_names = tuple(robot.joint_names[i] for i in self.joints)
        self._views = [view for name, task in tasks.items() for view in _views(name, task)]
        self.led = tuple(led)
        used = {v.endpoint for v in self._views} | {v.observer for v in self._views if v.observer is not None}
        used |= set(led)
        unknown = sorted(used - set(robot.endpoints))
        if unknown:
            raise ValueError(f"the robot has no end points {unknown}; it has {list(robot.endpoints)}")
        self._used = sorted(used)
        self._data = robot.create_data()
        self._prior = np.eye(len(self.joints)) / rest_deviation**2
        self._still = np.zeros((6, len(self.joints)))
        self.at(robot.home, robot.home)  # compiles

    def at(
        self,
        q: Array,
        rest: Array,
        weights: Mapping[str, float] | None = None,
        references: Mapping[str, Gaussian] | None = None,
    ) -> Gaussian:
        """Where the tasks draw the joints, and how much each direction matters, as a Gaussian.

        Parameters
        ----------
        q
            (nv,), positions of the robot
        rest
            (nv,), the rest posture
        weights
            by task, 0 to 1: precisions are scaled by them; 1 where not named
        references
            end point → where a movement wants it in the base frame, on "R3 x S3": one more factor for each

        Returns
        -------
        Gaussian
            over the joint positions, rad or m
        """
        self._data.update(q)
        poses = {name: self._data.pose(name) for name in self._used}
        jacobians = {name: np.ascontiguousarray(self._data.jacobian(name)[:, self.joints]) for name in self._used}
        n = len(self.joints)
        precisions, maps, errors = [self._prior], [np.eye(n)], [rest[self.joints] - q[self.joints]]
        views = self._views
        if references:
            views = views + [_led(name, gaussian) for name, gaussian in references.items()]
        for view in views:
            weight = 1.0 if weights is None else weights.get(view.task, 1.0)
            if weight <= 0.0:
                continue
            pose, moves = view.pose, self._still
            if view.observer is not None:
                pose, moves = poses[view.observer], jacobians[view.observer]
            error, J = np.empty(6), np.empty((6, n))
            deviation(poses[view.endpoint], jacobians[view.endpoint], pose, moves, view.mean, error, J)
            precisions.append(weight * view.precision)
            maps.append(J)
            errors.append(error)
        precision, mean = to_joint_space(precisions, maps, errors, q[self.joints])
        covariance = np.linalg.inv(precision)
        return Gaussian(mean, 0.5 * (covariance + covariance.T))


class ActiveTasks:
    """Which of the tasks are active: each fades in and out over a time.

    The rest posture is where the robot is when the first task becomes active, and when a movement lets an end point go.
    While none is active, the robot is free: what nothing constrains stays where it is.

    Parameters
    ----------
    tasks
        all of them; none is active at first
    blend_time
        s
    """

    def __init__(self, tasks: HandTasks, blend_time: float = 0.5) -> None:
        self.tasks, self.blend_time = tasks, blend_time
        self._shares = dict.fromkeys(tasks.names, 0.0)
        self._led = dict.fromkeys(tasks.led, 0.0)
        self._references: dict[str, Gaussian] = {}  # the last ones
        self._fading: set[str] = set()  # end points that nobody leads any more
        self._chosen: frozenset[str] = frozenset()
        self._rest: Array | None = None

    def check(self, names: Collection[str]) -> None:
        """Check names of tasks.

        Raises
        ------
        ValueError
            for those that do not exist
        """
        unknown = sorted(set(names) - set(self.tasks.names))
        if unknown:
            raise ValueError(f"there are no tasks {unknown}; there are {list(self.tasks.names)}")

    def choose(self, names: Collection[str]) -> None:
        """Make these tasks active from now on, and all others inactive.

        Raises
        ------
        ValueError
            like `check`
        """
        self.check(names)
        self._chosen = frozenset(names)

    @property
    def holding(self) -> tuple[str, ...]:
        """The tasks whose weight is not zero."""
        return tuple(name for name, share in self._shares.items() if share > 0.0)

    def step(self, q: Array, dt: float, references: Mapping[str, Gaussian] | None = None) -> Gaussian:
        """The Gaussian over the joints.

        Parameters
        ----------
        q
            (nv,), positions of the robot
        dt
            since the last step, s
        references
            end point → where a movement wants it now, as for `HandTasks.at`. It fades in where there was none before,
            and out, as it was, where there is none any more

        Returns
        -------
        Gaussian
            over the joint positions, rad or m
        """
        self._references |= references or {}
        for shares, chosen in ((self._shares, self._chosen), (self._led, references or {})):
            for name, share in shares.items():
                change = dt / self.blend_time if name in chosen else -dt / self.blend_time
                shares[name] = min(1.0, max(0.0, share + change))
        led = {name: smoothstep(share) for name, share in self._led.items() if share > 0.0}
        if not self.holding and not led:
            self._rest = None
            joints = self.tasks.joints
            return Gaussian(q[joints], UNCONSTRAINED_VARIANCE * np.eye(len(joints)))
        fading = {name for name in led if name not in (references or {})}
        if self._rest is None or fading - self._fading:  # a hand that is let go stays where it is
            self._rest = q.copy()
        self._fading = fading
        weights = {name: smoothstep(share) for name, share in self._shares.items()}
        wanted = {name: self._references[name] for name in led}
        scaled = {name: Gaussian(g.mean, g.covariance / led[name], g.manifold) for name, g in wanted.items()}
        return self.tasks.at(q, self._rest, weights, scaled)


def _led(endpoint: str, wanted: Gaussian) -> _View:
    """An end point as the base sees it, and where a movement wants it."""
    return _View("", endpoint, None, BASE_POSE, np.array(wanted.mean), wanted.precision)


def _views(name: str, task: HandTask) -> list[_View]:
    views = []
    for frame in task.model.frame_names_:
        place = task.places[frame]
        observer = place if isinstance(place, str) else None
        pose = np.zeros(7) if isinstance(place, str) else np.array(place, dtype=np.float64)
        learned = Gaussian(task.model.means_[frame][0], task.model.covariances_[frame][0], POSE)
        views.append(_View(name, task.endpoint, observer, pose, np.array(learned.mean), learned.precision))
    return views


@compiled
def deviation(hand: Array, J_hand: Array, body: Array, J_body: Array, mean: Array, error: Array, J: Array) -> None:
    """Deviation of a hand, as a body sees it, from a mean pose, and how joints change that.

    Parameters
    ----------
    hand, J_hand
        pose (7,) and Jacobian (6, n) of the hand in base axes
    body, J_body
        the same of the body
    mean
        (7,), in the axes of the body
    error
        (6,), written: log from the pose seen to the mean, about the body's axes, in the tangent space at the mean
    J
        (6, n), written: -d error / dq; the derivative of the logarithm is the inverse left Jacobian of SO(3)
    """
    n = J.shape[1]
    R, rate = np.empty((3, 3)), np.empty((3, 3))
    rotation(body[3], body[4], body[5], body[6], R)
    way = hand[:3] - body[:3]
    x, y, z, w = -body[3], -body[4], -body[5], body[6]
    a, b, c, d = hand[3], hand[4], hand[5], hand[6]
    # the hand's quaternion in the body's axes: conj(q_body) q_hand
    seen_x, seen_y = w * a + x * d + y * c - z * b, w * b - x * c + y * d + z * a
    seen_z, seen_w = w * c + x * b - y * a + z * d, w * d - x * a - y * b - z * c
    turned = quaternion_difference(seen_x, seen_y, seen_z, seen_w, mean[3], mean[4], mean[5], mean[6])
    inverse_left_jacobian(turned[0], turned[1], turned[2], rate)
    for i in range(3):
        error[i] = mean[i] - (R[0, i] * way[0] + R[1, i] * way[1] + R[2, i] * way[2])
        error[3 + i] = -turned[i]
    linear, angular, about = np.empty(3), np.empty(3), np.empty(3)
    for k in range(n):
        wx, wy, wz = J_body[3, k], J_body[4, k], J_body[5, k]
        linear[0] = J_hand[0, k] - J_body[0, k] + way[1] * wz - way[2] * wy
        linear[1] = J_hand[1, k] - J_body[1, k] + way[2] * wx - way[0] * wz
        linear[2] = J_hand[2, k] - J_body[2, k] + way[0] * wy - way[1] * wx
        for i in range(3):
            angular[i] = J_hand[3 + i, k] - J_body[3 + i, k]
        for i in range(3):
            J[i, k] = R[0, i] * linear[0] + R[1, i] * linear[1] + R[2, i] * linear[2]
            about[i] = R[0, i] * angular[0] + R[1, i] * angular[1] + R[2, i] * angular[2]
        for i in range(3):
            J[3 + i, k] = rate[i, 0] * about[0] + rate[i, 1] * about[1] + rate[i, 2] * about[2]
