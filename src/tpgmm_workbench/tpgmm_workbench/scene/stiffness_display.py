# SPDX-License-Identifier: Apache-2.0
"""How stiff the hand is held, in the scene: an ellipsoid that is long where it is stiff."""

from __future__ import annotations

import numpy as np
from viser import SceneApi

from tpgmm_core.common.types import Array
from tpgmm_core.geometry import quaternion
from tpgmm_workbench.scene.colors import STIFFNESS
from tpgmm_workbench.scene.placing import place, resize
from tpgmm_workbench.session.view import StiffnessView

#: Diameter for 1 N/m, m; the smallest and the largest one that are drawn, m.
PER_STIFFNESS, SMALLEST, LARGEST = 2e-4, 0.01, 0.4


class StiffnessDisplay:
    """The ellipsoid of the hand's stiffness."""

    def __init__(self, scene: SceneApi) -> None:
        self._node = scene.add_icosphere(
            "/stiffness", 0.5, STIFFNESS, subdivisions=2, opacity=0.25, cast_shadow=False, visible=False
        )

    def show(self, hand: Array | None, stiffness: StiffnessView | None) -> None:
        """Show it at the hand (7,); nothing where one of them is not known."""
        if hand is None or stiffness is None:
            if self._node.visible:
                self._node.visible = False
            return
        pose, size = ellipsoid(hand[:3], stiffness)
        place(self._node, pose)
        resize(self._node, size)
        if not self._node.visible:
            self._node.visible = True


def ellipsoid(middle: Array, stiffness: StiffnessView) -> tuple[Array, Array]:
    """The ellipsoid of a stiffness of positions.

    Parameters
    ----------
    middle
        (3,) m
    stiffness
        of the hand

    Returns
    -------
    tuple[Array, Array]
        pose (7,) of its middle and axes, and its diameters (3,), m
    """
    values, directions = stiffness.along
    turn = directions * np.array([np.sign(np.linalg.det(directions)), 1.0, 1.0])
    size = np.clip(PER_STIFFNESS * values, SMALLEST, LARGEST)
    return np.concatenate([middle, quaternion.from_matrix(turn)]), size
