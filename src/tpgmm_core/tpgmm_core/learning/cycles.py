# SPDX-License-Identifier: Apache-2.0
"""The phase of a movement that repeats: an angle at each sample, found in what the frames saw.

The period of a demonstration is found by the difference function (de Cheveigné and Kawahara, YIN, JASA 2002), which is
autocorrelation turned over: with d(l) the mean squared distance of the path from itself l samples later,

    d'(l) = d(l) l / sum_{s <= l} d(s),

whose first dip that is hardly less deep than the deepest one is the period. People do not keep their pace: each cycle
then begins where the path around it fits the mean cycle best, and between those times the phase grows evenly.

Demonstrations may begin anywhere. The angle between two of them is the one by which turning the mean cycle of one makes
it most likely given the other, with variances of their own in each frame: the sum of the logarithms of the mean squared
distances. So frames in which they do the same decide, and those that do not matter have no say. The mean of the
angles at which demonstrations begin is 0.

Distances are of positions, in m, and of orientations, of which a turn by 0.1 rad counts as a centimetre.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from tpgmm_core.common.types import Array
from tpgmm_core.geometry import quaternion
from tpgmm_core.geometry.manifold import Manifold

TURN = 2.0 * np.pi
STEPS = 100
"""Of the mean cycle: where demonstrations are held against each other."""
METRES_PER_RADIAN = 0.1
LEAST, MOST = 200, 1000
"""Evenly spaced samples in which the period is sought."""
REPEATS = 0.4
"""A path repeats itself where d' falls below."""
AS_DEEP = 0.1
"""A dip of d' that is less deep by this is as good: it may be the first of several periods."""
PACE = 0.2
"""A cycle begins earlier or later than those before say by this share of the period, at most."""
ROUNDS = 3
"""Of finding beginnings with the mean cycle, and the mean cycle with beginnings."""


@dataclass(frozen=True, slots=True, eq=False)
class Cycles:
    """A demonstration of a movement that repeats.

    Parameters
    ----------
    phases
        (T,), rad, at the samples; from 0 at the first, growing by 2 pi with each cycle
    shapes
        name → (STEPS, F), the mean cycle in each frame, in numbers of which distances count (`numbers_of`)
    """

    phases: Array
    shapes: dict[str, Array]

    @property
    def count(self) -> float:
        """Cycles that were shown, the part of the last one too."""
        return float(self.phases[-1] / TURN)


def numbers_of(space: Manifold, points: Array) -> Array:
    """Points (T, D) as numbers (T, F) whose distance is that of the points; rotations are matrices, without a sign."""
    parts = [points[:, space.flat_ambient]]
    for sphere in space.spheres:
        # of a rotation by w, |R - 1| is about sqrt(2) w in the Frobenius norm
        R = quaternion.rotation_matrix(points[:, sphere.ambient]).reshape(len(points), 9)
        parts.append(METRES_PER_RADIAN / np.sqrt(2.0) * R)
    return np.concatenate(parts, axis=1)


def cycles_of(times: Array, seen: dict[str, Array]) -> Cycles:
    """The cycles of one demonstration.

    Parameters
    ----------
    times
        (T,), s
    seen
        name → (T, F), what the frames saw, as `numbers_of` gives it

    Returns
    -------
    Cycles
        the phase at each sample

    Raises
    ------
    ValueError
        for a path that does not repeat itself, or less than twice
    """
    n = min(max(len(times), LEAST), MOST)
    even = np.linspace(times[0], times[-1], n)
    paths = {name: interpolated(times, x, even) for name, x in seen.items()}
    periods = {name: _period(path) for name, path in paths.items()}
    best = min(periods, key=lambda name: periods[name][1])
    lag, depth = periods[best]
    if not depth < REPEATS:
        raise ValueError(
            "the movement does not repeat itself: a periodic movement is shown by two cycles or more in a recording, "
            "without the way there and back"
        )
    begins = np.arange(0.0, n - 1 + 1e-6 * n, lag)
    for _ in range(ROUNDS):
        phases = _between(begins, np.arange(float(n)))
        begins = _fitted(paths[best], begins, lag, _mean_cycle(phases, paths[best]))
    phases = _between(begins, np.arange(float(n)))
    phases = np.interp(times, even, phases - phases[0])
    return Cycles(phases, {name: _mean_cycle(phases, x) for name, x in seen.items()})


def beginnings(shown: Sequence[Cycles]) -> Array:
    """Phases (m,) at which demonstrations begin, rad, of which the mean is 0."""
    turned = [shown[0].shapes]
    angles = [0.0, *(offset(one.shapes, turned[0]) for one in shown[1:])]
    for _ in range(ROUNDS - 1):
        turned = [{name: _turned(x, o) for name, x in one.shapes.items()} for one, o in zip(shown, angles, strict=True)]
        mean = {name: np.mean([one[name] for one in turned], axis=0) for name in turned[0]}
        angles = [offset(one.shapes, mean) for one in shown]
    mean_angle = np.angle(np.mean(np.exp(1j * np.array(angles))))
    return np.mod(np.array(angles) - mean_angle + np.pi, TURN) - np.pi


