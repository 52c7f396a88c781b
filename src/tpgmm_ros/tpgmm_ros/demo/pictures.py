# SPDX-License-Identifier: Apache-2.0
"""The demo's pictures: the hand's path among the model's Gaussians, the torques, the frames."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import matplotlib

matplotlib.use("Agg")  # headless; must come before pyplot
import matplotlib.pyplot as plt
import numpy as np
from matplotlib.axes import Axes
from matplotlib.patches import Ellipse

from tpgmm_core import GaussianMixture, quaternion
from tpgmm_core.tracking import FrameStatus
from tpgmm_ros.demo.recording import Recording
from tpgmm_ros.demo.world import World
from tpgmm_ros.pick_place import Array, hand_at

_SIDES = {"from above": (0, 1), "from the side": (1, 2)}
_AXIS = ("x in m", "y in m", "z in m")
_STATUS_COLORS = {FrameStatus.VISIBLE: "#4daf4a", FrameStatus.HELD: "#ff9f1c", FrameStatus.MISSING: "#d62828"}


def draw(recording: Recording, world: World, mixture: GaussianMixture, limits: Array, directory: Path) -> list[Path]:
    """Draw ``path.png``, ``torques.png`` and ``frames.png`` into a directory.

    Args:
        mixture: the model adapted to the final placing, over [time, x, y, z, qx, qy, qz, qw].
        limits: (nv,), effort limits of the joints, N m.
    """
    directory.mkdir(parents=True, exist_ok=True)
    figures = {
        "path.png": _path(recording, world, mixture),
        "torques.png": _torques(recording, world, limits),
        "frames.png": _frames(recording, world),
    }
    paths = []
    for name, figure in figures.items():
        paths.append(directory / name)
        figure.savefig(paths[-1], dpi=110)
        plt.close(figure)
    return paths


def _path(recording: Recording, world: World, mixture: GaussianMixture) -> plt.Figure:
    assert world.started_ns is not None
    hand = recording.hand().since(world.started_ns).values
    reference = recording.reference().since(world.started_ns).values
    pushed = world.disturbances.pushed(world.situation.object, np.inf)
    figure, axes = plt.subplots(1, 2, figsize=(13, 6.2), layout="constrained")
    for ax, (title, sides) in zip(axes, _SIDES.items(), strict=True):
        for mean, covariance in zip(mixture.means, mixture.covariances, strict=True):
            _ellipse(ax, mean[1:4][list(sides)], covariance[1:4, 1:4][np.ix_(sides, sides)])
        ax.plot(*reference[:, sides].T, "--", color="0.35", lw=1.2, label="reference (mean)")
        ax.plot(*hand[:, sides].T, color="#1f4e9c", lw=2, label="hand")
        _axes(ax, hand_at(world.situation.object), sides, "object at first", alpha=0.3)
        _axes(ax, hand_at(pushed), sides, "object, pushed")
        _axes(ax, hand_at(world.situation.target), sides, "target")
        ax.plot(*hand[0, list(sides)], "o", color="#1f4e9c", ms=6)
        ax.set(title=title, xlabel=_AXIS[sides[0]], ylabel=_AXIS[sides[1]], aspect="equal")
        ax.margins(0.08)
        ax.grid(alpha=0.25)
    axes[0].legend(loc="best", fontsize=9)
    figure.suptitle("Path of the hand and the model's Gaussians (1 and 2 standard deviations) in this situation")
    return figure


def _ellipse(ax: Axes, center: Array, covariance: Array) -> None:
    values, vectors = np.linalg.eigh(covariance)
    angle = np.degrees(np.arctan2(vectors[1, 1], vectors[0, 1]))
    for scale in (1.0, 2.0):
        width, height = 2.0 * scale * np.sqrt(values[::-1])
        ax.add_patch(Ellipse(tuple(center), width, height, angle=angle, color="#e07b39", alpha=0.18, lw=0))


def _axes(ax: Axes, place: Array, sides: tuple[int, int], name: str, alpha: float = 1.0) -> None:
    turn = quaternion.rotation_matrix(place[3:])
    origin = place[:3][list(sides)]
    for axis, color in zip(turn.T, ("#c1121f", "#2a9d3a", "#1d4ed8"), strict=True):
        ax.plot(*np.stack([origin, origin + 0.05 * axis[list(sides)]]).T, color=color, lw=2.5, alpha=alpha)
    style: dict[str, Any] = {"textcoords": "offset points", "fontsize": 9, "alpha": max(alpha, 0.6)}
    # What is shown faintly lies close to what is shown plainly: one name above, the other below.
    ax.annotate(name, (origin[0], origin[1]), xytext=(6, -12 if alpha == 1.0 else 10), **style)


def _torques(recording: Recording, world: World, limits: Array) -> plt.Figure:
    assert world.started_ns is not None
    torque = recording.torque().since(world.started_ns)
    times = torque.times(world.started_ns)
    moving = [i for i, name in enumerate(recording.joints) if name.startswith("left_")]
    figure, axes = plt.subplots(len(moving), 1, figsize=(10, 11), sharex=True, layout="constrained")
    for ax, index in zip(axes, moving, strict=True):
        ax.plot(times, torque.values[:, index], color="#1f4e9c", lw=0.8)
        for limit in (-limits[index], limits[index]):
            ax.axhline(limit, color="#c1121f", ls="--", lw=1)
        _mark_disturbances(ax, world)
        ax.set_ylabel(f"{recording.joints[index]}\nN m", fontsize=9)
        ax.grid(alpha=0.25)
    axes[-1].set_xlabel("time in s")
    figure.suptitle("Joint torques and their limits (yellow: object pushed, grey: target hidden)")
    return figure


def _frames(recording: Recording, world: World) -> plt.Figure:
    assert world.started_ns is not None
    frames = recording.frames()
    figure, axes = plt.subplots(len(frames), 1, figsize=(10, 1.6 * len(frames) + 1), sharex=True, layout="constrained")
    for ax, (name, series) in zip(np.atleast_1d(axes), frames.items(), strict=True):
        times = series.times(world.started_ns)
        status, confidence = series.values.T
        for value, color in _STATUS_COLORS.items():
            ax.fill_between(
                times, 0.0, 1.0, where=status == value, color=color, alpha=0.45, step="post", label=value.name
            )
        ax.plot(times, confidence, color="black", lw=1.2, label="confidence")
        _mark_disturbances(ax, world)
        ax.set(ylabel=name, ylim=(-0.03, 1.08), xlim=(0.0, float(times[-1])))
    np.atleast_1d(axes)[0].legend(loc="upper right", ncols=4, fontsize=8)
    np.atleast_1d(axes)[-1].set_xlabel("time in s")
    figure.suptitle("What is known of the frames over time")
    return figure


def _mark_disturbances(ax: Axes, world: World) -> None:
    events: Mapping[str, tuple[float, float]] = {
        "#ffd166": (world.disturbances.push_start, world.disturbances.push_duration),
        "#888888": (world.disturbances.hide_start, world.disturbances.hide_duration),
    }
    for color, (start, duration) in events.items():
        ax.axvspan(start, start + duration, color=color, alpha=0.25, lw=0)
