# SPDX-License-Identifier: Apache-2.0
"""Task frames in the scene: axes with a name and what is known of them; a gizmo where they may be dragged."""

from __future__ import annotations

from collections.abc import Callable, Collection, Sequence

import numpy as np
from viser import SceneApi, TransformControlsEvent

from tpgmm_core.common.types import Array
from tpgmm_workbench.scene.colors import FRAME
from tpgmm_workbench.scene.heard import in_order
from tpgmm_workbench.scene.placing import place, pose_of
from tpgmm_workbench.session.view import FrameView

#: Edges of the box that stands for an object, m.
BOX = (0.06, 0.06, 0.03)


class FramesDisplay:
    """The frames of a task.

    Parameters
    ----------
    scene
        where they are shown
    frames
        their names
    draggable
        those of them that have a gizmo
    moved
        called with name, pose (7,) and the number of the page, while one is dragged
    """

    def __init__(
        self,
        scene: SceneApi,
        frames: Sequence[str],
        draggable: Collection[str],
        moved: Callable[[str, Array, int | None], object],
    ) -> None:
        self._nodes, self._boxes, self._labels, self._gizmos = {}, {}, {}, {}
        self._dragged: set[str] = set()
        for name in frames:
            path = f"/frames/{name}"
            self._nodes[name] = scene.add_frame(path, axes_length=0.1, axes_radius=0.004, visible=False)
            self._boxes[name] = scene.add_box(f"{path}/box", FRAME["missing"], dimensions=BOX, opacity=0.6)
            self._labels[name] = scene.add_label(f"{path}/label", name, position=(0.0, 0.0, 0.06))
            if name in draggable:
                gizmo = scene.add_transform_controls(f"/gizmos/{name}", scale=0.16, line_width=3.0, visible=False)
                gizmo.on_update(in_order(self._follow(name, moved)))
                self._gizmos[name] = gizmo

    def _follow(
        self, name: str, moved: Callable[[str, Array, int | None], object]
    ) -> Callable[[TransformControlsEvent], None]:
        def follow(event: TransformControlsEvent) -> None:
            if event.phase == "start":
                self._dragged.add(name)
            elif event.phase == "end":
                self._dragged.discard(name)
            moved(name, pose_of(event.target), event.client_id)

        return follow

    def let_go(self) -> None:
        """Nobody drags a gizmo any more: who did is gone, in the middle of it perhaps."""
        self._dragged.clear()

    def show(self, frames: Sequence[FrameView], places: dict[str, Array]) -> None:
        """Show what is known.

        Parameters
        ----------
        frames
            what the tracker says
        places
            where those with a gizmo really are, (7,) by name, seen or not
        """
        for frame in frames:
            node, gizmo = self._nodes.get(frame.name), self._gizmos.get(frame.name)
            if node is None:
                continue
            pose = frame.pose if frame.pose is not None else places.get(frame.name)
            if node.visible != (pose is not None):
                node.visible = pose is not None
            if pose is not None:
                place(node, pose)
            self._mark(frame)
            if gizmo is not None:
                if not gizmo.visible:
                    gizmo.visible = True
                if frame.name in places and frame.name not in self._dragged:
                    place(gizmo, places[frame.name])

    def _mark(self, frame: FrameView) -> None:
        box, label = self._boxes[frame.name], self._labels[frame.name]
        color, text = FRAME[frame.state], f"{frame.name}: {frame.state}"
        if not np.array_equal(np.asarray(box.color), color):
            box.color = color
        if label.text != text:
            label.text = text
