# SPDX-License-Identifier: Apache-2.0
"""Pictures of the four sequences: a strip of robot poses, and errors and torques over time with the pushes marked."""

from __future__ import annotations

from collections.abc import Sequence
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
    pushed = result.pushes[0]
    time, q = pushed.segment.time, pushed.segment.q
    figure = plt.figure(figsize=(3.1 * len(MOMENTS), 3.4), layout="constrained")
    data, link = robot.create_data(), robot.frame_id(pushed.link)
    data.update(q[0])
    begin = data.frame_pose(link)[:3]
    for n, moment in enumerate(MOMENTS):
        ax = figure.add_subplot(1, len(MOMENTS), n + 1, projection="3d")
        assert isinstance(ax, Axes3D)
        data.update(q[min(int(np.searchsorted(time, moment)), len(q) - 1)])
        for hand in HANDS:
            points = np.stack([data.frame_pose(robot.frame_id(f"{hand}_{name}"))[:3] for name in LINKS])
            ax.plot(*points.T, "-o", color=COLORS[hand], lw=3, ms=3)
        _cup(ax, data.pose("left"))
        ax.plot(*data.pose("right")[:3, None], "s", color="#c1121f", ms=6)
        now = data.frame_pose(link)[:3]
        if np.linalg.norm(now - begin) > 0.01:
            ax.plot(*np.stack([begin, now]).T, color="#2a9d3a", lw=2)
        ax.set(xlim=(0.1, 1.0), ylim=(-0.5, 0.5), zlim=(-0.15, 0.6), title=f"{moment:.1f} s")
        ax.set_box_aspect((0.9, 1.0, 0.75), zoom=1.5)
        ax.view_init(elev=18, azim=-25)
        ax.set_xticks([]), ax.set_yticks([]), ax.set_zticks([])
    figure.suptitle(f"{result.sequence.title} (green: how far the pushed link is; red: the sugar)", fontsize=11)
    return figure


def _cup(ax: Axes3D, pose: Array) -> None:
    """Rim and bottom of the cup in the left hand."""
    turn = np.linspace(0.0, 2.0 * np.pi, 25)
    across = np.eye(3)[np.argsort(np.abs(CUP_AXIS))[:2]]
    circle = CUP_RADIUS * (np.cos(turn)[:, None] * across[0] + np.sin(turn)[:, None] * across[1])
    R = quaternion.rotation_matrix(pose[3:])
    for height in (-0.5 * CUP_HEIGHT, 0.5 * CUP_HEIGHT):
        ax.plot(*(pose[:3] + (circle + height * CUP_AXIS) @ R.T).T, color="black", lw=1.5)


def _errors(robot: RobotModel, result: SequenceResult) -> plt.Figure:
    shown = result.pushes[:: max(1, len(result.pushes) // SHOWN)][:SHOWN]
    arms = [robot.indices(robot.endpoints[hand].joints) for hand in HANDS]
    figure, axes = plt.subplots(5, 1, figsize=(11, 11), sharex=True, layout="constrained")
    start = 0.0
    for pushed in shown:
        m, segment = measure(robot, pushed.segment, pushed.link), pushed.segment
        time = start + segment.time
        axes[0].plot(time, 100.0 * m.moved, color="#2a9d3a")
        axes[1].plot(time, m.tilt, color="black")
        axes[2].plot(time, 100.0 * m.offset, color="#c1121f")
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
