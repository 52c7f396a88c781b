# SPDX-License-Identifier: Apache-2.0
"""The skill in the scene: where the hand is to be now, the model's Gaussians, and the tube of a whole movement."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from viser import MeshHandle, SceneApi

from tpgmm_core.common.types import Array
from tpgmm_core.geometry import quaternion
from tpgmm_workbench.scene.colors import COMPONENT, PREVIEW, REFERENCE, Color
from tpgmm_workbench.scene.placing import place, resize
from tpgmm_workbench.scene.tube import tube
from tpgmm_workbench.session.view import ComponentView, ReferenceView

#: Ellipsoids are drawn not smaller nor larger than this, m: what is beside them is to be seen.
SMALLEST, LARGEST = 0.003, 0.3
#: Changes of opacity below this are not seen.
OPACITY_SEEN = 0.04


class ModelDisplay:
    """What the model says, in viser's scene."""

    def __init__(self, scene: SceneApi) -> None:
        self._scene = scene
        self._reference = scene.add_icosphere(
            "/reference", 0.5, REFERENCE, subdivisions=2, opacity=0.55, cast_shadow=False, visible=False
        )
        self._components: list[Any] = []
        self._tube: MeshHandle | None = None

    def show(self, reference: ReferenceView | None, components: Sequence[ComponentView]) -> None:
        """Show the reference of now, and the model's Gaussians."""
        if self._reference.visible != (reference is not None):
            self._reference.visible = reference is not None
        if reference is not None:
            pose, size = ellipsoid(reference.pose[:3], reference.covariance[:3, :3])
            place(self._reference, pose)
            resize(self._reference, size)
        self._show_components(components)

    def _show_components(self, components: Sequence[ComponentView]) -> None:
        while len(self._components) < len(components):
            name = f"/components/{len(self._components)}"
            self._components.append(
                self._scene.add_icosphere(name, 0.5, COMPONENT, subdivisions=2, opacity=0.2, cast_shadow=False)
            )
        for i, node in enumerate(self._components):
            shown = i < len(components)
            if node.visible != shown:
                node.visible = shown
            if not shown:
                continue
            component = components[i]
            place(node, component.pose)
            resize(node, np.clip(component.size, SMALLEST, LARGEST))
            if abs(node.opacity - component.opacity) > OPACITY_SEEN:
                node.opacity = component.opacity

    def show_tube(self, path: Array | None, covariances: Array | None, color: Color = PREVIEW) -> None:
        """Show where a whole movement would go.

        Parameters
        ----------
        path
            (N, 3) m; None: nothing
        covariances
            (N, 3, 3) m^2
        color
            of the tube
        """
        if self._tube is not None:
            self._tube.remove()
            self._tube = None
        if path is None or covariances is None or len(path) < 2:
            return
        vertices, faces = tube(path, covariances)
        self._tube = self._scene.add_mesh_simple(
            "/tube",
            vertices.astype(np.float32),
            faces.astype(np.uint32),
            color=color,
            opacity=0.4,
            side="double",
            cast_shadow=False,
            receive_shadow=False,
        )


def ellipsoid(mean: Array, covariance: Array) -> tuple[Array, Array]:
    """The ellipsoid of two standard deviations.

    Parameters
    ----------
    mean
        (3,) m
    covariance
        (3, 3) m^2

    Returns
    -------
    tuple[Array, Array]
        pose (7,) of its middle and axes, and its diameters (3,), m, from SMALLEST to LARGEST
    """
    values, vectors = np.linalg.eigh(covariance)
    vectors[:, 0] *= np.sign(np.linalg.det(vectors))
    size = np.clip(4.0 * np.sqrt(np.maximum(values, 0.0)), SMALLEST, LARGEST)
    return np.concatenate([mean, quaternion.from_matrix(vectors)]), size
