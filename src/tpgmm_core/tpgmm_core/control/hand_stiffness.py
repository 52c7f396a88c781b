# SPDX-License-Identifier: Apache-2.0
"""The learned stiffness for controllers of others: numbers along axes, from the covariance of a pose (Section 5)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from tpgmm_core.common.settings import Settings, setting
from tpgmm_core.common.types import Array
from tpgmm_core.lqr.double_integrator import double_integrator_gains


@dataclass(frozen=True, slots=True, kw_only=True)
class StiffnessConfig(Settings):
    """How stiff a hand is for a covariance: a standard deviation s (m) gives mass / (s sqrt(control_cost)) N/m."""

    control_cost: float = setting(0.02, 1e-6, 1e3, "Cost of acceleration against deviation: larger is softer")
    min_stiffness: float = setting(10.0, 1e-3, 1e4, "Smallest stiffness in any direction, per unit of mass, 1/s^2")
    max_stiffness: float = setting(2500.0, 1e-3, 1e4, "Largest stiffness in any direction, per unit of mass, 1/s^2")
    apparent_mass: float = setting(1.0, 0.01, 100.0, "Mass of the hand, which turns these into stiffnesses in N/m, kg")
    apparent_inertia: float = setting(
        0.1, 1e-4, 10.0, "Inertia of the hand, which turns these into stiffnesses in N m/rad, kg m^2"
    )

    def __post_init__(self) -> None:
        """Raise ValueError for a value out of its range, or bounds out of order."""
        Settings.__post_init__(self)
        if self.min_stiffness > self.max_stiffness:
            raise ValueError(f"min_stiffness {self.min_stiffness} is above max_stiffness {self.max_stiffness}")


def hand_stiffness(covariance: Array, config: StiffnessConfig) -> Array:
    """Stiffness of a hand along the axes of the base and about them, by the LQR of the impedance controller.

    Parameters
    ----------
    covariance
        (6, 6) of a pose, positive definite
    config
        cost, bounds and masses

    Returns
    -------
    Array
        (6,), N/m and N m/rad
    """
    bounds = {"min_stiffness": config.min_stiffness, "max_stiffness": config.max_stiffness}
    gains = double_integrator_gains(np.linalg.inv(covariance), config.control_cost, **bounds)
    mass = np.repeat([config.apparent_mass, config.apparent_inertia], 3)
    stiffness: Array = mass * np.diag(gains.stiffness)
    return stiffness
