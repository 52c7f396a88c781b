# SPDX-License-Identifier: Apache-2.0
"""`JointTarget`, what joints are asked for; `JointGains`, what leads there, also along what comes."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np

from tpgmm_core.common.types import Array
from tpgmm_core.control.delay_margin import delay_margin
from tpgmm_core.control.receding_gains import Course
from tpgmm_core.lqr.receding_horizon import RecedingHorizonGains, receding_horizon_gains


@dataclass(frozen=True, slots=True)
class JointTarget:
    """A reference that was found good: positions and velocities (n,), rad and rad/s, and the precision (n, n).

    accelerations : (n,), rad/s^2, that the reference has; None for none
    course : what gains are to be made from, for laws that look ahead
    """

    positions: Array
    velocities: Array
    precision: Array
    accelerations: Array | None = None
    course: Course | None = None


@dataclass(frozen=True, slots=True)
class JointGains:
    """What leads to a target, from where gains have got to. In the coordinates L^T q of the inertia M = L L^T:

    damping : (n, n), D in joint coordinates, N m s/rad
    ratio : (n, n), C of K = D L^-T C L^-1 D; I / 2 for the infinite horizon, which makes the damping ratio 1 / sqrt(2)
    push : (n,), accelerations of these coordinates beside what follows the reference
    rate, firmness : bounds of the eigenvalues of K_V = L^-1 D L^-T (1/s) and of C, which say what delay they bear
    """

    damping: Array
    ratio: Array
    push: Array
    rate: float
    firmness: float = 0.5

    @property
    def delay_margin(self) -> float:
        """Delay of the loop (s) that these gains bear."""
        return float(delay_margin(self.firmness * self.rate**2, self.rate))

    def towards(self, other: JointGains, share: float) -> JointGains:
        """A share (0 to 1) of the way to others. K stays definite, since D and C do."""
        return JointGains(
            self.damping + share * (other.damping - self.damping),
            self.ratio + share * (other.ratio - self.ratio),
            self.push + share * (other.push - self.push),
            self.rate + share * (other.rate - self.rate),
            self.firmness + share * (other.firmness - self.firmness),
        )


def receding_joint_gains(
    L: Array,
    course: Array,
    covariances: Array,
    time_step: float,
    control_cost: float,
    bounds: Mapping[str, float],
    along: Callable[..., RecedingHorizonGains] = receding_horizon_gains,
) -> JointGains:
    """Gains along a course of joints (T, n) with its covariances (T, n, n), and R = r L L^T as the control cost.

    The horizon is that of a double integrator in the coordinates L^T q of M = L L^T, with the inertia of the present.

    bounds : of the stiffness, see `receding_horizon_gains`
    """
    gains = along((course - course[0]) @ L, L.T @ covariances @ L, time_step, control_cost, **bounds)
    inverse = np.linalg.inv(gains.damping)
    ratio = inverse @ gains.stiffness @ inverse
    rate, firmness = (float(np.linalg.norm(matrix, 2)) for matrix in (gains.damping, ratio))
    return JointGains(L @ gains.damping @ L.T, ratio, gains.acceleration, rate, firmness)
