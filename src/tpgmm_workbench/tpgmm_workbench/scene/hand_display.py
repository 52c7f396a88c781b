# SPDX-License-Identifier: Apache-2.0
"""The hand in the scene: its trail, and a gizmo that leads it where a simulation lets it be led."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable

import numpy as np
from viser import LineSegmentsHandle, SceneApi, TransformControlsEvent

from tpgmm_core.common.types import Array
from tpgmm_workbench.scene.colors import TRAIL
from tpgmm_workbench.scene.heard import in_order
from tpgmm_workbench.scene.placing import place, pose_of

#: Points of the trail, the way between two of them, m.
LONGEST, APART = 250, 0.004


class HandDisplay:
    """The hand.

    Parameters
    ----------
    scene
        where it is shown
    lead
        called with the pose (7,) to which it is dragged, whether the mouse still holds it, and the number of the page;
        None: no gizmo
    """

    def __init__(self, scene: SceneApi, lead: Callable[[Array, bool, int | None], object] | None) -> None:
        self._scene = scene
        self._points: deque[Array] = deque(maxlen=LONGEST)
        self._drawn = 0
        self._count = 0
        self._trail: LineSegmentsHandle | None = None
        self._gizmo = None
        self._holding: set[int | None] = set()
        if lead is not None:
            self._gizmo = scene.add_transform_controls(
                "/gizmos/hand", scale=0.22, line_width=4.0, depth_test=False, visible=False
            )
            self._gizmo.on_update(in_order(self._follow(lead)))

    def _follow(self, lead: Callable[[Array, bool, int | None], object]) -> Callable[[TransformControlsEvent], None]:
        def follow(event: TransformControlsEvent) -> None:
            page = event.client_id
            if event.phase == "start":
                self._holding.add(page)
            if page not in self._holding:  # it was stopped in the middle of it
                return
            if event.phase == "end":
                self._holding.discard(page)
            lead(pose_of(event.target), page in self._holding, page)

        return follow

    def let_go(self) -> None:
        """Nobody drags the gizmo any more, until it is taken hold of again: who did is gone, or was stopped."""
        self._holding.clear()

    def show(self, hand: Array | None, aim: Array | None) -> None:
        """Show the hand.

        Parameters
        ----------
        hand
            (7,) where it is; None where not known
        aim
            (7,) where it is led to; None while nobody leads it
        """
        if hand is None:
            return
        if not self._points or float(np.linalg.norm(hand[:3] - self._points[-1])) > APART:
            self._points.append(np.array(hand[:3]))
            self._count += 1
        if self._gizmo is not None:
            if not self._gizmo.visible:
                self._gizmo.visible = True
            if not self._holding:
                place(self._gizmo, hand if aim is None else aim)

    def draw_trail(self) -> None:
        """Draw the trail, where it is longer than it was."""
        if self._count == self._drawn or len(self._points) < 2:
            return
        self._drawn = self._count
        points = np.array(self._points, dtype=np.float32)
        segments = np.stack([points[:-1], points[1:]], axis=1)
        if self._trail is None:
            self._trail = self._scene.add_line_segments(
                "/trail", segments, TRAIL, thickness=3.0, thickness_units="screen"
            )
        else:
            self._trail.points = segments

    def forget(self) -> None:
        """Begin a new trail."""
        self._points.clear()
