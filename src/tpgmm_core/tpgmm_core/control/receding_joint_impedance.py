# SPDX-License-Identifier: Apache-2.0
"""`RecedingHorizonJointImpedanceLaw`: joint impedance with the gains of a finite horizon, risk-sensitive or not.

As `RecedingHorizonImpedanceLaw`, for a Gaussian over joints: the cost of accelerations is R = r M(q), hence the horizon
is that of a double integrator in the coordinates L^T q of M = L L^T, with the inertia of the present.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from tpgmm_core.common.types import Array
from tpgmm_core.control.joint_impedance import JointGains, JointImpedanceConfig, JointImpedanceLaw, JointTarget
from tpgmm_core.control.planning import PlanConfig, Schedule
from tpgmm_core.control.receding_impedance import check_horizon
from tpgmm_core.lqr.receding_horizon import receding_horizon_gains
from tpgmm_core.model.reference import Reference
from tpgmm_core.robot.model import RobotModel


@dataclass(frozen=True, slots=True)
class RecedingHorizonJointTarget(JointTarget):
    """A reference and its horizon: positions (T, n), covariances (T, n, n), `time_step` s apart; the first is now."""

    course: Array = field(default_factory=lambda: np.zeros((1, 0)))
    covariances: Array = field(default_factory=lambda: np.zeros((1, 0, 0)))
    time_step: float = 0.0


class RecedingHorizonJointImpedanceLaw(JointImpedanceLaw):
    """See the module; parameters and terms are those of `JointImpedanceLaw`.

    Parameters
    ----------
    robot, joints, config
        as for `JointImpedanceLaw`
    plan
        parameters of planning
    risk_sensitive
        whether it is; then a reference may come without a horizon, and its Gaussian is used for all times
    """

    def __init__(
        self,
        robot: RobotModel,
        joints: Sequence[str],
        config: JointImpedanceConfig | None = None,
        *,
        plan: PlanConfig | None = None,
        risk_sensitive: bool = False,
    ) -> None:
        self.plan, self.risk_sensitive = plan or PlanConfig(), risk_sensitive
        super().__init__(robot, joints, config)
        n = len(self.joint_names)
        receding_horizon_gains(np.zeros((3, n)), np.tile(np.eye(n), (3, 1, 1)), 0.1, 1.0)  # compiles

    def reset(self) -> None:
        """Forget target, posture and plan."""
        super().reset()
        self._schedule = Schedule()
        self._planned: JointGains | None = None

    def target(self, reference: Reference, moving: bool) -> JointTarget:
        """Prepare a reference as `JointImpedanceLaw.target`, with its horizon.

        Raises
        ------
        ValueError
            also for a reference without a horizon
        """
        here = super().target(reference, moving)
        check_horizon(reference, needed=not self.risk_sensitive)
        course = (reference.gaussian, *reference.horizon) if moving else (reference.gaussian,)
        positions, covariances = (np.stack([getattr(g, name) for g in course]) for name in ("mean", "covariance"))
        return RecedingHorizonJointTarget(
            here.positions,
            here.velocities,
            here.precision,
            course=positions,
            covariances=covariances,
            time_step=reference.horizon_time_step,
        )

    def _wanted(self, target: JointTarget, L: Array, F: Array, dt: float) -> JointGains | None:
        if not isinstance(target, RecedingHorizonJointTarget):
            return super()._wanted(target, L, F, dt)
        if self._schedule.due(dt, self.plan.plan_rate) or self._planned is None:
            self._schedule.begun()
            self._planned = self._solve(target, L)
        return self._planned

    def _solve(self, target: RecedingHorizonJointTarget, L: Array) -> JointGains:
        risk_share = self.plan.risk_share if self.risk_sensitive else 0.0
        course, covariances, time_step = target.course, target.covariances, target.time_step
        return receding_horizon_joint_gains(
            L, course, covariances, time_step, self.config, risk_share, self.plan.risk_stiffness
        )


def receding_horizon_joint_gains(
    L: Array,
    course: Array,
    covariances: Array,
    time_step: float,
    config: JointImpedanceConfig,
    risk_share: float = 0.0,
    risk_stiffness: float = 1.0,
) -> JointGains:
    """Gains along future positions (T, n) of joints with covariances (T, n, n), and control cost R = r L L^T."""
    gains = receding_horizon_gains(
        (course - course[0]) @ L,
        L.T @ covariances @ L,
        time_step,
        config.joint_control_cost,
        min_stiffness=config.joint_min_stiffness,
        max_stiffness=config.joint_max_stiffness,
        risk_share=risk_share,
        risk_stiffness=risk_stiffness,
    )
    inverse = np.linalg.inv(gains.damping)
    ratio = inverse @ gains.stiffness @ inverse
    rate, firmness = (float(np.linalg.norm(matrix, 2)) for matrix in (gains.damping, ratio))
    return JointGains(L @ gains.damping @ L.T, ratio, gains.acceleration, rate, firmness)
