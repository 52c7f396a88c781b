# SPDX-License-Identifier: Apache-2.0
"""The work that is timed: smooth movements seen from several frames, with time as the first dimension."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from tpgmm_core import Demonstration, Frame
from tpgmm_core.geometry import quaternion


@dataclass(frozen=True)
class Workload:
    """Sizes of one piece of work; D counts time, and all frames have D dimensions."""

    name: str
    n_demonstrations: int
    n_samples: int
    n_frames: int
    D: int
    K: int


W1 = Workload("W1", n_demonstrations=10, n_samples=200, n_frames=3, D=4, K=6)
W2 = Workload("W2", n_demonstrations=20, n_samples=500, n_frames=5, D=8, K=10)


def random_frame(D: int, rng: np.random.Generator) -> Frame:
    """Rotation and translation of the D - 1 dimensions behind time."""
    Q, R = np.linalg.qr(rng.normal(size=(D - 1, D - 1)))
    return Frame(Q * np.sign(np.diagonal(R)), rng.normal(size=D - 1)).with_time()


def demonstrations(work: Workload, seed: int = 0) -> list[Demonstration]:
    """Movements that follow one path per frame, each for a part of the time, with noise."""
    rng = np.random.default_rng(seed)
    phase = np.linspace(0.0, 1.0, work.n_samples)
    bumps = np.exp(-0.5 * ((phase[:, None] - np.linspace(0.0, 1.0, 8)) / 0.12) ** 2)
    bumps /= bumps.sum(axis=1, keepdims=True)
    paths = [bumps @ rng.normal(size=(8, work.D - 1)) for _ in range(work.n_frames)]
    centres = np.linspace(0.0, 1.0, work.n_frames)
    shares = np.exp(-0.5 * ((phase[:, None] - centres) / (0.6 / work.n_frames)) ** 2)
    shares /= shares.sum(axis=1, keepdims=True)
    result = []
    for _ in range(work.n_demonstrations):
        frames = {f"frame_{j}": random_frame(work.D, rng) for j in range(work.n_frames)}
        seen = [path @ f.A[1:, 1:].T + f.b[1:] for path, f in zip(paths, frames.values(), strict=True)]
        xi = np.einsum("tp,ptd->td", shares, np.stack(seen)) + 0.02 * rng.normal(size=(work.n_samples, work.D - 1))
        times = 2.0 * phase
        result.append(Demonstration(times, np.column_stack([times, xi]), frames))
    return result


def projected(demos: list[Demonstration]) -> dict[str, np.ndarray]:
    """All samples as seen from each frame, name → (N, D)."""
    return {name: np.concatenate([d.projected()[name] for d in demos]) for name in demos[0].frames}


def pose_demonstrations(n_demonstrations: int, n_samples: int = 200, seed: int = 0) -> list[Demonstration]:
    """Hand poses over time, from above an object to above a target, both placed and turned at random.

    Data is time, position, quaternion (on R1 x R3 x S3), with the quaternions' signs as they come; frames are
    "object", "target" and "robot".
    """
    rng = np.random.default_rng(seed)
    phase = np.linspace(0.0, 1.0, n_samples)
    share = 1.0 / (1.0 + np.exp(-12.0 * (phase - 0.5)))
    lift = np.column_stack([np.zeros((n_samples, 2)), 0.1 + 0.2 * np.sin(np.pi * phase)])
    down = quaternion.exp([0.95 * np.pi, 0.0, 0.0])
    result = []
    for _ in range(n_demonstrations):
        places = [(0.3 * rng.normal(size=3), quaternion.exp([0.0, 0.0, 0.8 * rng.normal()])) for _ in range(2)]
        (p_object, q_object), (p_target, q_target) = places
        position = (1.0 - share)[:, None] * p_object + share[:, None] * p_target + lift
        position += 0.003 * rng.normal(size=(n_samples, 3))
        orientation = quaternion.slerp(quaternion.multiply(q_object, down), quaternion.multiply(q_target, down), share)
        orientation = quaternion.multiply(quaternion.exp(0.02 * rng.normal(size=(n_samples, 3))), orientation)
        orientation *= rng.choice([-1.0, 1.0], n_samples)[:, None]
        robot = (np.zeros(3), quaternion.IDENTITY)
        frames = {
            name: Frame.from_pose(p, q).with_time()
            for name, (p, q) in zip(("object", "target", "robot"), (*places, robot), strict=True)
        }
        result.append(Demonstration(phase, np.column_stack([phase, position, orientation]), frames))
    return result
