# SPDX-License-Identifier: Apache-2.0
"""The frames of Eqs. (7) to (12): what each constraint says of the configuration q, linear about the step before.

They come from the Euler step of inverse kinematics, q_t = q_{t-1} + J^+ (x_t - x_{t-1}) + N (...), solved for q_t as a
map of what the frame sees, x_t: `q = A x + b`. A and b belong to one step only.

Each has its own inverse map M, with which it sees a configuration, x = M (q - b), and which also carries its precision
into configuration space, M^T Lambda M. Where nothing is damped, M = A^+ to rounding. Where a singularity makes the
robot unable to move in some direction, A and M fade out in it together: the frame neither asks for that motion, nor
counts its absence as a deviation. With the pseudo-inverse of a damped A the precision would grow without bound instead.

That M A < I in such directions is what makes priorities visible in demonstrations. Of two tasks that cannot both
be met, the lower one does what the upper one leaves to it. In its frame below the upper task its deviation is zero, in
its frame alone it is not: the frames with the small covariances are those of the order that was followed.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from tpgmm_core.geometry.frame import Frame
from tpgmm_core.kinematics.inverse import damped_gram_inverse, damped_pseudo_inverse
from tpgmm_core.kinematics.tasks import KinematicState, KinematicTask, KinematicTasks, View


class KinematicFrame(Protocol):
    """A map into configuration space that changes with each step."""

    @property
    def objects(self) -> frozenset[str]:
        """Names of the objects that it needs."""

    def at(self, moment: KinematicState) -> Frame:
        """The map at one step, A (n, m), b (n,), inverse (m, n).

        Parameters
        ----------
        moment
            robot and objects at this step

        Returns
        -------
        Frame
            the map

        Raises
        ------
        ValueError
            for objects that are not known
        """


@dataclass(frozen=True, slots=True)
class JointSpace:
    """Eq. (7), the configuration itself: A = I, b = 0."""

    objects = frozenset[str]()

    def at(self, moment: KinematicState) -> Frame:
        """The identity, at every step."""
        identity = np.eye(len(moment.q))
        return Frame(identity, np.zeros(len(moment.q)), identity)


@dataclass(frozen=True, slots=True)
class PreviousConfiguration:
    """How far joints go in a step: A = h I, b = q_{t-1}, Eq. (7) about the step before; h is `KinematicState.stride`.

    Learned from the demonstrations' own steps, it keeps the product from jumping where other frames constrain little:
    their product with it is the damped least-squares step of Levenberg and Marquardt.
    """

    objects = frozenset[str]()

    def at(self, moment: KinematicState) -> Frame:
        """A = h I about the configuration of the step before."""
        identity, h = np.eye(len(moment.q)), moment.stride
        return Frame(h * identity, moment.q, identity / h)


@dataclass(frozen=True, slots=True)
class TaskSpace:
    """Eqs. (8) and (9), where points of the robot are, in the world or relative to objects.

    A = J^+ A^O, b = q_{t-1} + J^+ (b^O - x_{t-1}); A^O = I and b^O = 0 in the world. It sees x by M = A^O^-1 J.
    Several tasks are stacked: they count as one, on the same level. Orientations: see `KinematicTask`.
    """

    tasks: KinematicTasks

    def __post_init__(self) -> None:
        _check_tasks(self.tasks)

    @property
    def objects(self) -> frozenset[str]:
        """The objects that the tasks are relative to."""
        return _objects(self.tasks)

    def at(self, moment: KinematicState) -> Frame:
        """A = J^+ A^O, with the damped pseudo-inverse of the tasks' Jacobian."""
        view = moment.view(self.tasks)
        J_inverse = damped_pseudo_inverse(view.J, moment.threshold)
        return Frame(J_inverse @ view.A, moment.q + J_inverse @ view.offset, _seen_from_objects(view.J, view))


@dataclass(frozen=True, slots=True)
class NullSpace:
    """Eq. (10), the part of the configuration that the tasks leave free: A = N, b = J^+ J q_{t-1}, N = I - J^+ J."""

    above: KinematicTasks

    def __post_init__(self) -> None:
        _check_tasks(self.above)

    @property
    def objects(self) -> frozenset[str]:
        """None: null spaces do not depend on where objects are."""
        return frozenset()  # null spaces do not depend on where objects are

    def at(self, moment: KinematicState) -> Frame:
        """A = N, the projection on motions that the tasks do not see."""
        N = moment.null_space(self.above)
        return Frame(N, moment.q - N @ moment.q, N)


@dataclass(frozen=True, slots=True)
class SecondaryTaskSpace:
    """Eqs. (11) and (12), tasks in the null space of those above them, in the world or relative to objects.

    A = N J^+ A^O, b = q_{t-1} + N J^+ (b^O - x_{t-1}), N of all tasks above together (the hierarchy of Siciliano and
    Slotine 1991, of any depth).

    Parameters
    ----------
    tasks
        of this level
    above
        all tasks of higher priority
    least_error
        whether (J N)^+ takes the place of N J^+, and J N that of J in the inverse map. Where the tasks can be met, both
        lead there. Where they cannot, this one leads to the least error e, where N J^T e = 0; N J^+ leads to
        N J^T (J J^T)^-1 e = 0
    """

    tasks: KinematicTasks
    above: KinematicTasks
    least_error: bool = False

    def __post_init__(self) -> None:
        _check_tasks(self.tasks)
        _check_tasks(self.above)

    @property
    def objects(self) -> frozenset[str]:
        """The objects that the tasks of this level are relative to."""
        return _objects(self.tasks)

    def at(self, moment: KinematicState) -> Frame:
        """A = N J^+ A^O, or (J N)^+ A^O with `least_error`, with damped inverses."""
        view, N = moment.view(self.tasks), moment.null_space(self.above)
        free = view.J @ N
        if self.least_error:
            J_inverse, M = damped_pseudo_inverse(free, moment.threshold), free
        else:
            gram_inverse = damped_gram_inverse(view.J, moment.threshold)
            J_inverse = free.T @ gram_inverse
            # (N J^T G)^+ = G^-1 (J N J^T)^-1 J N, of which the middle is damped as J^+ is
            M = np.linalg.solve(gram_inverse, damped_gram_inverse(free, moment.threshold) @ free)
        return Frame(J_inverse @ view.A, moment.q + J_inverse @ view.offset, _seen_from_objects(M, view))


def _seen_from_objects(M: np.ndarray, view: View) -> np.ndarray:
    return np.linalg.solve(view.A, M)


def _objects(tasks: KinematicTasks) -> frozenset[str]:
    return frozenset(task.relative_to for task in tasks if task.relative_to is not None)


def _check_tasks(tasks: Sequence[KinematicTask]) -> None:
    if not isinstance(tasks, tuple) or not tasks or not all(isinstance(task, KinematicTask) for task in tasks):
        raise ValueError(f"tasks are a tuple of at least one KinematicTask, got {tasks!r}")
