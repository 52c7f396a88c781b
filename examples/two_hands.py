# SPDX-License-Identifier: Apache-2.0
"""The task of figure 6: a planar robot with five joints and two hands, and an object for each hand that moves.

For some of the time both objects cannot be reached. What somebody then shows is made by optimisation: the weights of
both hands' squared errors say whether the left hand has priority, or the right one, or neither. Beside it stands a
controller by hand (null-space projections) that is told the order.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tpgmm_core.common.types import Array
from tpgmm_core.kinematics.chains import PlanarRobot
from tpgmm_core.kinematics.inverse import damped_pseudo_inverse, null_space

HANDS = ("left", "right")
START = np.array([0.0, 1.2, -1.6, -1.2, 1.6])
STEPS, DURATION = 200, 8.0  # samples of a path, and s
SUBSTEPS = 10  # of a controller for each sample of a path: at 250 Hz
THRESHOLD = 0.2  # of the damping, m/rad
TREMOR = 0.01  # m
OUT_OF_REACH = 0.05  # m that the best compromise leaves to one of the objects
SHARE = 0.2  # of each path in which both objects are out of reach, at least


@dataclass(frozen=True, slots=True)
class Movement:
    """Paths of the objects, name of the hand → (T, 2), m, and configurations (T, 5), rad."""

    objects: Mapping[str, Array]
    q: Array


def wandering(rng: np.random.Generator, size: float, frequencies: int) -> Array:
    """A smooth path (T, 2) from zero to zero, m."""
    u = np.linspace(0.0, 1.0, STEPS)
    waves = np.stack([np.sin(np.pi * k * u) / k for k in range(1, frequencies + 1)], axis=1)
    return size * waves @ rng.normal(size=(frequencies, 2))


def any_paths(robot: PlanarRobot, rng: np.random.Generator) -> dict[str, Array]:
    """From the hands outward and back, each within the reach of its hand, but not always both at once."""
    u = np.linspace(0.0, 1.0, STEPS)[:, None]
    out = np.sin(np.pi * np.clip((u - 0.1) / 0.8, 0.0, 1.0)) ** 2
    robot.update(START)
    paths = {}
    for hand, side in (("left", -1.0), ("right", 1.0)):
        radius, angle = rng.uniform(2.4, 2.85), rng.uniform(0.05, 0.35) * np.pi
        angles = angle + rng.uniform(-0.15, 0.15) * np.pi * (2.0 * u - 1.0)
        far = radius * np.hstack([side * np.cos(angles), np.sin(angles)])
        paths[hand] = robot.place(hand) + out * (far - robot.place(hand)) + wandering(rng, 0.05, 3)
    return paths


def object_paths(robot: PlanarRobot, rng: np.random.Generator) -> dict[str, Array]:
    """Paths of the objects that leave a choice between the hands for long enough to show it."""
    while True:
        paths = any_paths(robot, rng)
        if out_of_reach(robot, paths).mean() >= SHARE:
            return paths


def best_compromise(robot: PlanarRobot, q: Array, targets: Mapping[str, Array], weights: Sequence[float]) -> Array:
    """The configuration (5,) with the least weighted squared errors near q, by Levenberg and Marquardt's steps."""
    roots = np.sqrt(np.repeat(weights, 2))

    def residual(q: Array) -> Array:
        robot.update(q)
        return roots * np.concatenate([targets[hand] - robot.place(hand) for hand in HANDS])

    e = residual(q)
    for _ in range(20):
        robot.update(q)
        J = roots[:, None] * np.concatenate([robot.jacobian(hand) for hand in HANDS])
        damping = 1e-3
        while damping < 1e3:
            step = np.linalg.solve(J.T @ J + damping * np.eye(5), J.T @ e)
            ahead = residual(q + step)
            if ahead @ ahead <= e @ e:
                break
            damping *= 4.0
        else:
            return q
        q, e = q + step, ahead
        if np.abs(step).max() < 1e-6:
            break
    return q


def best(robot: PlanarRobot, targets: Mapping[str, Array], weights: Sequence[float]) -> Array:
    """`best_compromise` along paths of the targets, (T, 5)."""
    configurations = [START]
    for t in range(STEPS):
        now = {hand: path[t] for hand, path in targets.items()}
        configurations.append(best_compromise(robot, configurations[-1], now, weights))
    return np.stack(configurations[1:])


def out_of_reach(robot: PlanarRobot, objects: Mapping[str, Array]) -> NDArray[np.bool_]:
    """When both objects cannot be reached at once, (T,)."""
    compromise = Movement(objects, best(robot, objects, (1.0, 1.0)))
    return np.asarray(errors(robot, compromise).max(axis=1) > OUT_OF_REACH)


def demonstration(robot: PlanarRobot, weights: Sequence[float], rng: np.random.Generator) -> Movement:
    """What somebody shows whose hands tremble a little."""
    objects = object_paths(robot, rng)
    targets = {hand: path + wandering(rng, TREMOR, 8) for hand, path in objects.items()}
    return Movement(objects, best(robot, targets, weights))


def by_hand(robot: PlanarRobot, levels: Sequence[tuple[str, ...]], objects: Mapping[str, Array]) -> Movement:
    """Inverse kinematics, level by level in the null space of those above (Siciliano and Slotine 1991)."""
    q, configurations = START, []
    for t in range(STEPS):
        for _ in range(SUBSTEPS):
            robot.update(q)
            step, N, above = np.zeros(5), np.eye(5), np.zeros((0, 5))
            for level in levels:
                J = np.concatenate([robot.jacobian(hand) for hand in level])
                e = np.concatenate([objects[hand][t] - robot.place(hand) for hand in level])
                part = damped_pseudo_inverse(J @ N, THRESHOLD) @ (e - J @ step)
                step = step + part * min(1.0, 0.1 / max(float(np.linalg.norm(part)), 1e-9))  # at most 0.1 rad
                above = np.concatenate([above, J])
                N = null_space(above, THRESHOLD)
            q = q + step
        configurations.append(q)
    return Movement(objects, np.stack(configurations))


def errors(robot: PlanarRobot, movement: Movement) -> Array:
    """Distances (T, 2) of the left and the right hand from their objects, m."""
    result = np.empty((STEPS, 2))
    for t, q in enumerate(movement.q):
        robot.update(q)
        result[t] = [np.linalg.norm(movement.objects[hand][t] - robot.place(hand)) for hand in HANDS]
    return result
