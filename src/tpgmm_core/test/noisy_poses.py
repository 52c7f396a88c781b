# SPDX-License-Identifier: Apache-2.0
"""Poses as perception sees them, and what they do to the references of a movement."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np

from tpgmm_core import Frame, LearnedMixture
from tpgmm_core.common.types import Array
from tpgmm_core.geometry.manifold import POSE, Manifold
from tpgmm_core.observation.tracked import TrackingConfig
from tpgmm_core.observation.tracking import FrameTracker
from tpgmm_core.retrieval.methods import make_retrieval

SECOND = 1_000_000_000
WINDOW = 0.02  # s
BOUND = 1.1

type Frames = Mapping[str, Frame]


@dataclass(frozen=True)
class Noise:
    """Standard deviations of each coordinate, mm, and of each component of the rotation vector, deg."""

    millimetres: float
    degrees: float = 0.5

    def on(self, poses: Mapping[str, Array], random: np.random.Generator) -> dict[str, Array]:
        """Poses (7,), or planar ones [x, y, angle], as they are seen; the robot's own frame is known."""
        return {name: pose if name == "robot" else self._on(pose, random) for name, pose in poses.items()}

    def _on(self, pose: Array, random: np.random.Generator) -> Array:
        shift, turn = 1e-3 * self.millimetres * random.normal(size=3), np.radians(self.degrees) * random.normal(size=3)
        if len(pose) == 3:
            return pose + [*shift[:2], turn[2]]
        return POSE.exp(pose, [*shift, *turn])


def frames_of(poses: Mapping[str, Array]) -> dict[str, Frame]:
    """New frames over [time, data]."""
    return {name: _frame(pose).with_time() for name, pose in poses.items()}


def _frame(pose: Array) -> Frame:
    if len(pose) == 7:
        return Frame.from_pose(pose[:3], pose[3:])
    c, s = np.cos(pose[2]), np.sin(pose[2])
    return Frame(np.array([[c, -s], [s, c]]), pose[:2])


def seen_at(poses: Mapping[str, Array], noise: Noise, rate: float, seed: int) -> Callable[[float], Frames]:
    """The frames at a time, s: seen anew so many times per second, each time with other noise."""
    random = np.random.default_rng(seed)
    seen: list[dict[str, Frame]] = []

    def at(now: float) -> Frames:
        while len(seen) <= int(now * rate + 1e-9):
            seen.append(frames_of(noise.on(poses, random)))
        return seen[int(now * rate + 1e-9)]

    return at


def tracked_at(
    poses: Mapping[str, Array], noise: Noise, rate: float, seed: int, filter_time: float, before: float = 1.0
) -> Callable[[float], Frames]:
    """As `seen_at`, through the tracker's filter: poses (7,), which were seen for so many seconds before time 0."""
    random = np.random.default_rng(seed)
    tracker = FrameTracker(poses, config=TrackingConfig(filter_time=filter_time))
    tracked: list[dict[str, Frame]] = []

    def at(now: float) -> Frames:
        while len(tracked) <= int((now + before) * rate + 1e-9):
            stamp = SECOND + round(len(tracked) / rate * SECOND)
            for name, pose in noise.on(poses, random).items():
                refused = tracker.observe(name, pose, stamp, stamp, stamp)
                if refused:
                    raise ValueError(refused)
            known = {frame.name: frame.pose for frame in tracker.update(stamp)}
            tracked.append(frames_of({name: pose for name, pose in known.items() if pose is not None}))
        return tracked[int((now + before) * rate + 1e-9)]

    return at


@dataclass(frozen=True)
class Run:
    """References of a whole movement to a robot that is at once where it is to be."""

    manifold: Manifold
    means: Array  # (T, D)
    covariances: Array  # (T, n, n)
    phases: Array  # (T,)
    step_time: float  # s, the median

    @property
    def deviations(self) -> Array:
        """Standard deviations (T, n)."""
        return np.asarray(np.sqrt(np.diagonal(self.covariances, axis1=1, axis2=2)))


