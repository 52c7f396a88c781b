# SPDX-License-Identifier: Apache-2.0
"""A scripted teacher: leads the hand of a robot in gravity compensation through the task by force, as a person would.

Persons differ from one time to the next: in pace, in the path, by reaching too far and coming back. And they look:
where it matters they correct until the hand is where it should be.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np

from tpgmm_core.common.blending import minimum_jerk
from tpgmm_core.common.types import Array
from tpgmm_core.geometry.manifold import POSE
from tpgmm_demos.scene.pick_place import CLEARANCE, Placement, hand_at


@dataclass(frozen=True, slots=True, kw_only=True)
class TeacherConfig:
    """How the teacher moves and how firmly.

    Parameters
    ----------
    pace
        relative standard deviation of the duration of each part of the movement
    via_noise, via_turn_noise
        how far the hand misses a place that does not matter (standard deviation, m and rad)
    aim_noise, aim_turn_noise
        the same at a place that matters (the teacher looks, but nobody is perfect)
    overshoot
        share of a movement by which it reaches too far
    stiffness, damping
        of the teacher's own arm; N/m and N s/m, then N m/rad and N m s/rad
    correction
        how fast an offset that is seen is worked off, 1/s
    max_force, max_torque
        what the teacher gives at most, N and N m
    """

    pace: float = 0.06
    via_noise: float = 0.012
    via_turn_noise: float = 0.04
    aim_noise: float = 0.0015
    aim_turn_noise: float = 0.008
    overshoot: float = 0.02
    stiffness: tuple[float, float] = (600.0, 35.0)
    damping: tuple[float, float] = (70.0, 3.0)
    correction: float = 3.0
    max_force: float = 40.0
    max_torque: float = 8.0


@dataclass(frozen=True, slots=True)
class _Part:
    start: float
    duration: float
    origin: Array
    goal: Array
    overshoot: float


class Intention:
    """Where the teacher wants the hand to be at each time: rest-to-rest movements of least jerk through the places.

    Parameters
    ----------
    home
        where the hand is when the teaching starts
    situation
        where the object and the target are
    config
        how people vary
    random
        where the variation comes from
    """

    def __init__(self, home: Array, situation: Placement, config: TeacherConfig, random: np.random.Generator) -> None:
        via = config.via_noise, config.via_turn_noise
        aim = config.aim_noise, config.aim_turn_noise
        pick, place = situation.object, situation.target
        plan = [  # where to, how exactly, how long (s)
            (hand_at(pick, CLEARANCE), via, 2.2),
            (hand_at(pick), aim, 1.5),
            (None, aim, 1.2),
            (hand_at(pick, CLEARANCE), via, 1.1),
            (hand_at(place, CLEARANCE), via, 2.4),
            (hand_at(place), aim, 1.5),
            (None, aim, 1.2),
        ]
        tempo = np.exp(config.pace * random.standard_normal())
        self._parts: list[_Part] = []
        origin, start = home, 0.0
        for aim_at, (noise, turn_noise), duration in plan:
            resting = aim_at is None
            goal = origin
            if aim_at is not None:
                goal = POSE.exp(aim_at, random.standard_normal(6) * np.repeat([noise, turn_noise], 3))
            duration *= tempo * np.exp(0.5 * config.pace * random.standard_normal())
            reach = 0.0 if resting else config.overshoot * random.uniform(0.0, 1.0)
            self._parts.append(_Part(start, duration, origin, goal, reach))
            origin, start = goal, start + duration
        self.duration = start
        self._sway = random.uniform(0.0, 2.0 * np.pi, 6), random.uniform(0.3, 0.8, 6)

    def at(self, time: float) -> tuple[Array, bool]:
        """The intended pose at a time in s since the start, and whether the hand rests at a place that matters."""
        part = self._parts[0]
        for part in self._parts:
            if time < part.start + part.duration:
                break
        s = min(1.0, max(0.0, (time - part.start) / part.duration))
        progress = minimum_jerk(s)
        # Reaching too far and coming back: added where the movement ends, gone when it has ended.
        progress += part.overshoot * 27.0 * s**6 * (1.0 - s) ** 2 * 4.0
        step = POSE.log(part.origin, part.goal)
        resting = part.goal is part.origin  # not by the step, which rounding keeps from being zero
        pose = POSE.exp(part.origin, progress * step)
        phases, rates = self._sway
        moving = 0.0 if resting else np.sin(np.pi * s) ** 2
        sway = moving * np.sin(2.0 * np.pi * rates * time + phases) * np.repeat([0.004, 0.015], 3)
        return POSE.exp(pose, sway), resting


class IntendedPath(Protocol):
    """Where a hand is meant to be."""

    def at(self, time: float) -> tuple[Array, bool]:
        """The pose (7,) at a time in s, and whether it matters that the hand is there, so that one corrects."""


class Teacher[PathT: IntendedPath]:
    """The force with which the teacher leads the hand: a spring and a damper towards the intention, and a correction.

    Parameters
    ----------
    intention
        where the hand is to be
    config
        how firmly
    """

    def __init__(self, intention: PathT, config: TeacherConfig) -> None:
        self.intention = intention
        self._stiffness = np.repeat(config.stiffness, 3)
        self._damping = np.repeat(config.damping, 3)
        self._limit = np.repeat([config.max_force, config.max_torque], 3)
        self._correction = config.correction
        self._offset = np.zeros(6)
        self._last: tuple[float, Array, Array] | None = None

    def wrench(self, time: float, hand: Array) -> Array:
        """Force and torque (6,) in base axes, N and N m, at a time in s since the start, with the hand at a pose."""
        wanted, resting = self.intention.at(time)
        velocity_error = np.zeros(6)
        if self._last is not None and time > self._last[0]:
            last_time, last_hand, last_wanted = self._last
            step = time - last_time
            velocity_error = (POSE.log(last_wanted, wanted) - POSE.log(last_hand, hand)) / step
            error = POSE.log(hand, wanted)
            # While moving, the correction of the last place is let go of.
            self._offset += step * (self._correction * error if resting else -1.0 * self._offset)
        self._last = time, hand, wanted
        error = POSE.log(hand, wanted) + self._offset
        return np.clip(self._stiffness * error + self._damping * velocity_error, -self._limit, self._limit)
