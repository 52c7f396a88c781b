# SPDX-License-Identifier: Apache-2.0
"""Movements in a world in which frames are hidden and come back, of a robot that is at once where it is to be."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from reaching import DURATION, frames_at, place
from tpgmm_core import Frame
from tpgmm_core.learning.learned_mixture import LearnedMixture
from tpgmm_core.model.reference import Reference
from tpgmm_core.retrieval.knowledge import KnowledgeConfig
from tpgmm_core.retrieval.methods import make_retrieval
from tpgmm_core.retrieval.waiting import Waiting

START, GOAL = place(0.02, -0.03, 0.2), place(0.5, 0.02, -0.2)
SITUATION = frames_at(start=START, object=GOAL)
TICK_NS = 10_000_000
HIDDEN_AT, SEEN_AT = 0.8 * DURATION, 0.8 * DURATION + 1.0
SETTLED = 0.5
"""After so long a pause has taken effect, s."""


def waiting(model: LearnedMixture, **config: float) -> Waiting:
    """A movement of a model that waits; small models know little with all frames, hence the lower ratio."""
    limits = KnowledgeConfig(**{"unknown_ratio": 5.0, **config})
    return Waiting(make_retrieval(model), make_retrieval(model, horizon_steps=0), limits)


@dataclass
class World:
    """Frames and their weights at a time, s."""

    frames: Callable[[float], dict[str, Frame]]
    weights: Callable[[float], dict[str, float] | None] = lambda time: None


SEEN = World(lambda time: SITUATION)


def without(name: str) -> World:
    """A frame is hidden for a while."""
    left = {other: frame for other, frame in SITUATION.items() if other != name}
    return World(lambda time: left if HIDDEN_AT < time < SEEN_AT else SITUATION)


def run(movement: Waiting, world: World, seconds: float) -> list[Reference]:
    """The references, TICK_NS apart."""
    pose, references = START, []
    movement.start(0, pose)
    for i in range(1, round(1e9 * seconds) // TICK_NS):
        time = 1e-9 * i * TICK_NS
        reference = movement.step(i * TICK_NS, world.frames(time), pose, world.weights(time))
        pose = reference.gaussian.mean
        references.append(reference)
    return references


def between(references: list[Reference], begin: float, end: float) -> list[Reference]:
    """Those of the times, s, in between."""
    return references[round(1e9 * begin) // TICK_NS : round(1e9 * end) // TICK_NS - 1]


def speeds(references: list[Reference]) -> np.ndarray:
    """m/s between neighbours, (T - 1,)."""
    places = np.array([reference.gaussian.mean[:3] for reference in references])
    return np.linalg.norm(np.diff(places, axis=0), axis=1) / (1e-9 * TICK_NS)
