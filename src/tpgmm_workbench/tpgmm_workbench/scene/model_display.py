# SPDX-License-Identifier: Apache-2.0
"""The skill in the scene: where the hand is to be, now and from now on, the Gaussians, the tube of a whole movement."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from viser import SceneApi

from tpgmm_core.common.types import Array
from tpgmm_core.geometry import quaternion
from tpgmm_workbench.scene.colors import COMPONENT, PREVIEW, REFERENCE
from tpgmm_workbench.scene.placing import place, resize
from tpgmm_workbench.scene.tube_display import TubeDisplay
from tpgmm_workbench.session.view import ComponentView, HorizonView, ReferenceView

#: Ellipsoids are drawn not smaller nor larger than this, m: what is beside them is to be seen.
SMALLEST, LARGEST = 0.003, 0.3
#: Changes of opacity below this are not seen.
OPACITY_SEEN = 0.04


class ModelDisplay:
    """What the model says, in viser's scene.

    Parameters
    ----------
    scene
        where it is shown

    Attributes
    ----------
    preview
        the tube of a whole movement
    """

    def __init__(self, scene: SceneApi) -> None:
        self._scene = scene
        self._reference = scene.add_icosphere(
            "/reference", 0.5, REFERENCE, subdivisions=2, opacity=0.55, cast_shadow=False, visible=False
        )
        self._components: list[Any] = []
        self.preview = TubeDisplay(scene, "/tube", PREVIEW)
        self._ahead = TubeDisplay(scene, "/ahead", REFERENCE, opacity=0.5)
        self._horizon: HorizonView | None = None

    @property
    def has_horizon(self) -> bool:
        """Whether it is shown what the reference is from now on."""
        return self._horizon is not None

    def show(
        self, reference: ReferenceView | None, components: Sequence[ComponentView], horizon: HorizonView | None = None
    ) -> None:
        """Show the reference of now, the model's Gaussians, and what the reference is from now on."""
        if self._reference.visible != (reference is not None):
            self._reference.visible = reference is not None
        if reference is not None:
            pose, size = ellipsoid(reference.pose[:3], reference.covariance[:3, :3])
            place(self._reference, pose)
            resize(self._reference, size)
        self._show_components(components)
        if horizon is not self._horizon:  # it comes less often than it is looked at
            self._horizon = horizon
            self._ahead.show(*((None, None) if horizon is None else (horizon.path, horizon.covariances)))

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
