# SPDX-License-Identifier: Apache-2.0
"""Hands of people on the robot: leading it in a lesson, and pushing it afterwards."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from tpgmm_core.manifold import POSE
from tpgmm_ros.figure5.lessons import FADE, HANDS, START, Array, Poses
from tpgmm_ros.figure5.session import Session, Wrench
from tpgmm_ros.teacher import Teacher, TeacherConfig

#: A teacher who looks and corrects: position and orientation of a hand, the position of an elbow.
HAND = TeacherConfig(stiffness=(3000.0, 300.0), damping=(110.0, 4.0), correction=8.0, max_force=60.0, max_torque=20.0)
ELBOW = TeacherConfig(stiffness=(200.0, 0.0), damping=(25.0, 0.0), correction=0.0, max_force=30.0, max_torque=0.0)
#: Who pushes goes on until the link is about where it was to be, and does not turn it.
PUSH = TeacherConfig(stiffness=(1000.0, 0.0), damping=(30.0, 0.0), correction=0.0, max_force=70.0, max_torque=0.0)
#: The same by someone who has a grip on the hand, and keeps it from turning.
GRIP = replace(PUSH, stiffness=(1000.0, 300.0), damping=(30.0, 4.0), max_torque=20.0)
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


def touch(config: TeacherConfig, where: Callable[[float], Array]) -> Wrench:
    """The wrench of someone who means a link to be `where`(time): pose (7,)."""
    return Teacher(_Aim(where), config).wrench


def smooth_step(share: float) -> float:
    """From 0 to 1 with the least jerk, for shares of the time from 0 to 1."""
    s = min(1.0, max(0.0, share))
    return s**3 * (10.0 - 15.0 * s + 6.0 * s**2)


def leading(session: Session, aims: Callable[[float], Poses]) -> list[tuple[str, Wrench]]:
    """Both arms led by the hands, with a light hand at each elbow, so that it does not drift where it pleases."""
    touches: list[tuple[str, Wrench]] = []
    for hand in HANDS:
        link = session.robot.endpoints[hand].frame
        start, begin = session.pose(elbow(hand)), session.pose(link)

        def of_hand(time: float, hand: str = hand) -> Array:
            return aims(time)[hand]

        def of_elbow(time: float, hand: str = hand, start: Array = start, begin: Array = begin) -> Array:
            step = np.zeros(7)
            step[:3] = ELBOW_SHARE * (aims(time)[hand][:3] - begin[:3])
            return start + step

        touches += [(link, touch(HAND, of_hand)), (elbow(hand), touch(ELBOW, of_elbow))]
    # hands first, then elbows
    return touches[::2] + touches[1::2]


def to_start(session: Session) -> None:
    """Lead both hands to where lessons and sequences begin."""
    begin = {hand: session.pose(session.robot.endpoints[hand].frame) for hand in HANDS}

    def aims(time: float) -> Poses:
        share = smooth_step(time / WAY)
        return {hand: POSE.exp(pose, share * POSE.log(pose, START[hand])) for hand, pose in begin.items()}

    session.run(WAY + REST, leading(session, aims))
    session.run(FADE / 4)


def lesson_aims(session: Session, lesson: Callable[[float, Poses], Poses]) -> Callable[[float], Poses]:
    """The aims of a lesson, in which the teacher sees where the hands are."""
    links = {hand: session.robot.endpoints[hand].frame for hand in HANDS}
    return lambda time: lesson(time, {hand: session.pose(link) for hand, link in links.items()})


def push(session: Session, link: str, way: Array, duration: float, config: TeacherConfig = PUSH) -> tuple[str, Wrench]:
    """Someone moves a link by a way (3,), m, within `duration` s, and holds it there."""
    begin = session.pose(link)

    def where(time: float) -> Array:
        return begin + np.concatenate([smooth_step(time / duration) * way, np.zeros(4)])

    return link, touch(config, where)
