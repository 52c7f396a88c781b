# SPDX-License-Identifier: Apache-2.0
"""A tube of covariance in the scene, drawn anew only where the path or its covariances have changed."""

from __future__ import annotations

import numpy as np
from viser import MeshHandle, SceneApi

from tpgmm_core.common.types import Array
from tpgmm_workbench.scene.colors import Color
from tpgmm_workbench.scene.tube import tube

#: Corners that move by less are not seen, m.
SEEN = 1e-3


class TubeDisplay:
    """One tube.

    Parameters
    ----------
    scene
        where it is shown
    name
        of its node
    color, opacity
        of its surface
    """

    def __init__(self, scene: SceneApi, name: str, color: Color, opacity: float = 0.4) -> None:
        self._scene, self._name, self._color, self._opacity = scene, name, color, opacity
        self._mesh: MeshHandle | None = None

    @property
    def visible(self) -> bool:
        """Whether it is to be seen, where there is one."""
        return self._mesh is not None and self._mesh.visible

    @visible.setter
    def visible(self, visible: bool) -> None:
        if self._mesh is not None and self._mesh.visible != visible:
            self._mesh.visible = visible

    def show(self, path: Array | None, covariances: Array | None) -> bool:
        """Show where a movement would go.

        Parameters
        ----------
        path
            (N, 3) m; None, or a single point: nothing
        covariances
            (N, 3, 3) m^2

        Returns
        -------
        bool
            whether something was sent to the pages
        """
        if path is None or covariances is None or len(path) < 2:
            was_visible, self.visible = self.visible, False
            return was_visible
        vertices, faces = tube(path, covariances)
        corners = vertices.astype(np.float32)
        if self._mesh is not None and self._mesh.vertices.shape == corners.shape:
            was_hidden, is_seen = not self._mesh.visible, np.abs(self._mesh.vertices - corners).max() > SEEN
            if is_seen:
                self._mesh.vertices = corners
            if was_hidden:
                self._mesh.visible = True
            return bool(is_seen or was_hidden)
        if self._mesh is not None:
            self._mesh.remove()
        self._mesh = self._scene.add_mesh_simple(
            self._name,
            corners,
            faces.astype(np.uint32),
            color=self._color,
            opacity=self._opacity,
            side="double",
            cast_shadow=False,
            receive_shadow=False,
        )
        return True
