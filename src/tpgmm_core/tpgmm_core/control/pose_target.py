# SPDX-License-Identifier: Apache-2.0
"""`PoseReference`, where the hand is to be; `PoseTarget`, the same with the gains that lead there."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from tpgmm_core.common.types import Array
from tpgmm_core.control.delay_margin import delay_margin


@dataclass(frozen=True, slots=True)
class PoseReference:
    """Where the hand should be, how accurately, and how it moves; all in base axes.

    Parameters
    ----------
    pose
        (7,), x, y, z, qx, qy, qz, qw
    covariance
        (6, 6), position (m), then rotation vector about the fixed axes (rad)
    twist, acceleration
        (6,), linear then angular; zero if not given

    Raises
    ------
    ValueError
        for wrong shapes; values are checked by `ImpedanceLaw.pose_target`
    """

    pose: Array
    covariance: Array
    twist: Array = field(default_factory=lambda: np.zeros(6))
    acceleration: Array = field(default_factory=lambda: np.zeros(6))

    def __post_init__(self) -> None:
        for name, shape in (("pose", (7,)), ("covariance", (6, 6)), ("twist", (6,)), ("acceleration", (6,))):
            array = np.asarray(getattr(self, name), dtype=np.float64)
            if array.shape != shape:
                raise ValueError(f"{name} of the reference has shape {array.shape}, expected {shape}")
            object.__setattr__(self, name, array)


@dataclass(frozen=True, slots=True)
class PoseTarget:
    """A reference that was checked, and its gains.

    Parameters
    ----------
    reference
        where to be
    K_V
        (6, 6), 1/s
    ratio
        (6, 6), C of K_P = K_V C K_V: I / 2 for the infinite-horizon LQR. Gains that change by way of K_V and C stay
        definite, and keep the damping ratio where C stays
    rate, firmness
        bounds of the eigenvalues of K_V (1/s) and of C, which determine with what delay they are stable
    """

    reference: PoseReference
    K_V: Array
    ratio: Array = field(default_factory=lambda: 0.5 * np.eye(6))
    rate: float = 0.0
    firmness: float = 0.5

    @property
    def delay_margin(self) -> float:
        """Delay of the loop (s) below which these gains are stable."""
        return float(delay_margin(self.firmness * self.rate**2, self.rate))
