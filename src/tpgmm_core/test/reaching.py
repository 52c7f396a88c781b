# SPDX-License-Identifier: Apache-2.0
"""A small model that several tests reproduce: the hand goes from a start to an object, both wherever they are."""

from __future__ import annotations

from functools import cache

import numpy as np

from tpgmm_core import TPGMM, Demonstration, Frame, quaternion
from tpgmm_core.quaternion import Array

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
    times = np.linspace(0.0, DURATION, 60)
    s = times / DURATION
    blend = (s**3 * (10.0 - 15.0 * s + 6.0 * s**2))[:, None]
    demonstrations = []
    for _ in range(count):
        start = place(*random.uniform(-0.1, 0.1, 2), random.uniform(-0.5, 0.5))
        goal = place(0.5 + random.uniform(-0.1, 0.1), random.uniform(-0.1, 0.1), random.uniform(-0.5, 0.5))
        noise = 2e-3 * random.standard_normal((60, 3))
        positions = start[:3] + blend * (goal - start)[:3] + noise
        turns = quaternion.slerp(np.tile(start[3:], (60, 1)), goal[3:], blend[:, 0])
        frames = frames_at(start=start, object=goal)
        demonstrations.append(Demonstration(times, np.column_stack([times, positions, turns]), frames))
    return tuple(demonstrations)


@cache
def reaching_model() -> TPGMM:
    """A model of the demonstrations over [time, pose]."""
    model = TPGMM(n_components=4, reg_covar=1e-5, manifold="R1 x R3 x S3").fit(reaching_demonstrations())
    model.metadata_ = {"duration_s": DURATION}
    return model
