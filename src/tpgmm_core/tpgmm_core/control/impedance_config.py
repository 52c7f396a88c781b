# SPDX-License-Identifier: Apache-2.0
"""The parameters of `ImpedanceLaw`."""

from __future__ import annotations

from dataclasses import dataclass

from tpgmm_core.common.settings import setting
from tpgmm_core.control.control_law import LawConfig


@dataclass(frozen=True, slots=True, kw_only=True)
class ImpedanceConfig(LawConfig):
    """Parameters of the law.

    The control cost r is the cost of an acceleration of 1 m/s^2, relative to the squared Mahalanobis distance to the
    reference: a standard deviation sigma (m) gives K_P = 1 / (sigma sqrt(r)) in 1/s^2.
    """

    control_cost: float = setting(
        0.02, 1e-6, 1e3, "Cost of acceleration against deviation: larger is softer and smoother"
    )
    characteristic_length: float = setting(
        0.3, 0.01, 10.0, "Length that relates rotations to translations: 1 rad counts as this, m"
    )
    min_stiffness: float = setting(10.0, 1e-3, 1e4, "Smallest stiffness in any direction, per unit of mass, 1/s^2")
    max_stiffness: float = setting(2500.0, 1e-3, 1e4, "Largest stiffness in any direction, per unit of mass, 1/s^2")
    max_linear_speed: float = setting(
        0.4, 1e-3, 5.0, "Largest speed with which the hand approaches a reference that jumps, m/s"
    )
    max_angular_speed: float = setting(
        1.2, 1e-3, 20.0, "Largest angular speed with which the hand approaches a reference that jumps, rad/s"
    )
    max_linear_acceleration: float = setting(
        40.0, 0.1, 1e3, "Largest acceleration in answer to a position error, m/s^2"
    )
    max_angular_acceleration: float = setting(
        120.0, 0.1, 1e4, "Largest angular acceleration in answer to an orientation error, rad/s^2"
    )
    max_inertia: float = setting(
        30.0,
        1.0,
        1e4,
        "Upper bound of the hand's apparent mass, which grows without bound when the arm is stretched, kg",
    )
    posture_stiffness: float = setting(
        4.0, 1e-3, 1e3, "Stiffness towards the rest posture, in motions that do not move the hand (null space), 1/s^2"
    )
    posture_damping: float = setting(4.0, 1e-3, 1e3, "Damping of motions that do not move the hand (null space), 1/s")

    @property
    def bounds(self) -> dict[str, float]:
        """Of the stiffness, as the LQR takes them."""
        return {"min_stiffness": self.min_stiffness, "max_stiffness": self.max_stiffness}

    def __post_init__(self) -> None:
        """Raise ValueError for values out of their range, or bounds out of order."""
        LawConfig.__post_init__(self)
        if self.min_stiffness > self.max_stiffness:
            raise ValueError(f"min_stiffness {self.min_stiffness} is above max_stiffness {self.max_stiffness}")
