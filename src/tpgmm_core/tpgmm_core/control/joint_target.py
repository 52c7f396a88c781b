# SPDX-License-Identifier: Apache-2.0
"""`JointTarget`, where joints are to be; `JointGains`, the gains that lead there, also along what comes."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np

from tpgmm_core.common.types import Array
from tpgmm_core.control.delay_margin import delay_margin
from tpgmm_core.control.receding_gains import GaussiansAhead
from tpgmm_core.lqr.receding_horizon import RecedingHorizonGains, receding_horizon_gains


@dataclass(frozen=True, slots=True)
class JointTarget:
    """A reference that was checked.

    Parameters
    ----------
    positions, velocities
        (n,), rad and rad/s
    precision
        (n, n), 1/rad^2
    accelerations
        (n,), rad/s^2, of the reference; None: zero
    course
        what gains are to be made from, for laws that look ahead
    """

    positions: Array
    velocities: Array
    precision: Array
    accelerations: Array | None = None
    course: GaussiansAhead | None = None


@dataclass(frozen=True, slots=True)
class JointGains:
    """Gains that lead to a target, in the coordinates L^T q of the inertia M = L L^T.

    Parameters
    ----------
    damping
        (n, n), D in joint coordinates, N m s/rad
    ratio
        (n, n), C of K = D L^-T C L^-1 D; I / 2 for the infinite horizon, which makes the damping ratio 1 / sqrt(2)
    push
        (n,), accelerations of these coordinates in addition to what follows the reference
    rate, firmness
        bounds of the eigenvalues of K_V = L^-1 D L^-T (1/s) and of C, which determine with what delay they are stable
    """

    damping: Array
    ratio: Array
    push: Array
    rate: float
    firmness: float = 0.5

    @property
    def delay_margin(self) -> float:
        """Delay of the loop (s) below which these gains are stable."""
        return float(delay_margin(self.firmness * self.rate**2, self.rate))

    def towards(self, other: JointGains, share: float) -> JointGains:
        """Gains a share (0 to 1) of the way to others. K stays definite, since D and C do."""
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
    """Gains along future positions (T, n) of joints with covariances (T, n, n), and control cost R = r L L^T.

    The horizon is that of a double integrator in the coordinates L^T q of M = L L^T, with the inertia of the present.

    Parameters
    ----------
    L
        (n, n), Cholesky factor of the inertia
    course, covariances
        (T, n) and (T, n, n), `time_step` s apart; the first is now
    time_step
        s
    control_cost, bounds
        of the law; bounds of the stiffness as `receding_horizon_gains` takes them
    along
        `receding_horizon_gains`, or what makes gains in its place

    Returns
    -------
    JointGains
        at the first of the positions
    """
    gains = along((course - course[0]) @ L, L.T @ covariances @ L, time_step, control_cost, **bounds)
    inverse = np.linalg.inv(gains.damping)
    ratio = inverse @ gains.stiffness @ inverse
    rate, firmness = (float(np.linalg.norm(matrix, 2)) for matrix in (gains.damping, ratio))
    return JointGains(L @ gains.damping @ L.T, ratio, gains.acceleration, rate, firmness)
