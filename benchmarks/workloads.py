# SPDX-License-Identifier: Apache-2.0
"""The work that is timed: smooth movements seen from several frames, with time as the first dimension."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from tpgmm_core import Demonstration, Frame


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
