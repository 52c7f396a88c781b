# SPDX-License-Identifier: Apache-2.0
"""A small model that several tests reproduce: the hand goes from a start to an object, both wherever they are."""

from __future__ import annotations

from functools import cache

import numpy as np

from tpgmm_core import TPGMM, Demonstration, Frame
from tpgmm_core.common.types import Array
from tpgmm_core.geometry import quaternion
from tpgmm_core.geometry.manifold import POSE

DURATION = 2.0


def place(x: float, y: float, yaw: float) -> Array:
    return np.array([x, y, 0.1, *quaternion.exp([0.0, 0.0, yaw])])


def frames_at(**places: Array) -> dict[str, Frame]:
    """Frames over [time, pose] by name."""
    return {name: Frame.from_pose(pose[:3], pose[3:]).with_time() for name, pose in places.items()}


@cache
def reaching_demonstrations(count: int = 6) -> tuple[Demonstration, ...]:
    """[time, pose] on "R1 x R3 x S3", frames "start" and "object", 2 s."""
    random = np.random.default_rng(0)
    demonstrations = []
    for _ in range(count):
        start = place(*random.uniform(-0.1, 0.1, 2), random.uniform(-0.5, 0.5))
        goal = place(0.5 + random.uniform(-0.1, 0.1), random.uniform(-0.1, 0.1), random.uniform(-0.5, 0.5))
        demonstrations.append(demonstrate(start, goal, random))
    return tuple(demonstrations)


def demonstrate(start: Array, goal: Array, random: np.random.Generator) -> Demonstration:
    """A smooth movement from pose to pose (7,), as a hand that trembles does it."""
    times = np.linspace(0.0, DURATION, 60)
    s = times / DURATION
    blend = (s**3 * (10.0 - 15.0 * s + 6.0 * s**2))[:, None]
    noise = 2e-3 * random.standard_normal((60, 3))
    positions = start[:3] + blend * (goal - start)[:3] + noise
    turns = quaternion.slerp(np.tile(start[3:], (60, 1)), goal[3:], blend[:, 0])
    return Demonstration(times, np.column_stack([times, positions, turns]), frames_at(start=start, object=goal))


def reaching_near(hand: Array, count: int = 10) -> tuple[TPGMM, dict[str, Array]]:
    """A model of reaching in the workspace of a robot whose hand is at a pose (7,), and a new situation for it.

    The object lies some 0.2 m aside, elsewhere and turned otherwise in each demonstration; the situation is the poses
    by frame, of which "start" is the hand's.
    """
    random = np.random.default_rng(1)

    def goal() -> Array:
        shift = np.array([0.05, 0.18, -0.05]) + random.uniform(-0.05, 0.05, 3)
        return POSE.exp(hand, [*shift, 0.0, 0.0, random.uniform(-0.4, 0.4)])

    demonstrations = [demonstrate(hand, goal(), random) for _ in range(count)]
    model = TPGMM(n_components=5, reg_covar=1e-5, manifold="R1 x R3 x S3").fit(demonstrations)
    model.metadata_ = {"duration_s": DURATION}
    return model, {"start": hand.copy(), "object": goal()}


@cache
def reaching_model(count: int = 6) -> TPGMM:
    """A model of so many demonstrations over [time, pose]."""
    model = TPGMM(n_components=4, reg_covar=1e-5, manifold="R1 x R3 x S3").fit(reaching_demonstrations(count))
    model.metadata_ = {"duration_s": DURATION}
    return model
