# SPDX-License-Identifier: Apache-2.0
"""What is taught: how the teacher means both hands to move in each of the two lessons.

The cup stands in the left hand, the sugar cube hangs from the right. In each lesson the teacher keeps the one thing
that matters, and moves whatever does not as widely as the arms permit: only what varies can be found to be free.
Poses are [x, y, z, qx, qy, qz, qw] in the robot's base frame, m.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from tpgmm_core.common.blending import smoothstep
from tpgmm_core.common.types import Array
from tpgmm_core.geometry import quaternion
from tpgmm_core.geometry.manifold import POSE
from tpgmm_core.geometry.pose import compose

Poses = dict[str, Array]

HANDS = ("left", "right")
#: Where both lessons and all sequences begin. The left hand lies level and points inwards, its x axis up; the right
#: hand comes from above and behind, down by 45 deg, forward and to the left alike.
START: Poses = {
    "left": np.array([0.60, -0.03, 0.34, 0.5, -0.5, 0.5, 0.5]),
    "right": np.array([0.60, -0.03, 0.49, -0.35355339, 0.85355339, 0.14644661, 0.35355339]),
}
#: Where the elbows are then, m: both far out, which leaves the wrists the most room. With the left elbow above the hand
#: its wrist would be bent nearly to the stop.
ELBOWS: Poses = {"left": np.array([0.36, 0.52, 0.58]), "right": np.array([0.18, -0.50, 0.71])}
#: The axis of the cup in the left hand, and the place of the sugar above the cup, also in the axes of the left hand, m.
CUP_AXIS = np.array([1.0, 0.0, 0.0])
SUGAR_PLACE = np.array([0.15, 0.0, 0.0])

LESSON_TIME = 80.0
#: The movements begin and end gently, within this time, s.
FADE = 2.0
#: How surely a hand is kept where it matters: standard deviation of the teacher's slow wavering, m and rad.
WAVER, TURN_WAVER = 0.0002, 0.003
#: How far it is moved where it does not matter, standard deviation, m and rad: an arm that comes to a stop of a joint
#: cannot be led exactly any more.
SPREAD, TURN_SPREAD = np.array([0.065, 0.075, 0.075]), np.full(3, 0.15)
#: The level cup about the vertical, rad: farther, as it turns about no other axis.
CUP_TURN_SPREAD = 0.22


class MultisineExcitation:
    """Wandering about zero in several directions at once, with standard deviations `spread` (n,).

    Each direction has a sine of its own, with a whole number of periods: none of them goes along with another one,
    which would look like a constraint. Drawn from `random` are which is how fast, and where it begins.
    """

    def __init__(self, spread: Array, random: np.random.Generator) -> None:
        self._amplitudes = np.sqrt(2.0) * spread
        self._rates = 2.0 * np.pi / LESSON_TIME * (2.0 + random.permutation(len(spread)))
        self._phases = random.uniform(0.0, 2.0 * np.pi, len(spread))

    def at(self, time: float) -> Array:
        """(n,), zero at both ends of the lesson."""
        edge = np.clip(min(time, LESSON_TIME - time) / FADE, 0.0, 1.0)
        return np.asarray(smoothstep(edge) * self._amplitudes * np.sin(self._rates * time + self._phases))


#: Where the hands should be at a time, s, given where they are.
Lesson = Callable[[float, Poses], Poses]


def cup_lesson(random: np.random.Generator) -> Lesson:
    """Hold the cup level: it goes everywhere and turns about the vertical; the other hand does as it likes."""
    level = np.append(SPREAD, [TURN_WAVER, TURN_WAVER, CUP_TURN_SPREAD])
    excitation = MultisineExcitation(np.concatenate([level, SPREAD, TURN_SPREAD]), random)
    aside = START["right"] + np.array([0.05, -0.05, 0.0, 0.0, 0.0, 0.0, 0.0])

    def at(time: float, hands: Poses) -> Poses:
        step = excitation.at(time)
        return {"left": POSE.exp(START["left"], step[:6]), "right": POSE.exp(aside, step[6:])}

    return at


def sugar_lesson(random: np.random.Generator) -> Lesson:
    """Hold the sugar above the cup: both go everywhere together, and turn as they like."""
    excitation = MultisineExcitation(np.concatenate([SPREAD, TURN_SPREAD, np.full(3, WAVER), TURN_SPREAD]), random)

    def at(time: float, hands: Poses) -> Poses:
        step = excitation.at(time)
        # the teacher looks where the cup is, not where it was meant to be
        place = compose(hands["left"], np.concatenate([SUGAR_PLACE + step[6:9], quaternion.IDENTITY]))[:3]
        held = quaternion.multiply(quaternion.exp(step[9:]), START["right"][3:])
        return {"left": POSE.exp(START["left"], step[:6]), "right": np.concatenate([place, held])}

    return at


#: By the name of the task.
LESSONS: dict[str, Callable[[np.random.Generator], Lesson]] = {"hold_cup": cup_lesson, "hold_sugar": sugar_lesson}
