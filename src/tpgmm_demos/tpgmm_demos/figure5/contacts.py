# SPDX-License-Identifier: Apache-2.0
"""Contacts of people with the robot: hand guiding in a lesson, and pushing it afterwards."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from tpgmm_core.common.blending import minimum_jerk
from tpgmm_core.common.types import Array
from tpgmm_core.geometry.manifold import POSE
from tpgmm_demos.figure5.lessons import ELBOWS, FADE, HANDS, START, Lesson, Poses
from tpgmm_demos.figure5.session import Session, Wrench
from tpgmm_demos.teaching.teacher import Teacher, TeacherConfig

#: A teacher who looks and corrects: position and orientation of a hand, the position of an elbow.
HAND = TeacherConfig(stiffness=(3000.0, 300.0), damping=(110.0, 4.0), correction=8.0, max_force=60.0, max_torque=20.0)
ELBOW = TeacherConfig(stiffness=(200.0, 0.0), damping=(25.0, 0.0), correction=0.0, max_force=30.0, max_torque=0.0)
#: Who pushes goes on until the link is about where it was to be, and does not turn it.
PUSH = TeacherConfig(stiffness=(1000.0, 0.0), damping=(30.0, 0.0), correction=0.0, max_force=70.0, max_torque=0.0)
#: The same by someone who has a grip on the hand, and keeps it level; about the vertical it may turn.
GRIP = replace(PUSH, stiffness=(1000.0, 300.0), damping=(30.0, 4.0), max_torque=20.0)
LEVELLING = np.array([1.0, 1.0, 1.0, 1.0, 1.0, 0.0])
#: The way to the start takes this long, then the hands are held there until they rest, s.
WAY, REST = 3.0, 1.0
#: An elbow goes along with its hand by this share.
ELBOW_SHARE = 0.5


def elbow(hand: str) -> str:
    """The link at the elbow."""
    return f"{hand}_lower_elbow"


@dataclass(frozen=True, slots=True)
class _Aim:
    """Where a link is meant to be over time; it always matters."""

    where: Callable[[float], Array]

    def at(self, time: float) -> tuple[Array, bool]:
        return self.where(time), True


def contact(config: TeacherConfig, where: Callable[[float], Array]) -> Wrench:
    """The wrench of someone who means a link to be `where`(time): pose (7,)."""
    return Teacher(_Aim(where), config).wrench


def hand_guiding(
    session: Session, aims: Callable[[float], Poses], elbows: Callable[[float], Poses]
) -> list[tuple[str, Wrench]]:
    """Both arms led by the hands, with a light hand at each elbow.

    Parameters
    ----------
    session
        the running graph
    aims
        time, s → poses (7,) of the hands
    elbows
        time, s → places (3,) of the elbows, m

    Returns
    -------
    list[tuple[str, Wrench]]
        link and wrench of each contact
    """
    hands, arms = [], []
    for hand in HANDS:
        here = session.pose(elbow(hand))

        def of_hand(time: float, hand: str = hand) -> Array:
            return aims(time)[hand]

        def of_elbow(time: float, hand: str = hand, here: Array = here) -> Array:
            return np.concatenate([elbows(time)[hand], here[3:]])

        hands.append((session.robot.endpoints[hand].frame, contact(HAND, of_hand)))
        arms.append((elbow(hand), contact(ELBOW, of_elbow)))
    return hands + arms


def to_start(session: Session) -> None:
    """Lead hands and elbows to where lessons and sequences begin."""
    begin = {hand: session.pose(session.robot.endpoints[hand].frame) for hand in HANDS}
    bent = {hand: session.pose(elbow(hand))[:3] for hand in HANDS}

    def aims(time: float) -> Poses:
        share = minimum_jerk(time / WAY)
        return {hand: POSE.exp(pose, share * POSE.log(pose, START[hand])) for hand, pose in begin.items()}

    def elbows(time: float) -> Poses:
        share = minimum_jerk(time / WAY)
        return {hand: place + share * (ELBOWS[hand] - place) for hand, place in bent.items()}

    session.run(WAY + REST, hand_guiding(session, aims, elbows))
    session.run(FADE / 4)


def lesson_contacts(session: Session, lesson: Lesson) -> list[tuple[str, Wrench]]:
    """Both arms led through a lesson, by a teacher who sees where the hands are; the elbows go along."""
    links = {hand: session.robot.endpoints[hand].frame for hand in HANDS}

    def aims(time: float) -> Poses:
        return lesson(time, {hand: session.pose(link) for hand, link in links.items()})

    def elbows(time: float) -> Poses:
        wanted = aims(time)
        return {hand: ELBOWS[hand] + ELBOW_SHARE * (wanted[hand] - START[hand])[:3] for hand in HANDS}

    return hand_guiding(session, aims, elbows)


def push(session: Session, link: str, way: Array, duration: float) -> tuple[str, Wrench]:
    """Someone moves a link, and holds it there.

    Parameters
    ----------
    session
        the running graph
    link
        its name
    way
        shape (3,), m, in base axes
    duration
        of the movement, s

    Returns
    -------
    tuple[str, Wrench]
        link and wrench
    """
    return link, contact(PUSH, _moving(session.pose(link), way, duration))


def gripped_push(session: Session, link: str, way: Array, duration: float) -> tuple[str, Wrench]:
    """The same as `push` by someone who keeps the link level meanwhile.

    Parameters
    ----------
    session, link, way, duration
        as for `push`

    Returns
    -------
    tuple[str, Wrench]
        link and wrench
    """
    wrench = contact(GRIP, _moving(session.pose(link), way, duration))
    return link, lambda time, pose: wrench(time, pose) * LEVELLING


def _moving(begin: Array, way: Array, duration: float) -> Callable[[float], Array]:
    return lambda time: begin + np.concatenate([minimum_jerk(time / duration) * way, np.zeros(4)])


class Record:
    """A wrench and, as long as it acts, its forces, so that they can be repeated."""

    def __init__(self, wrench: Wrench) -> None:
        self._wrench = wrench
        self._times: list[float] = []
        self._forces: list[Array] = []

    def __call__(self, time: float, pose: Array) -> Array:
        """Wrench (6,) at a time, s, with the link at a pose (7,); it is kept."""
        wrench = self._wrench(time, pose)
        self._times.append(time)
        self._forces.append(wrench[:3])
        return wrench

    def repeated(self, time: float, pose: Array) -> Array:
        """The same force at the same time, whatever the link does; no torque."""
        now = int(np.searchsorted(self._times, time + 1e-9)) - 1
        return np.concatenate([self._forces[max(now, 0)], np.zeros(3)])
