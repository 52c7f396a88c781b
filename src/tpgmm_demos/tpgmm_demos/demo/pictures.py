# SPDX-License-Identifier: Apache-2.0
"""The demo's pictures: the hand's path among the model's Gaussians, the torques, the frames."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import matplotlib

matplotlib.use("Agg")  # headless; must come before pyplot
import matplotlib.pyplot as plt
import numpy as np
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.lines import Line2D
from matplotlib.patches import Ellipse, Patch

from tpgmm_core import GaussianMixture
from tpgmm_core.common.types import Array
from tpgmm_core.geometry import quaternion
from tpgmm_core.observation.tracked import FrameStatus
from tpgmm_demos.demo.recording import RunRecord
from tpgmm_demos.demo.world import World
from tpgmm_demos.scene.pick_place import hand_at

#: Both with y to the left, as the robot sees it: the two share this axis.
_SIDES = {"from above": (1, 0), "from behind the robot": (1, 2)}
#: Around what is drawn, room for names, m; width of the picture and of what is beside the axes, inches.
_MARGIN = 0.025
_WIDTH, _BESIDE = 10.0, 0.9
_AXIS = ("x in m", "y in m", "z in m")
_DISTURBANCE_COLORS = {"object pushed": "#ffd166", "target hidden": "#888888"}
_STATUS_COLORS = {FrameStatus.VISIBLE: "#4daf4a", FrameStatus.HELD: "#ff9f1c", FrameStatus.MISSING: "#d62828"}


def draw(recording: RunRecord, world: World, mixture: GaussianMixture, limits: Array, directory: Path) -> list[Path]:
    """Draw ``path.png``, ``torques.png`` and ``frames.png`` into a directory.

    Parameters
    ----------
    mixture
        the model adapted to the final placing, over [time, x, y, z, qx, qy, qz, qw]
    limits
        (nv,), effort limits of the joints, N m

    Returns
    -------
    list[Path]
        the files
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


def _path(recording: RunRecord, world: World, mixture: GaussianMixture) -> plt.Figure:
    assert world.started_ns is not None
    hand = recording.hand().since(world.started_ns).values
    reference = recording.reference().since(world.started_ns).values
    pushed = world.disturbances.pushed(world.situation.object, np.inf)
    places = [hand_at(world.situation.object), hand_at(pushed), hand_at(world.situation.target)]
    lower, upper = _box([hand, reference, *(_tips(place) for place in places)], mixture)
    heights = [upper[sides[1]] - lower[sides[1]] for sides in _SIDES.values()]
    # one scale for both, and a canvas as large as what is drawn
    inches = (_WIDTH - _BESIDE) / (upper[1] - lower[1])
    figure, axes = plt.subplots(
        2,
        1,
        figsize=(_WIDTH, inches * sum(heights) + 2.4),
        layout="constrained",
        sharex=True,
        gridspec_kw={"height_ratios": heights},
    )
    for ax, (title, sides) in zip(axes, _SIDES.items(), strict=True):
        for mean, covariance in zip(mixture.means, mixture.covariances, strict=True):
            _ellipse(ax, mean[1:4][list(sides)], covariance[1:4, 1:4][np.ix_(sides, sides)])
        ax.plot(*reference[:, sides].T, "--", color="0.35", lw=1.2, label="reference (mean)")
        ax.plot(*hand[:, sides].T, color="#1f4e9c", lw=2, label="hand")
        ax.plot(*hand[0, list(sides)], "o", color="#1f4e9c", ms=6, label="start")
        horizontal, vertical = sides
        # They lie close together: the upper one has its name above, the lower one below.
        falls = bool(places[0][vertical] >= places[1][vertical])
        _axes(ax, places[0], sides, "object at first", above=falls, alpha=0.35)
        _axes(ax, places[1], sides, "object, pushed", above=not falls)
        _axes(ax, places[2], sides, "target", above=False)
        ax.set(title=title, ylabel=_AXIS[vertical], aspect="equal")
        ax.set(xlim=(upper[horizontal], lower[horizontal]), ylim=(lower[vertical], upper[vertical]))
        ax.grid(alpha=0.25)
    axes[-1].set_xlabel(_AXIS[1])
    figure.legend(*axes[0].get_legend_handles_labels(), loc="outside lower center", ncols=3, fontsize=9)
    figure.suptitle("Path of the hand and the model's Gaussians (1 and 2 standard deviations) in this situation")
    return figure


