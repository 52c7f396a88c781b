# SPDX-License-Identifier: Apache-2.0
"""The robot in the scene: its links are put where joint positions say. Also as a ghost, of one colour.

Links that no joint moves against each other are one body: a page is told where each body is, and draws it at once.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from viser import SceneApi

from tpgmm_core.common.types import Array
from tpgmm_core.robot.model import RobotModel
from tpgmm_workbench.scene.colors import Color
from tpgmm_workbench.scene.placing import place
from tpgmm_workbench.scene.shapes import Shape, Shapes


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
        self._bodies: dict[str, Any] = {}
        for number, part in enumerate(joined(shapes, robot, color)):
            path = f"{name}/{part.link}"
            if part.link not in self._bodies:
                self._bodies[part.link] = robot.frame_id(part.link), scene.add_frame(path, show_axes=False)
            scene.add_mesh_simple(
                f"{path}/{number}",
                part.vertices.astype(np.float32),
                part.faces.astype(np.uint32),
                color=part.color,
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
        for frame_id, node in self._bodies.values():
            place(node, self._data.frame_pose(frame_id))

    @property
    def visible(self) -> bool:
        """Whether it is shown."""
        return bool(self._root.visible)

    @visible.setter
    def visible(self, visible: bool) -> None:
        if visible != self._root.visible:
            self._root.visible = visible


def joined(shapes: Shapes, robot: RobotModel, color: Color | None = None) -> tuple[Shape, ...]:
    """What a robot looks like, with as few parts as it can be drawn and moved with.

    Parameters
    ----------
    shapes
        of its links; those that the robot does not have are left out
    robot
        says which links move together
    color
        of all of it; None: parts keep their colours

    Returns
    -------
    tuple[Shape, ...]
        one for each body and colour, in the axes of the body's first link
    """
    model = robot.pinocchio
    first: dict[int, str] = {}
    groups: dict[tuple[str, Color], list[Shape]] = {}
    for part in shapes.parts:
        if not model.existFrame(part.link):
            continue
        frame = model.frames[robot.frame_id(part.link)]
        link = first.setdefault(frame.parentJoint, part.link)
        placed = model.frames[robot.frame_id(link)].placement.actInv(frame.placement)
        vertices = part.vertices @ placed.rotation.T + placed.translation
        own = part.color if color is None else color
        groups.setdefault((link, own), []).append(Shape(link, vertices, part.faces, own))
    return tuple(_one(group) for group in groups.values())


def _one(parts: list[Shape]) -> Shape:
    begins = np.cumsum([0, *(len(part.vertices) for part in parts[:-1])])
    faces = np.concatenate([part.faces + begin for part, begin in zip(parts, begins, strict=True)])
    return Shape(parts[0].link, np.concatenate([part.vertices for part in parts]), faces, parts[0].color)
