# SPDX-License-Identifier: Apache-2.0
"""Wiping: a hand goes round and round before an object, which is elsewhere in each demonstration."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cache

import numpy as np

from reaching import frames_at, place
from tpgmm_core import Demonstration
from tpgmm_core.common.types import Array
from tpgmm_core.geometry import quaternion
from tpgmm_core.geometry.manifold import POSE

PERIOD = 1.5
ROBOT = place(0.0, 0.0, 0.0)


def wiping_poses(before: Array, phases: Array) -> Array:
    """Poses (T, 7) of the hand at phases, before an object's pose (7,): an egg of some 0.2 m, and a hand that rolls."""
    turn = np.zeros((len(phases), 6))
    turn[:, 0] = 0.2 + 0.05 * np.cos(phases) + 0.01 * np.cos(2.0 * phases)
    turn[:, 1] = 0.1 * np.sin(phases)
    turn[:, 2] = 0.02 * np.sin(phases)
    rolled = quaternion.exp(0.3 * np.stack([np.sin(phases), 0.0 * phases, 0.0 * phases], axis=1))
    R = quaternion.rotation_matrix(before[3:])
    return np.column_stack([before[:3] + turn[:, :3] @ R.T, quaternion.multiply(before[3:], rolled)])


def wiping_demonstration(before: Array, random: np.random.Generator) -> Demonstration:
    """Three cycles and more, from anywhere on, at a pace that varies by a tenth, with tremor."""
    cycles, pace = random.uniform(3.0, 4.0), 2.0 * np.pi / PERIOD * random.uniform(0.8, 1.25)
    times = np.arange(0.0, cycles * 2.0 * np.pi / pace, 0.02)
    varied = pace * times + 0.1 * np.sin(pace * times / 2.3 + random.uniform(0.0, 6.0))
    poses = wiping_poses(before, random.uniform(-1.0, 1.0) + varied)
    poses = POSE.exp(poses, np.concatenate([random.normal(0.0, s, (len(times), 3)) for s in (1e-3, 5e-3)], axis=1))
    return Demonstration(times, np.column_stack([times, poses]), frames_at(robot=ROBOT, object=before))


@cache
def wiping_demonstrations(count: int = 6) -> tuple[Demonstration, ...]:
    """[time, pose] on "R1 x R3 x S3", frames "robot" and "object"."""
    random = np.random.default_rng(4)
    places = [place(*random.uniform(-0.3, 0.3, 2), random.uniform(-0.8, 0.8)) for _ in range(count)]
    return tuple(wiping_demonstration(where, random) for where in places)


def repeated(demonstration: Demonstration, cycles: int = 3) -> Demonstration:
    """The same path there and back, so many times, as a movement that repeats; constant frames stay."""
    T = len(demonstration.times)
    shares = 0.5 - 0.5 * np.cos(2.0 * np.pi * np.linspace(0.0, cycles, cycles * T))
    data = demonstration.data[np.round(shares * (T - 1)).astype(np.intp)].copy()
    data[:, 0] = np.linspace(0.0, cycles * float(demonstration.times[-1]), cycles * T)
    return Demonstration(data[:, 0], data, demonstration.frames)


def shown_for(method: str, demonstrations: Sequence[Demonstration]) -> tuple[Demonstration, ...]:
    """Demonstrations as a method can learn from them: there, or for periodic ones there and back again and again."""
    return tuple(map(repeated, demonstrations)) if method == "periodic" else tuple(demonstrations)
