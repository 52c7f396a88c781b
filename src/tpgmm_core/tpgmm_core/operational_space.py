# SPDX-License-Identifier: Apache-2.0
"""The hand as a mass in space: bounded motions, and the inertia that the hand feels (Khatib 1987).

Vectors (6,) are linear, then angular, in base axes. A length makes the two comparable: turning by 1 rad
counts as moving by that many metres.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


def bounded_twist(twist: Array, max_linear: float, max_angular: float) -> Array:
    """Motion (6,) with its linear and angular part shortened to at most max_linear and max_angular."""
    linear, angular = float(np.linalg.norm(twist[:3])), float(np.linalg.norm(twist[3:]))
    if linear <= max_linear and angular <= max_angular:
        return twist
    shares = max_linear / max(linear, max_linear), max_angular / max(angular, max_angular)
    return np.concatenate([shares[0] * twist[:3], shares[1] * twist[3:]])


@dataclass(frozen=True, slots=True)
class OperationalSpace:
    """Inertia of the hand, and how its accelerations become torques of the n joints that move it.

    inertia : (6, 6), Lambda = (J M^-1 J^T)^-1
    torques : (n, 6), J^T Lambda: torques that accelerate the hand, and move the null space not at all
    accelerations : (6, n), J M^-1: accelerations of the hand under torques
    """

    inertia: Array
    torques: Array
    accelerations: Array

    @classmethod
    def at(cls, jacobian: Array, joint_inertia: Array, length: float, max_inertia: float) -> OperationalSpace:
        """From the Jacobian J (6, n) and the joint-space inertia M (n, n).

        Near singularities the hand cannot move in some direction and its inertia there grows without bound;
        in no direction it is taken for more than max_inertia (kg), for which turning counts by the length
        (m). Elsewhere it is exact.
        """
        accelerations = np.linalg.solve(joint_inertia, jacobian.T).T
        metric = np.array([1.0, 1.0, 1.0, length, length, length])
        mobility, axes = np.linalg.eigh(accelerations @ jacobian.T * (metric[:, None] * metric))
        axes *= metric[:, None]
        inertia = (axes / np.maximum(mobility, 1.0 / max_inertia)) @ axes.T
        return cls(inertia, jacobian.T @ inertia, accelerations)

    def null_space(self, tau: Array) -> Array:
        """The part of the torques tau (n,) that does not accelerate the hand: (I - J^T Lambda J M^-1) tau."""
        return tau - self.torques @ (self.accelerations @ tau)