def offset(shapes: dict[str, Array], to: dict[str, Array]) -> float:
    """The angle that is to be added to the phase of one mean cycle, so that it fits another, rad.

    Parameters
    ----------
    shapes, to
        name → (STEPS, F), in the same frames

    Returns
    -------
    float
        0 to 2 pi
    """
    apart = {}
    for name, target in to.items():
        turned = np.stack([np.roll(shapes[name], k, axis=0) for k in range(STEPS)])
        apart[name] = np.mean(np.sum((turned - target) ** 2, axis=2), axis=1)
    floors = {name: 1e-6 * float(np.var(target, axis=0).sum()) + 1e-12 for name, target in to.items()}
    logarithms = [target_shape.shape[1] * np.log(apart[name] + floors[name]) for name, target_shape in to.items()]
    k = int(np.argmin(np.sum(logarithms, axis=0)))
    near = np.sum([x / (x[k] + floors[name]) for name, x in apart.items()], axis=0)
    return float(np.mod((k + _dip(near[k - 1], near[k], near[(k + 1) % STEPS])) * TURN / STEPS, TURN))


def _period(path: Array) -> tuple[float, float]:
    """Samples (n, F) after which a path repeats itself, and d' there; the path repeats itself where that is small."""
    longest = round(0.55 * len(path))
    d = np.array([np.mean(np.sum((path[lag:] - path[: len(path) - lag]) ** 2, axis=1)) for lag in range(longest + 1)])
    normalised = np.ones(len(d))
    total = np.cumsum(d[1:])
    if total[-1] > 0.0:
        normalised[1:] = d[1:] * np.arange(1, len(d)) / np.maximum(total, np.finfo(float).tiny)
    inner = normalised[1:-1]
    dips = 1 + np.flatnonzero((inner <= normalised[:-2]) & (inner < normalised[2:]))
    if len(dips) == 0:
        return float(longest), 1.0
    lag = int(dips[normalised[dips] <= normalised[dips].min() + AS_DEEP][0])
    return lag + _dip(d[lag - 1], d[lag], d[lag + 1]), float(normalised[lag])


def _dip(before: float, here: float, after: float) -> float:
    """Where the parabola through three neighbours is lowest, in their distance from the middle one."""
    curvature = before - 2.0 * here + after
    return 0.0 if not curvature > 0.0 else float(np.clip(0.5 * (before - after) / curvature, -0.5, 0.5))


def _fitted(path: Array, begins: Array, lag: float, cycle: Array) -> Array:
    """Beginnings of the cycles of a path (n, F) where half a cycle before and after fits the mean cycle best."""
    around = np.linspace(-0.5, 0.5, STEPS + 1)
    expected = cycle[np.arange(-(STEPS // 2), STEPS // 2 + 1)]
    shifts = PACE * lag * np.linspace(-1.0, 1.0, 41)
    found = begins.copy()
    for i, begin in enumerate(begins):
        at = begin + shifts[:, None] + around * lag
        inside = (at >= 0.0) & (at <= len(path) - 1)
        off = np.sum(
            (interpolated(np.arange(float(len(path))), path, at.ravel()).reshape(*at.shape, -1) - expected) ** 2, axis=2
        )
        costs = np.where(inside, off, 0.0).sum(axis=1) / np.maximum(inside.sum(axis=1), 1)
        k = int(np.argmin(costs[1:-1])) + 1
        found[i] = begin + shifts[k] + _dip(*costs[k - 1 : k + 2]) * (shifts[1] - shifts[0])
    return found if (np.diff(found) > 0.5 * lag).all() else begins


def _between(begins: Array, at: Array) -> Array:
    """Phases at some samples, evenly between the beginnings of cycles, and as before beyond the first and the last."""
    known = TURN * np.arange(len(begins))
    phases = np.interp(at, begins, known)
    if len(begins) > 1:
        before, after = at < begins[0], at > begins[-1]
        phases[before] = TURN * (at[before] - begins[0]) / (begins[1] - begins[0])
        phases[after] = known[-1] + TURN * (at[after] - begins[-1]) / (begins[-1] - begins[-2])
    return phases


def _mean_cycle(phases: Array, x: Array) -> Array:
    """Means (STEPS, F) of a path (T, F) over its cycles, at evenly spaced phases."""
    grid = np.arange(STEPS) * TURN / STEPS
    whole = max(int(np.floor((phases[-1] - phases[0]) / TURN + 1e-6)), 1)
    cycles = [interpolated(phases, x, at_phases(grid, phases[0], cycle)) for cycle in range(whole)]
    return np.asarray(np.mean(cycles, axis=0))


def at_phases(grid: Array, first: float, cycle: int) -> Array:
    """Phases of a cycle that are those of a grid but for whole turns.

    Parameters
    ----------
    grid
        (T,), rad
    first
        phase at which the first cycle begins, rad
    cycle
        its number, from 0

    Returns
    -------
    Array
        (T,), rad, from the beginning of the cycle to its end
    """
    return np.asarray(first + TURN * cycle + np.mod(grid - first, TURN))


def _turned(shape: Array, angle: float) -> Array:
    """A mean cycle (STEPS, F) with an angle added to its phase."""
    steps = np.mod(np.arange(STEPS) - angle * STEPS / TURN, STEPS)
    return interpolated(np.arange(STEPS + 1.0), np.vstack([shape, shape[:1]]), steps)


def interpolated(times: Array, x: Array, asked: Array) -> Array:
    """Numbers at times asked for, linear between the samples.

    Parameters
    ----------
    times : Array
        (T,), s or rad, rising
    x : Array
        (T, F), in any units
    asked : Array
        (H,), in the unit of the times

    Returns
    -------
    Array
        (H, F), in the units of x
    """
    return np.stack([np.interp(asked, times, column) for column in x.T], axis=1)
