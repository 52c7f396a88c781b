# SPDX-License-Identifier: Apache-2.0
"""`RecedingHorizonImpedanceLaw`: the hand's impedance with the gains of a finite horizon, risk-sensitive if wanted.

The future counts already: the hand grows stiff before the Gaussians do, and begins to turn before the corner. Gains and
feedforward are those of the LQR along the reference's horizon (`lqr.receding_horizon`), `plan_rate` times per
second; the reference itself is followed at every step. All else is as in `ImpedanceLaw`.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike

from tpgmm_core.common.types import Array
from tpgmm_core.control.delay_margin import fastest_rate
from tpgmm_core.control.impedance import ImpedanceConfig, ImpedanceLaw
from tpgmm_core.control.planning import PlanConfig, Schedule
from tpgmm_core.control.pose_target import PoseTarget
from tpgmm_core.geometry.gaussian import Gaussian
from tpgmm_core.lqr.receding_horizon import receding_horizon_gains
from tpgmm_core.model.reference import Reference
from tpgmm_core.robot.model import RobotModel


@dataclass(frozen=True, slots=True)
class RecedingHorizonPoseTarget(PoseTarget):
    """A pose and the Gaussians ahead of it, `time_step` s apart, which its gains are to be made from."""

    course: tuple[Gaussian, ...] = ()
    time_step: float = 0.0


class RecedingHorizonImpedanceLaw(ImpedanceLaw):
    """See the module; parameters and terms are those of `ImpedanceLaw`.

    Parameters
    ----------
    robot, endpoint, config, rest_posture
        as for `ImpedanceLaw`
    plan
        parameters of planning
    risk_sensitive
        whether it is; then a reference may come without a horizon, and its Gaussian is used for all times
    """

    def __init__(
        self,
        robot: RobotModel,
        endpoint: str = "left",
        config: ImpedanceConfig | None = None,
        rest_posture: ArrayLike | None = None,
        *,
        plan: PlanConfig | None = None,
        risk_sensitive: bool = False,
    ) -> None:
        self.plan, self.risk_sensitive = plan or PlanConfig(), risk_sensitive
        super().__init__(robot, endpoint, config, rest_posture)
        receding_horizon_gains(np.zeros((3, 6)), np.tile(np.eye(6), (3, 1, 1)), 0.1, 1.0)  # compiles

    def reset(self) -> None:
        """Forget target, posture and plan."""
        super().reset()
        self._schedule = Schedule()
        self._planned: PoseTarget | None = None
        self._push = np.zeros(6)

    def target(self, reference: Reference, moving: bool) -> PoseTarget:
        """Prepare a reference as `ImpedanceLaw.target`, with its horizon.

        Raises
        ------
        ValueError
            also for a reference without a horizon
        """
        here = super().target(reference, moving)
        check_horizon(reference, needed=not self.risk_sensitive)
        course = (reference.gaussian, *reference.horizon) if moving else (reference.gaussian,)
        time_step = reference.horizon_time_step
        return RecedingHorizonPoseTarget(here.reference, here.K_V, rate=here.rate, course=course, time_step=time_step)

    def _take(self, target: PoseTarget | None, pose: Array, dt: float) -> None:
        if isinstance(target, RecedingHorizonPoseTarget):
            target = self._with_gains(target, dt)
        super()._take(target, pose, dt)

    def _with_gains(self, target: RecedingHorizonPoseTarget, dt: float) -> PoseTarget:
        if self._schedule.due(dt, self.plan.plan_rate) or self._planned is None:
            self._schedule.begun()
            self._planned = self._solve(target)
        planned = self._planned
        # the feedforward belongs to the gains, and is blended in with them
        self._push += min(1.0, dt / self.config.gain_time) * (planned.reference.acceleration - self._push)
        return replace(planned, reference=replace(target.reference, acceleration=self._push.copy()))

    def _solve(self, target: RecedingHorizonPoseTarget) -> PoseTarget:
        config, plan = self.config, self.plan
        # coordinates in which turning costs as much as moving
        scale = np.array([1.0, 1.0, 1.0, *[config.characteristic_length] * 3])
        manifold, here = target.course[0].manifold, target.course[0].mean
        gains = receding_horizon_gains(
            scale * np.stack([manifold.log(here, ahead.mean) for ahead in target.course]),
            np.outer(scale, scale) * np.stack([ahead.covariance for ahead in target.course]),
            target.time_step,
            config.control_cost,
            min_stiffness=config.min_stiffness,
            max_stiffness=config.max_stiffness,
            risk_share=plan.risk_share if self.risk_sensitive else 0.0,
            risk_stiffness=plan.risk_stiffness,
        )
        back = np.outer(1.0 / scale, scale)
        inverse = np.linalg.inv(gains.damping)
        reference = replace(target.reference, acceleration=gains.acceleration / scale)
        K_V, ratio = back * gains.damping, back * (inverse @ gains.stiffness @ inverse)
        rate, firmness = (fastest_rate(matrix, config.characteristic_length) for matrix in (K_V, ratio))
        return PoseTarget(reference, K_V, ratio, rate, firmness)


def check_horizon(reference: Reference, needed: bool) -> None:
    """Check the horizon of a reference.

    Raises
    ------
    ValueError
        for one that cannot be planned with, or for none where it is needed
    """
    if not reference.horizon:
        if needed:
            raise ValueError(
                "the reference has no horizon, which the law 'finite_horizon' plans along; set horizon_steps and "
                "horizon_time_step of the reproduction, or take the law 'infinite_horizon'"
            )
        return
    if not 0.0 < reference.horizon_time_step < np.inf:
        raise ValueError(f"the time step of the horizon is {reference.horizon_time_step} s; expected one above 0")
    manifold = reference.gaussian.manifold
    for ahead in reference.horizon:
        if ahead.manifold != manifold:
            raise ValueError(f"the horizon is on '{ahead.manifold}', the reference on '{manifold}'; expected the same")
        if not (np.isfinite(ahead.mean).all() and np.isfinite(ahead.covariance).all()):
            raise ValueError("the horizon of the reference is not finite")
