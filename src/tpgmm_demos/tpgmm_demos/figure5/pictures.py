# SPDX-License-Identifier: Apache-2.0
"""Pictures of the four sequences: a strip of robot poses, and errors and torques over time with the pushes marked."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

import matplotlib

matplotlib.use("Agg")  # headless; must come before pyplot
import matplotlib.pyplot as plt
import numpy as np
from mpl_toolkits.mplot3d import Axes3D

from tpgmm_core.common.types import Array
from tpgmm_core.geometry import quaternion
from tpgmm_core.robot.model import RobotModel
from tpgmm_demos.figure5.lessons import CUP_AXIS, HANDS
from tpgmm_demos.figure5.measures import measure
from tpgmm_demos.figure5.sequences import AFTER, CUP, HELD, MOVE, SUGAR, SequenceResult

#: Links that are drawn, from the shoulder to between the finger tips.
LINKS = ("upper_shoulder", "lower_shoulder", "upper_elbow", "lower_elbow", "upper_forearm", "wrist", "gripper")
COLORS = {"left": "#1f4e9c", "right": "#e07b39"}
PUSH_COLOR, SUGAR_COLOR = "#2a9d3a", "#c1121f"
#: Moments of the first push that are drawn, s.
MOMENTS = (0.0, 0.6 * MOVE, MOVE + 0.9 * HELD, MOVE + HELD + 0.2, MOVE + HELD + 0.95 * AFTER)
CUP_HEIGHT, CUP_RADIUS = 0.08, 0.035  # m
#: Pushes of each sequence whose errors and torques are drawn.
SHOWN = 6


def draw(robot: RobotModel, courses: Sequence[SequenceResult], directory: Path) -> list[Path]:
    """Draw ``<sequence>_strip.png`` and ``<sequence>_errors.png`` for each sequence.

    Parameters
    ----------
    robot
        that was simulated
    courses
        results of the sequences
    directory
        where to

    Returns
    -------
    list[Path]
        the files
    """
    directory.mkdir(parents=True, exist_ok=True)
    paths = []
    for result in courses:
        for name, figure in (("strip", _strip(robot, result)), ("errors", _errors(robot, result))):
            paths.append(directory / f"{result.sequence.name}_{name}.png")
            figure.savefig(paths[-1], dpi=100)
            plt.close(figure)
    return paths


def _strip(robot: RobotModel, result: SequenceResult) -> plt.Figure:
    """The robot at some moments of the first push; pale where it was before."""
    pushed = result.pushes[0]
    time, q = pushed.segment.time, pushed.segment.q
    data, link = robot.create_data(), robot.frame_id(pushed.link)
    seen = []
    for moment in MOMENTS:
        data.update(q[min(int(np.searchsorted(time, moment)), len(q) - 1)])
        arms = {
            hand: np.stack([data.frame_pose(robot.frame_id(f"{hand}_{name}"))[:3] for name in LINKS]) for hand in HANDS
        }
        seen.append((arms, {hand: data.pose(hand) for hand in HANDS}, data.frame_pose(link)[:3]))
    everything = np.concatenate([points for arms, _, _ in seen for points in arms.values()])
    lower, upper = everything.min(axis=0) - CUP_HEIGHT, everything.max(axis=0) + CUP_HEIGHT
    figure = plt.figure(figsize=(3.0 * len(MOMENTS), 3.2), layout="constrained")
    for n, (moment, (arms, hands, now)) in enumerate(zip(MOMENTS, seen, strict=True)):
        ax = figure.add_subplot(1, len(MOMENTS), n + 1, projection="3d")
        assert isinstance(ax, Axes3D)
        ax.computed_zorder = False  # what is drawn later is in front
        if n > 0:
            _arms(ax, seen[0][0], dict.fromkeys(HANDS, "0.8"), lw=3)
        ax.plot(*np.stack([arms[hand][0] for hand in HANDS]).T, color="0.4", lw=8, solid_capstyle="round")
        _arms(ax, arms, COLORS, lw=5)
        _cup(ax, hands["left"])
        ax.plot(*hands["right"][:3, None], "s", color=SUGAR_COLOR, ms=9, mec="white", zorder=5)
        if np.linalg.norm(now - seen[0][2]) > 0.01:
            ax.plot(*np.stack([seen[0][2], now]).T, color=PUSH_COLOR, lw=3, zorder=4)
            ax.plot(*seen[0][2][:, None], "o", color=PUSH_COLOR, ms=5, zorder=4)
        ax.set(xlim=(lower[0], upper[0]), ylim=(lower[1], upper[1]), zlim=(lower[2], upper[2]))
        ax.set_title(f"{moment:.1f} s", fontsize=12)
        ax.set_box_aspect(upper - lower, zoom=1.4)
        ax.view_init(elev=20, azim=-50)
        ax.set_axis_off()
    figure.suptitle(
        f"{result.sequence.title} (green: how far the pushed link is; red: the sugar; grey: before the push)"
    )
    return figure


def _arms(ax: Axes3D, arms: Mapping[str, Array], colors: Mapping[str, str], lw: float) -> None:
    for hand, points in arms.items():
        ax.plot(*points.T, "-o", color=colors[hand], lw=lw, ms=lw, solid_joinstyle="round")


def _cup(ax: Axes3D, pose: Array) -> None:
    """Wall, rim and bottom of the cup in the left hand."""
    turn = np.linspace(0.0, 2.0 * np.pi, 25)
    across = np.eye(3)[np.argsort(np.abs(CUP_AXIS))[:2]]
    circle = CUP_RADIUS * (np.cos(turn)[:, None] * across[0] + np.sin(turn)[:, None] * across[1])
    R = quaternion.rotation_matrix(pose[3:])
    bottom, rim = (pose[:3] + (circle + 0.5 * end * CUP_HEIGHT * CUP_AXIS) @ R.T for end in (-1.0, 1.0))
    wall = np.stack([bottom, rim])
    ax.plot_surface(wall[..., 0], wall[..., 1], wall[..., 2], color="0.85", shade=False, zorder=3)
    for edge in (bottom, rim):
        ax.plot(*edge.T, color="black", lw=1.5, zorder=4)


def _errors(robot: RobotModel, result: SequenceResult) -> plt.Figure:
    shown = result.pushes[:: max(1, len(result.pushes) // SHOWN)][:SHOWN]
    arms = [robot.indices(robot.endpoints[hand].joints) for hand in HANDS]
    figure, axes = plt.subplots(5, 1, figsize=(11, 11), sharex=True, layout="constrained")
    start = 0.0
    for pushed in shown:
        m, segment = measure(robot, pushed.segment, pushed.link), pushed.segment
        time = start + segment.time
        axes[0].plot(time, 100.0 * m.moved, color=PUSH_COLOR)
        axes[1].plot(time, m.tilt, color="black")
        axes[2].plot(time, 100.0 * m.offset, color=SUGAR_COLOR)
        for ax, arm, hand in zip(axes[3:], arms, HANDS, strict=True):
            ax.plot(time, segment.tau[:, arm] / robot.effort_limits[arm], lw=0.9, color=COLORS[hand], alpha=0.8)
        for ax in axes:
            ax.axvspan(start, start + MOVE + HELD, color="#ffd166", alpha=0.3, lw=0)
        start = float(time[-1])
    axes[0].set_ylabel("pushed link, cm")
    axes[1].set_ylabel("tilt of the cup, deg" + ("" if CUP in result.sequence.tasks else "\n(no task)"))
    axes[2].set_ylabel("sugar from its place, cm" + ("" if SUGAR in result.sequence.tasks else "\n(no task)"))
    for ax, hand in zip(axes[3:], HANDS, strict=True):
        ax.set(ylabel=f"{hand} arm:\nshare of the torque limits", ylim=(-1.05, 1.05))
    for ax in axes:
        ax.grid(alpha=0.25)
    axes[-1].set_xlabel("time in s (yellow: a push)")
    figure.suptitle(result.sequence.title)
    return figure
