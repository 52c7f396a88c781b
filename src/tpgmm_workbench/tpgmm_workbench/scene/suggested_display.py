# SPDX-License-Identifier: Apache-2.0
"""Ghosts of the objects: where they should be for the next demonstration."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from viser import SceneApi

from tpgmm_core.common.types import Array
from tpgmm_workbench.scene.colors import SUGGESTED
from tpgmm_workbench.scene.frames_display import BOX
from tpgmm_workbench.scene.placing import place


class SuggestedDisplay:
    """A ghost for each observed frame.

    Parameters
    ----------
    scene
        where they are shown
    frames
        their names
    """

    def __init__(self, scene: SceneApi, frames: Sequence[str]) -> None:
        self._nodes = {}
        for name in frames:
            path = f"/suggested/{name}"
            self._nodes[name] = scene.add_frame(path, axes_length=0.07, axes_radius=0.002, visible=False)
            scene.add_box(f"{path}/box", SUGGESTED, dimensions=BOX, opacity=0.35, cast_shadow=False)
            scene.add_label(f"{path}/label", f"{name}: next here", position=(0.0, 0.0, -0.05))

    def show(self, places: Mapping[str, Array]) -> None:
        """Show ghosts at poses (7,) by name, and no others."""
        for name, node in self._nodes.items():
            if node.visible != (name in places):
                node.visible = name in places
            if name in places:
                place(node, places[name])