def run(
    model: LearnedMixture,
    method: str,
    frames_at: Callable[[float], Frames],
    start: Array,
    step: float,
    settle: float = 0.5,
) -> Run:
    """A movement from its start; step, settle : s."""
    retrieval = make_retrieval(model, method)
    retrieval.start(0, start)
    means, covariances, phases, taken, robot = [], [], [], [], start
    for i in range(1, round((retrieval.duration + settle) / step)):
        frames = frames_at(i * step)
        before = time.perf_counter()
        reference = retrieval.step(round(i * step * SECOND), frames, robot)
        taken.append(time.perf_counter() - before)
        robot = reference.gaussian.mean
        means.append(robot)
        covariances.append(reference.gaussian.covariance)
        phases.append(reference.phase)
    medians = float(np.median(taken))
    return Run(retrieval.manifold, np.array(means), np.array(covariances), np.array(phases), medians)


@dataclass(frozen=True)
class Own:
    """What the model itself makes of noise: movements in situations that stand still, each seen with other noise."""

    exact: Run
    runs: list[Run]

    @classmethod
    def of(
        cls,
        model: LearnedMixture,
        method: str,
        poses: Mapping[str, Array],
        noise: Noise,
        start: Array,
        step: float,
        count: int,
    ) -> Own:
        random = np.random.default_rng(count)
        still = [frames_of(noise.on(poses, random)) for _ in range(count)]
        exact = run(model, method, lambda _: frames_of(poses), start, step)
        return cls(exact, [run(model, method, _standing(frames), start, step) for frames in still])

    def spread(self) -> Array:
        """Of the means (n,), as a root mean square over the movement."""
        return rms(np.concatenate([away(self.exact, other) for other in self.runs]))

    def band(self, step: float) -> tuple[Array, Array]:
        """Standard deviations (T, n) that are right: within BOUND of the exact ones, or as the model makes of noise.

        As at any time within WINDOW: where one component takes over from another, noise moves the time.
        """
        exact = self.exact.deviations
        all_of = np.array([r.deviations for r in self.runs])
        low = np.minimum(exact / BOUND, all_of.min(axis=0))
        high = np.maximum(exact * BOUND, all_of.max(axis=0))
        reach = round(WINDOW / step)
        around = np.clip(np.arange(len(exact))[:, None] + np.arange(-reach, reach + 1), 0, len(exact) - 1)
        return low[around].min(axis=1), high[around].max(axis=1)


def _standing(frames: Frames) -> Callable[[float], Frames]:
    return lambda _: frames


def away(exact: Run, other: Run) -> Array:
    """By how much means differ, (T, n)."""
    return np.asarray(exact.manifold.log(exact.means, other.means))


def rms(differences: Array) -> Array:
    """Over time, (n,)."""
    return np.asarray(np.sqrt(np.mean(differences**2, axis=0)))


def positions(manifold: Manifold) -> list[int]:
    """The tangent dimensions that are positions."""
    return [int(i) for i in manifold.flat_tangent]


def lengths(manifold: Manifold, values: Array) -> tuple[float, float]:
    """Of what is in positions and in turns of (n,)."""
    flat = positions(manifold)
    turns = [i for i in range(len(values)) if i not in flat]
    return float(np.linalg.norm(values[flat])), float(np.linalg.norm(values[turns]))


def later_or_sooner(exact: Run, found: Run, step: float, most: float) -> float:
    """By how much standard deviations differ at worst, as a ratio >= 1, of the same profile later or sooner.

    What has no time of its own comes to the same place earlier or later, and is as firm there. Times of both runs are
    aligned, neither ever going back, at most so far apart (`most`, s): of all alignments the one whose worst moment is
    best. A reference that is firm and soft by turns, or is so at other places, finds none.
    """
    here, there = np.log(found.deviations), np.log(exact.deviations)
    reach, T = round(most / step), len(there)
    shifts = np.arange(-reach, reach + 1)
    best = np.zeros(len(shifts))
    for t, values in enumerate(here):
        at = t + shifts
        apart = np.abs(values - there[np.clip(at, 0, T - 1)]).max(axis=1)
        apart[(at < 0) | (at >= T)] = np.inf
        # as far on as at most one shift less, since the time there does not go back
        until = np.minimum.accumulate(best)
        best = np.maximum(apart, until if t == 0 else np.append(until[1:], until[-1]))
    return float(np.exp(best.min()))


def restlessness(run: Run) -> Array:
    """How much standard deviations go up and down, (n,): the total variation of their logarithms."""
    return np.asarray(np.abs(np.diff(np.log(run.deviations), axis=0)).sum(axis=0))
