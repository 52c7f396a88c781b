# SPDX-License-Identifier: Apache-2.0
"""The robot in the scene: its links are put where joint positions say. Also as a ghost, of one colour."""

from __future__ import annotations

from typing import Any

import numpy as np
from viser import SceneApi

from tpgmm_core.common.types import Array
from tpgmm_core.robot.model import RobotModel
from tpgmm_workbench.scene.colors import Color
from tpgmm_workbench.scene.placing import place
from tpgmm_workbench.scene.shapes import Shapes


class RobotDisplay:
    """A robot in viser's scene.

    Parameters
    ----------
    scene
        where it is shown
    robot
        its kinematics
    shapes
        what it looks like
    name
        of its node in the scene
    color
        of a ghost; None: its own colours
    opacity
        of a ghost, 0 to 1
    """

    def __init__(
        self,
        scene: SceneApi,
        robot: RobotModel,
        shapes: Shapes,
        name: str = "/robot",
        color: Color | None = None,
        opacity: float | None = None,
    ) -> None:
        self._data = robot.create_data()
        self._root = scene.add_frame(name, show_axes=False)
        self._links: dict[str, Any] = {}
        for number, part in enumerate(shapes.parts):
            link = part.link
            if not robot.pinocchio.existFrame(link):
                continue
            if link not in self._links:
                self._links[link] = robot.frame_id(link), scene.add_frame(f"{name}/{link}", show_axes=False)
            scene.add_mesh_simple(
                f"{name}/{link}/{number}",
                part.vertices.astype(np.float32),
                part.faces.astype(np.uint32),
                color=part.color if color is None else color,
                opacity=opacity,
                flat_shading=True,
                side="double",
                cast_shadow=False,
                receive_shadow=False,
            )
        self.show(robot.home)

    def show(self, joints: Array) -> None:
        """Show the robot at joint positions (nv,), rad and m."""
        self._data.update(joints)
        for frame_id, node in self._links.values():
            place(node, self._data.frame_pose(frame_id))

    @property
    def visible(self) -> bool:
        """Whether it is shown."""
        return bool(self._root.visible)

    @visible.setter
    def visible(self, visible: bool) -> None:
        if visible != self._root.visible:
            self._root.visible = visible
