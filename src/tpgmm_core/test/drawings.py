# SPDX-License-Identifier: Apache-2.0
"""Six planar shapes between a start and a goal, drawn somewhere else each time, as skills to be recognised."""

from __future__ import annotations

from functools import cache

import numpy as np

from tpgmm_core import Demonstration
from tpgmm_core.geometry.manifold import Manifold
from tpgmm_core.recognition.skill import Skill
from tpgmm_core.retrieval.recipe import Recipe
from worlds import planar_frame

DURATION, SAMPLES = 2.0, 60
SHAPES = ("line", "arc", "wave", "hook", "loop", "detour")


def drawn(shape: str, rng: np.random.Generator, noise: float = 0.004) -> Demonstration:
    """[time, x, y]: a shape from a start to a goal, which lie and are turned as chance has it; lengths about 1."""
    s = np.linspace(0.0, 1.0, SAMPLES)
    s = s**2 * (3.0 - 2.0 * s)
    side = {
        "line": 0.0 * s,
        "arc": 0.35 * np.sin(np.pi * s),
        "wave": 0.25 * np.sin(2.0 * np.pi * s),
        "hook": 0.6 * s**3 * np.sin(np.pi * s),
        "loop": 0.25 * (1.0 - np.cos(2.0 * np.pi * s)),
        "detour": -0.35 * np.sin(np.pi * s),
    }[shape]
    along = s - (0.25 * np.sin(2.0 * np.pi * s) if shape == "loop" else 0.0)
    start, goal = rng.uniform(-0.5, 0.5, 2), rng.uniform(-0.5, 0.5, 2) + rng.choice([-1.5, 1.5], 2)
    angle = float(np.arctan2(*(goal - start)[::-1]))
    length = float(np.linalg.norm(goal - start))
    R = planar_frame(0.0, 0.0, angle).A
    path = start + length * np.column_stack([along, side]) @ R.T
    path = (
        path + np.cumsum(rng.normal(size=path.shape), axis=0) * noise / 4.0 + 0.3 * noise * rng.normal(size=path.shape)
    )
    frames = {
        "start": planar_frame(*start, angle, length).with_time(),
        "goal": planar_frame(*goal, angle, length).with_time(),
    }
    times = np.linspace(0.0, DURATION, SAMPLES) * rng.uniform(0.8, 1.25)
    return Demonstration(times, np.column_stack([times, path]), frames)


def stretched(demonstration: Demonstration) -> Demonstration:
    times = demonstration.times * DURATION / demonstration.times[-1]
    return Demonstration(times, np.column_stack([times, demonstration.data[:, 1:]]), demonstration.frames)


@cache
def skills() -> tuple[Skill, ...]:
    rng = np.random.default_rng(0)
    recipe = Recipe.of({"n_components": 6, "reg_covar": 1e-4})
    found = []
    for shape in SHAPES:
        model = recipe.learn([stretched(drawn(shape, rng)) for _ in range(5)], Manifold.parse("R1 x R2"))
        found.append(Skill.of_model(shape, model))
    return tuple(found)
