# SPDX-License-Identifier: Apache-2.0
"""`PredictiveLaw`: model predictive control of joints as a law of the controller, for references of poses or joints.

`plan_rate` times per second the problem of `control.predictive` is solved from the present state, along the
reference's horizon, within the limits of torques, velocities and positions. Between two solutions, at every step, the
joints follow the plan: its accelerations, and a feedback around it with the gains of the LQR along the same horizon.

`submit` decides in which thread it is solved. In another thread no step waits for it, and a plan is some steps old when
it is ready: it is followed from where it should be at that time.

Poses become objectives of joints by the present Jacobian; directions that they leave free are drawn to the rest
posture, as weakly as `joint_min_stiffness`.
"""

from __future__ import annotations

from collections.abc import Sequence
from concurrent.futures import Future
from dataclasses import replace

import numpy as np

from tpgmm_core.common.text import listed, shown
from tpgmm_core.common.types import Array
from tpgmm_core.control.control_law import DynamicState, Lag, LawTorques
from tpgmm_core.control.joint_impedance import LEASH, JointImpedanceConfig, JointImpedanceLaw
from tpgmm_core.control.joint_target import JointGains, JointTarget
from tpgmm_core.control.operational_space import bound_twist
from tpgmm_core.control.planning import PlanConfig, Schedule, Submit, at_once
from tpgmm_core.control.pose_governor import ANGULAR_LEASH
from tpgmm_core.control.pose_governor import LEASH as HAND_LEASH
from tpgmm_core.control.predictive import JointLimits, PredictiveController
from tpgmm_core.control.predictive_problem import Planned, PlanProblem, PredictiveTarget, solve
from tpgmm_core.control.receding_gains import GaussiansAhead
from tpgmm_core.geometry.manifold import POSE
from tpgmm_core.model.reference import Reference
from tpgmm_core.robot.model import RobotModel

STEPS = 10
#: Each step of the horizon is longer than the one before: the first is short, as gains are those of constant controls.
GROWTH = 1.2


