# SPDX-License-Identifier: Apache-2.0
"""`PoseReference`, where the hand is to be; `PoseTarget`, the same with the gains that lead there.

`receding_pose_target`: with the gains of a finite horizon.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import numpy as np

from tpgmm_core.common.types import Array
from tpgmm_core.control.delay_margin import delay_margin, fastest_rate
from tpgmm_core.control.receding_gains import GaussiansAhead, RecedingGains


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
    course
        what gains are to be made from, for laws that look ahead
    """

    reference: PoseReference
    K_V: Array
    ratio: Array = field(default_factory=lambda: 0.5 * np.eye(6))
    rate: float = 0.0
    firmness: float = 0.5
    course: GaussiansAhead | None = None

    @property
    def delay_margin(self) -> float:
        """Delay of the loop (s) below which these gains are stable."""
        return float(delay_margin(self.firmness * self.rate**2, self.rate))


def receding_pose_target(
    reference: PoseReference,
    course: GaussiansAhead,
    ahead: RecedingGains[PoseTarget],
    control_cost: float,
    characteristic_length: float,
    bounds: Mapping[str, float],
) -> PoseTarget:
    """A target with the gains along a course, and with the acceleration that belongs to them.

    Parameters
    ----------
    reference
        where to be
    course
        what comes
    ahead
        what the gains allow for
    control_cost, characteristic_length, bounds
        of the law; bounds of the stiffness as `receding_horizon_gains` takes them

    Returns
    -------
    PoseTarget
        without a course
    """
    # coordinates in which turning costs as moving does
    scale = np.array([1.0, 1.0, 1.0, *[characteristic_length] * 3])
    manifold, here = course.gaussians[0].manifold, course.gaussians[0].mean
    gains = ahead.along(
        scale * np.stack([manifold.log(here, mean) for mean in course.means]),
        np.outer(scale, scale) * course.covariances,
        course.time_step,
        control_cost,
        **bounds,
    )
    back = np.outer(1.0 / scale, scale)
    inverse = np.linalg.inv(gains.damping)
    K_V, ratio = back * gains.damping, back * (inverse @ gains.stiffness @ inverse)
    rate, firmness = (fastest_rate(matrix, characteristic_length) for matrix in (K_V, ratio))
    return PoseTarget(replace(reference, acceleration=gains.acceleration / scale), K_V, ratio, rate, firmness)
