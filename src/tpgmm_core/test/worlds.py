# SPDX-License-Identifier: Apache-2.0
"""Moving the whole world, and planar demonstrations to do so with."""

from __future__ import annotations

from collections.abc import Mapping
from functools import cache

import numpy as np

from random_problems import random_quaternion
from tpgmm_core import Demonstration, Frame, Gaussian

DURATION = 2.0


def planar_frame(x: float, y: float, angle: float, scale: float = 1.0) -> Frame:
    c, s = scale * np.cos(angle), scale * np.sin(angle)
    return Frame(np.array([[c, -s], [s, c]]), np.array([x, y]))


@cache
def planar_demonstrations() -> tuple[Demonstration, ...]:
    """[time, x, y]: from a start, in its x direction, to a goal, along its y direction; at rest at both."""
    random = np.random.default_rng(3)
    times = np.linspace(0.0, DURATION, 80)
    u = times / DURATION
    blend = (u**3 * (10.0 - 15.0 * u + 6.0 * u**2))[:, None]
    demonstrations = []
    for _ in range(5):
        start = planar_frame(*random.uniform(-0.2, 0.2, 2), random.uniform(-0.5, 0.5))
        goal = planar_frame(1.0 + random.uniform(-0.2, 0.2), random.uniform(-0.3, 0.3), random.uniform(-0.5, 0.5))
        leaving = start.b + 0.5 * blend * start.A[:, 0]
        arriving = goal.b - 0.5 * (1.0 - blend) * goal.A[:, 1]
        positions = (1.0 - blend) * leaving + blend * arriving + 0.01 * random.normal(size=2) * blend * (1 - blend)
        frames = {"start": start.with_time(), "goal": goal.with_time()}
        demonstrations.append(Demonstration(times, np.column_stack([times, positions]), frames))
    return tuple(demonstrations)


def planar_situation() -> dict[str, Frame]:
    """A new one."""
    return {"start": planar_frame(-0.1, 0.3, 0.4).with_time(), "goal": planar_frame(1.2, -0.4, -0.6).with_time()}


def random_world(dimensions: int, rng: np.random.Generator) -> Frame:
    """A rotation and a translation of the world: of the plane, or of poses."""
    if dimensions == 2:
        return planar_frame(*rng.normal(size=2), rng.uniform(-np.pi, np.pi))
    return Frame.from_pose(rng.normal(size=3), random_quaternion(rng))


def moved(world: Frame, frames: Mapping[str, Frame]) -> dict[str, Frame]:
    """The frames (over [time, data]) in the moved world."""
    w = world.with_time()
    return {name: Frame(w.A @ frame.A, w.A @ frame.b + w.b) for name, frame in frames.items()}


def assert_moved(world: Frame, before: list[Gaussian], after: list[Gaussian], tolerance: float = 1e-9) -> None:
    for g, h in zip(before, after, strict=True):
        expected = g.transform(world)
        np.testing.assert_allclose(g.manifold.log(expected.mean, h.mean), 0.0, atol=tolerance)
        scale = np.abs(expected.covariance).max()
        np.testing.assert_allclose(h.covariance, expected.covariance, rtol=0.0, atol=tolerance * max(scale, 1.0))