class PredictiveLaw(JointImpedanceLaw):
    """See the module. Its terms are those of `JointImpedanceLaw`; "feedback" holds the torques of the plan.

    Parameters
    ----------
    robot
        to be controlled
    joints
        as for `JointImpedanceLaw`
    endpoint
        the end point, moved by these joints, whose poses it follows; None: it follows references of the joints
    config
        parameters
    plan
        parameters of planning
    submit
        where plans are made; `at_once` waits for them

    Raises
    ------
    ValueError
        like `JointImpedanceLaw`, and for an unknown end point
    """

    def __init__(
        self,
        robot: RobotModel,
        joints: Sequence[str],
        endpoint: str | None = None,
        config: JointImpedanceConfig | None = None,
        *,
        plan: PlanConfig | None = None,
        submit: Submit[Planned] = at_once,
    ) -> None:
        if endpoint is not None and endpoint not in robot.endpoints:
            raise ValueError(f"the robot has no end point {shown(endpoint)}; it has {listed(robot.endpoints)}")
        self.plan, self.endpoint, self._submit = plan or PlanConfig(), endpoint, submit
        super().__init__(robot, joints, config)

    def _compile(self) -> None:
        home = DynamicState.at(self.robot.create_data(), self.robot.home, np.zeros(self.robot.nv))
        n = len(self._joints)
        mean, size = (self.robot.home[self._joints], n) if self.endpoint is None else (home.data.pose(self.endpoint), 6)
        target = PredictiveTarget(np.tile(mean, (2, 1)), np.tile(np.eye(size), (2, 1, 1)), 0.1)
        self._submit, submit = at_once, self._submit
        self.step(home, target, 0.001)
        self._submit = submit
        self.reset()

    def configure(self, config: JointImpedanceConfig) -> None:
        """Use other parameters, those of `plan` too, also while a reference is followed: from the next plan on."""
        super().configure(config)
        robot, joints = self.robot, self._joints
        masses = np.diag(robot.create_data().mass_matrix(robot.home))[joints]
        growing = GROWTH ** np.arange(STEPS)
        margin = np.minimum(self.plan.plan_margin, 0.25 * (robot.upper_limits - robot.lower_limits))[joints]
        limits = JointLimits(
            torque=robot.effort_limits[joints],
            velocity=np.minimum(robot.velocity_limits[joints], self.plan.plan_speed),
            lower=robot.lower_limits[joints] + margin,
            upper=robot.upper_limits[joints] - margin,
        )
        self._posture_precision = np.diag(config.joint_control_cost * config.joint_min_stiffness**2 * masses)
        self._solver = PredictiveController(
            self.plan.plan_horizon * growing / growing.sum(), limits, control_cost=config.joint_control_cost * masses
        )

    def reset(self) -> None:
        """Reset as `JointImpedanceLaw.reset`; a plan that is being made is discarded."""
        super().reset()
        self._schedule = Schedule()
        self._pending: tuple[Future[Planned], float] | None = None
        self._planned: Planned | None = None
        self._time = self._begun = 0.0
        self._failed, self._share = False, 1.0

    @property
    def latency(self) -> float:
        """Age of the plan that is followed, s: since the state that it was made from."""
        return self._time - self._begun

    def target(self, reference: Reference, moving: bool) -> PredictiveTarget:  # type: ignore[override]
        """Prepare a reference: positions and precisions along the horizon.

        Raises
        ------
        ValueError
            for a reference of another kind, not finite, or without an inverse covariance
        """
        if self.endpoint is None:
            super().target(reference, moving)
        elif reference.gaussian.manifold != POSE:
            raise ValueError(f"the reference is on '{reference.gaussian.manifold}'; expected a pose on '{POSE}'")
        course = GaussiansAhead.of(reference, moving, needed=False)
        means = course.means
        if not np.isfinite(means).all():
            raise ValueError("the reference is not finite")
        try:
            precisions = np.stack([ahead.precision for ahead in course.gaussians])
        except ValueError as error:
            raise ValueError(f"the reference cannot be followed: {error}") from error
        return PredictiveTarget(means, precisions, course.time_step)

    def step(self, moment: DynamicState, target: PredictiveTarget | None, dt: float) -> LawTorques:  # type: ignore[override]
        """Torques of a state: those of the plan; before the first plan is ready, those without a target."""
        self._time += dt
        if target is None:
            self._pending = self._planned = None
            self._schedule = Schedule()
            return super().step(moment, None, dt)
        reference = target
        if moment.loop.hindered:
            target = self._leashed_target(moment, target)
        if self._schedule.due(dt, self.plan.plan_rate) and self._pending is None:
            self._schedule.begun()
            problem, solver, config, rest = self._problem(moment, target), self._solver, self.config, self._rest()
            posture = self._posture_precision
            self._pending = self._submit(lambda: solve(problem, solver, config, rest, posture)), self._time
        if self._pending is not None and self._pending[0].done():
            future, begun = self._pending
            self._pending = None
            self._failed = future.exception() is not None
            if not self._failed:
                self._planned, self._begun = future.result(), begun
        planned = self._planned
        asked = super().step(moment, None if planned is None else self._at(planned, self._time - self._begun), dt)
        self._share = asked.share
        return asked if planned is None else replace(asked, lag=self._lag(moment, reference))

    def _leashed_target(self, moment: DynamicState, target: PredictiveTarget) -> PredictiveTarget:
        """Where the target is now, brought near to the robot."""
        if self.endpoint is None:
            here = moment.q[self._joints]
            mean = here + np.clip(target.means[0] - here, -LEASH, LEASH)
        else:
            here = moment.data.pose(self.endpoint)
            way = POSE.log(here, target.means[0])
            bound_twist(way, HAND_LEASH, ANGULAR_LEASH)
            mean = POSE.exp(here, way)
        return PredictiveTarget(mean[None], target.precisions[:1], target.time_step)

    def _lag(self, moment: DynamicState, target: PredictiveTarget) -> Lag:
        """Lag from the robot to the reference, also while plans begin far from it."""
        if self.endpoint is None:
            return Lag.of_joints(target.means[0] - moment.q[self._joints], self.joint_names)
        return Lag.of_pose(POSE.log(moment.data.pose(self.endpoint), target.means[0]))

    def _wanted(self, target: JointTarget, L: Array, F: Array, dt: float) -> JointGains | None:
        if self._planned is None:
            return self._gains  # letting go
        return None if self._failed else self._planned.gains

    def _carried(self, moment: DynamicState) -> Array:
        return moment.nonlinear  # the plan is one of accelerations: it needs all torques of the robot's dynamics

    def _rest(self) -> Array:
        return self.robot.home[self._joints]

    def _problem(self, moment: DynamicState, target: PredictiveTarget) -> PlanProblem:
        """Copy what a plan needs, since the next step overwrites the state."""
        i = self._joints
        pose = jacobian = None
        if self.endpoint is not None:
            pose = np.array(moment.data.pose(self.endpoint))
            jacobian = np.array(moment.data.jacobian(self.endpoint)[:, i])
        return PlanProblem(
            moment.q[i].copy(),
            moment.v[i].copy(),
            np.array(moment.inertia[np.ix_(i, i)]),
            moment.nonlinear[i].copy(),
            pose,
            jacobian,
            target,
            self._share,
        )

    def _at(self, planned: Planned, age: float) -> JointTarget:
        """The plan at an age (s) since it began; its last position once it is over."""
        steps, plan, n = self._solver.time_steps, planned.plan, len(self._joints)
        ends = np.cumsum(steps)
        k = int(np.searchsorted(ends, age, side="right"))
        if k >= len(steps):
            return JointTarget(plan.positions[-1], np.zeros(n), np.zeros((n, n)))
        q, v = (planned.q, planned.v) if k == 0 else (plan.positions[k - 1], plan.velocities[k - 1])
        t, a = age - (ends[k] - steps[k]), plan.accelerations[k]
        return JointTarget(q + t * v + 0.5 * t**2 * a, v + t * a, np.zeros((n, n)), a)