def _box(points: list[Array], mixture: GaussianMixture) -> tuple[Array, Array]:
    """Lower and upper corner (3,) of all that is drawn, with a margin, m."""
    spread = 2.0 * np.sqrt(np.stack([np.diag(covariance)[1:4] for covariance in mixture.covariances]))
    ends = [mixture.means[:, 1:4] - spread, mixture.means[:, 1:4] + spread]
    everything = np.concatenate([values[:, :3] for values in points] + ends)
    return everything.min(axis=0) - _MARGIN, everything.max(axis=0) + _MARGIN


def _tips(place: Array) -> Array:
    """Origin and ends of the axes of a pose as they are drawn (4, 3), m."""
    return np.vstack([place[:3], place[:3] + 0.05 * quaternion.rotation_matrix(place[3:]).T])


def _ellipse(ax: Axes, center: Array, covariance: Array) -> None:
    values, vectors = np.linalg.eigh(covariance)
    angle = np.degrees(np.arctan2(vectors[1, 1], vectors[0, 1]))
    for scale in (1.0, 2.0):
        width, height = 2.0 * scale * np.sqrt(values[::-1])
        ax.add_patch(Ellipse(tuple(center), width, height, angle=angle, color="#e07b39", alpha=0.18, lw=0))


def _axes(ax: Axes, place: Array, sides: tuple[int, int], name: str, above: bool, alpha: float = 1.0) -> None:
    origin, *tips = _tips(place)[:, list(sides)]
    for tip, color in zip(tips, ("#c1121f", "#2a9d3a", "#1d4ed8"), strict=True):
        ax.plot(*np.stack([origin, tip]).T, color=color, lw=2.5, alpha=alpha)
    # beyond the axes, so that the name lies on none of them
    heights = [point[1] for point in (origin, *tips)]
    at = origin[0], max(heights) if above else min(heights)
    style: dict[str, Any] = {"textcoords": "offset points", "fontsize": 9, "alpha": max(alpha, 0.7)}
    style |= {
        "ha": "center",
        "va": "bottom" if above else "top",
        "bbox": {"fc": "white", "lw": 0, "alpha": 0.6, "pad": 1},
    }
    ax.annotate(name, at, xytext=(0, 5 if above else -5), **style)


def _torques(recording: RunRecord, world: World, limits: Array) -> plt.Figure:
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


def _frames(recording: RunRecord, world: World) -> plt.Figure:
    assert world.started_ns is not None
    frames = recording.frames()
    figure, axes = plt.subplots(len(frames), 1, figsize=(10, 1.6 * len(frames) + 1), sharex=True, layout="constrained")
    for ax, (name, series) in zip(np.atleast_1d(axes), frames.items(), strict=True):
        times = series.times(world.started_ns)
        status, confidence = series.values.T
        for value, color in _STATUS_COLORS.items():
            ax.fill_between(times, 0.0, 1.0, where=status == value, color=color, alpha=0.45, step="post")
        ax.plot(times, confidence, color="black", lw=1.2)
        _mark_disturbances(ax, world)
        ax.set(ylabel=name, ylim=(-0.03, 1.08), xlim=(0.0, float(times[-1])))
    handles: list[Artist] = []
    handles += [Patch(color=color, alpha=0.45, label=value.name) for value, color in _STATUS_COLORS.items()]
    handles += [Line2D([], [], color="black", lw=1.2, label="confidence")]
    handles += [Patch(color=color, alpha=0.25, label=label) for label, color in _DISTURBANCE_COLORS.items()]
    figure.legend(handles=handles, loc="outside lower center", ncols=len(handles), fontsize=9)
    np.atleast_1d(axes)[-1].set_xlabel("time in s")
    figure.suptitle("What is known of the frames over time")
    return figure


def _mark_disturbances(ax: Axes, world: World) -> None:
    happened = world.disturbances
    spans = {
        "object pushed": (happened.push_start, happened.push_duration),
        "target hidden": (happened.hide_start, happened.hide_duration),
    }
    for name, (start, duration) in spans.items():
        ax.axvspan(start, start + duration, color=_DISTURBANCE_COLORS[name], alpha=0.25, lw=0)
