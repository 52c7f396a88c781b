# SPDX-License-Identifier: Apache-2.0
"""Whether what a robot's joints move can be a body: its mass, and its inertia about its centre of mass.

Links of a URDF that are fixed to one another are one body. Published URDFs have links of a few grams with impossible
numbers; only the body as a whole is checked.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
import pinocchio as pin

from tpgmm_core.common.text import listed
from tpgmm_core.common.types import Array

#: Share of the largest one: principal inertias below zero by less than this are rounding.
ROUNDING = 1e-6
#: Share of the sum of the other two: a principal inertia above it by less than this is rounding in the file.
ROUGHLY = 1.05


@dataclass(frozen=True, slots=True)
class Body:
    """The body that moves with a joint, without what the joints behind it move.

    Parameters
    ----------
    joint
        name of the joint
    links
        names of the URDF's links
    mass
        kg
    principal
        (3,) inertias about the axes through the centre of mass, ascending, kg m²
    """

    joint: str
    links: tuple[str, ...]
    mass: float
    principal: Array

    @property
    def is_possible(self) -> bool:
        """Whether no inertia is negative: else no torque could brake the joint, and no motion could be computed."""
        return bool(self.principal[0] >= -ROUNDING * abs(self.principal[2]))

    @property
    def has_the_shape_of_a_body(self) -> bool:
        """Whether the triangle inequality holds: an inertia about one axis is at most the sum of the other two."""
        return bool(self.principal[2] <= ROUGHLY * (self.principal[0] + self.principal[1]))

    @property
    def is_a_point(self) -> bool:
        """Whether it has a mass and no extent."""
        return self.mass > 0.0 and not self.principal.any()

    def __str__(self) -> str:
        numbers = ", ".join(f"{value:.3g}" for value in self.principal)
        return f"what {self.joint} moves ({listed(self.links, 4)}) has the principal inertias {numbers} kg m^2"


def bodies(model: pin.Model) -> Iterator[Body]:
    """The body of each joint, in the model's order."""
    links: dict[int, list[str]] = {}
    for frame in model.frames:
        if frame.type == pin.FrameType.BODY:
            links.setdefault(frame.parentJoint, []).append(frame.name)
    for i in range(1, model.njoints):
        inertia = model.inertias[i]
        principal = np.linalg.eigvalsh(inertia.inertia)
        yield Body(model.names[i], tuple(links.get(i, ())), float(inertia.mass), principal)
