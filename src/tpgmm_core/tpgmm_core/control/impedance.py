# SPDX-License-Identifier: Apache-2.0
"""`ImpedanceLaw`: a Gaussian of the hand's pose and the robot's state to torques, as a sum of named terms.

The law makes the hand a double integrator (operational space control) and lets the LQR of the reference's
precision drive it (Section 5): `a = K_P e + K_V (xdot_ref - xdot) + a_ref`, `F = Lambda(q) (a - Jdot v)`,
`tau = J^T F + (null space) + nle`. Where the demonstrations agreed the hand is stiff, elsewhere it yields to a push.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import ArrayLike

from tpgmm_core.common.text import listed, shown
from tpgmm_core.common.types import Array
from tpgmm_core.control.control_law import ControlLaw, DynamicState, Lag, LawTorques
from tpgmm_core.control.delay_margin import borne_share, delay_margin, fastest_rate
from tpgmm_core.control.impedance_config import ImpedanceConfig
from tpgmm_core.control.kernels_impedance import STOP_FREQUENCY, arm_torques, standing_torques
from tpgmm_core.control.kernels_pose import pose_difference, scaled_length
from tpgmm_core.control.pose_governor import PoseGovernor
from tpgmm_core.control.pose_target import PoseReference, PoseTarget
from tpgmm_core.control.receding_gains import RecedingGains
from tpgmm_core.control.torque_limits import finite
from tpgmm_core.lqr.double_integrator import double_integrator_gains
from tpgmm_core.model.reference import Reference
from tpgmm_core.robot.model import RobotModel

POSE_MANIFOLD = "R3 x S3"
#: The terms of which the torque is the sum, in the order of the rows in `ImpedanceLaw.step`.
TERMS = ("feedforward", "feedback", "null_space", "hold", "hand_guiding")


class ImpedanceLaw(ControlLaw[PoseTarget]):
    """Cartesian impedance of one hand; the joints that do not move it hold the posture in which they were found.

    Its terms: "feedforward", gravity and Coriolis torques, also those of the hand's motion; "feedback", the
    impedance of the hand, and the reference's acceleration; "null_space", the posture of the arm, where it does not
    disturb the hand; "hold", the other joints; "hand_guiding", damping of an arm without reference.

    Parameters
    ----------
    robot
        to be controlled
    endpoint
        the hand, a name of the robot file
    config
        parameters
    rest_posture
        (nv,), where the null space draws the arm; None: the robot's home
    ahead
        where gains are those along the reference's horizon, not those of the reference alone

    Raises
    ------
    ValueError
        for an unknown end point or a rest posture that is not (nv,) finite numbers
    """

    def __init__(
        self,
        robot: RobotModel,
        endpoint: str = "left",
        config: ImpedanceConfig | None = None,
        rest_posture: ArrayLike | None = None,
        ahead: RecedingGains[PoseTarget] | None = None,
    ) -> None:
        if endpoint not in robot.endpoints:
            raise ValueError(f"the robot has no end point {shown(endpoint)}; it has {listed(robot.endpoints)}")
        self.robot, self.endpoint, self.ahead = robot, endpoint, ahead
        rest = np.array(robot.home if rest_posture is None else rest_posture, dtype=np.float64)
        if rest.shape != (robot.nv,) or not np.isfinite(rest).all():
            raise ValueError(f"rest_posture must be {robot.nv} finite numbers, got {rest}")
        self._arm = robot.indices(robot.endpoints[endpoint].joints)
        self._others = np.setdiff1d(np.arange(robot.nv), self._arm)
        self._rest = rest[self._arm]
        self._governor = PoseGovernor(ahead)
        self.configure(config or ImpedanceConfig())
        self.reset()
        self._compile()

    def _compile(self) -> None:
        """Make a step towards another pose, so that no later one waits for the compiler."""
        moment = DynamicState.at(self.robot.create_data(), self.robot.home, np.zeros(self.robot.nv))
        for _ in range(2):
            self.step(moment, self.pose_target(PoseReference(moment.data.pose(self.endpoint), np.eye(6))), 0.001)
        self.reset()

    def configure(self, config: ImpedanceConfig) -> None:
        """Use other parameters, also while a reference is followed; gains change with the next target."""
        self.config = self._governor.config = config
        length = config.characteristic_length
        self._control_cost = config.control_cost * np.array([1.0, 1.0, 1.0, *[length**2] * 3])
        self._scale = np.repeat([1.0 / length, 1.0], 3)
        k = config.posture_stiffness + STOP_FREQUENCY**2
        self._null_space_margin = float(delay_margin(k, config.posture_damping))

    def reset(self) -> None:
        """Forget the target and the posture; the next step starts from the state that it is given."""
        self._governor.reset()
        self._posture: Array | None = None

    def target(self, reference: Reference, moving: bool) -> PoseTarget:
        """Prepare a reference: the pose, its gains, and its velocity if it is moving.

        Raises
        ------
        ValueError
            for a reference that is no pose, not finite, whose covariance is not positive definite, or that lacks a
            horizon which is needed
        """
        manifold = str(reference.gaussian.manifold)
        if manifold != POSE_MANIFOLD:
            raise ValueError(f"the reference is on '{manifold}'; expected a pose on '{POSE_MANIFOLD}'")
        twist = reference.velocity() if moving else np.zeros(6)
        target = self.pose_target(PoseReference(reference.gaussian.mean, reference.gaussian.covariance, twist))
        return target if self.ahead is None else replace(target, course=self.ahead.course(reference, moving))

    def pose_target(self, reference: PoseReference) -> PoseTarget:
        """Add the gains of the LQR to a pose.

        Parameters
        ----------
        reference
            pose, velocity and covariance

        Returns
        -------
        PoseTarget
            what `step` takes

        Raises
        ------
        ValueError
            for values that cannot be used
        """
        parts = (reference.pose, reference.covariance.ravel(), reference.twist, reference.acceleration)
        if not finite(np.concatenate(parts)):
            raise ValueError("the reference is not finite")
        length = np.linalg.norm(reference.pose[3:])
        if not length > 1e-6:
            raise ValueError("the quaternion of the reference is zero")
        try:
            gains = double_integrator_gains(
                np.linalg.inv(reference.covariance),
                self._control_cost,
                **self.config.bounds,
            )
        except (np.linalg.LinAlgError, ValueError) as error:
            raise ValueError(f"the covariance of the reference is not positive definite ({error})") from error
        pose = reference.pose.copy()
        pose[3:] /= length
        rate = fastest_rate(gains.damping, self.config.characteristic_length)
        return PoseTarget(replace(reference, pose=pose), gains.damping, rate=rate)

    def step(self, moment: DynamicState, target: PoseTarget | None, dt: float) -> LawTorques:
        """Torques of a state.

        Without a target the last one is released over `blend_time`; what remains is gravity compensation with
        damping. The `reason` is set when the joint velocities are too large to compute with.
        """
        config, nv = self.config, self.robot.nv
        pose, twist = moment.data.pose(self.endpoint), moment.data.twist(self.endpoint)
        governor = self._governor
        governor.step(target, pose, dt, moment.loop.hindered)
        feedforward, feedback, null_space, hold, hand_guiding, given = rows = np.zeros((6, nv))
        error, stiffness, damping, jacobian = np.zeros(6), np.zeros((6, 6)), np.zeros((6, 6)), np.zeros((6, nv))
        weight, followed = governor.weight, governor.target
        if self._posture is None:
            self._posture = moment.q.copy()
        standing_torques(
            self._arm,
            self._others,
            moment.inertia,
            moment.inverse,
            moment.q,
            moment.v,
            self._posture,
            moment.nonlinear,
            config.hold_frequency,
            (1.0 - weight) * config.hand_guiding_damping,
            moment.loop.delay,
            feedforward,
            hold,
            hand_guiding,
            given,
        )
        found, margin, share, asked, lag = 0, np.inf, 1.0, 0.0, None
        if followed is not None:
            goal = followed.reference
            margin = min(followed.delay_margin, self._null_space_margin)
            share = borne_share(margin, moment.loop.delay)
            softness = moment.loop.softness
            asked = float(scaled_length(self._scale, goal.twist))
            if target is not None:
                pose_difference(pose, target.reference.pose, error)
                lag = Lag.of_pose(error)
            jacobian = moment.data.jacobian(self.endpoint)
            found = arm_torques(
                self._arm,
                np.ascontiguousarray(jacobian.T),
                moment.inertia,
                moment.q,
                moment.v,
                self._rest,
                self.robot.lower_limits,
                self.robot.upper_limits,
                moment.data.bias_acceleration(self.endpoint),
                pose,
                twist,
                goal.pose,
                goal.twist,
                softness**2 * goal.acceleration,
                followed.K_V @ followed.ratio @ followed.K_V,
                followed.K_V,
                weight,
                config.characteristic_length,
                config.max_inertia,
                config.max_linear_acceleration,
                config.max_angular_acceleration,
                config.posture_stiffness,
                config.posture_damping,
                min(share, softness),
                self.robot.effort_limits,
                feedforward,
                given,
                feedback,
                null_space,
                error,
                stiffness,
                damping,
            )
        tau = given + feedback + null_space
        unusable = found < 0 or not finite(tau)
        return LawTorques(
            tau=tau,
            terms=dict(zip(TERMS, rows, strict=False)),
            error=error,
            stiffness=stiffness,
            damping=damping,
            jacobian=jacobian,
            blend=governor.blend,
            saturated=found == 1,
            reason="the joint velocities are implausibly large" if unusable else "",
            lag=lag,
            delay_margin=margin,
            share=share,
            moves=float(scaled_length(self._scale, twist)),
            asked=asked,
        )
