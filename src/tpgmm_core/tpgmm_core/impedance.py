# SPDX-License-Identifier: Apache-2.0
"""`ImpedanceController`: a Gaussian of the hand's pose and the robot's state to torques, as a sum of named terms.

The controller makes the hand a double integrator (operational space control) and lets the LQR of the
reference's precision drive it (Section 5): `a = K_P e + K_V (xdot_ref - xdot) + a_ref`, `F = Lambda(q) (a -
Jdot v)`, `tau = J^T F + (null space) + nle`. What the demonstrations did alike is held firmly, the rest gives
way to a push.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import ArrayLike, NDArray

from tpgmm_core.control.lqr import double_integrator_gains
from tpgmm_core.manifold import POSE
from tpgmm_core.operational_space import OperationalSpace, bounded_twist
from tpgmm_core.robot import RobotModel
from tpgmm_core.settings import check_settings, setting
from tpgmm_core.torque_limits import all_finite, clamp, fit, limit_rate

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True, kw_only=True)
class ImpedanceConfig:
    """Parameters of the controller.

    The control cost r is what an acceleration of 1 m/s^2 costs beside the squared Mahalanobis distance to the
    reference: a standard deviation sigma (m) gives K_P = 1 / (sigma sqrt(r)) in 1/s^2.
    """

    control_cost: float = setting(0.02, 1e-6, 1e3, "Cost of an acceleration of 1 m/s^2 against the distance")
    characteristic_length: float = setting(0.3, 0.01, 10.0, "Turning by 1 rad/s^2 costs as moving by this, m/s^2")
    min_stiffness: float = setting(10.0, 1e-3, 1e4, "Smallest eigenvalue of K_P, 1/s^2")
    max_stiffness: float = setting(2500.0, 1e-3, 1e4, "Largest eigenvalue of K_P, 1/s^2")
    gain_time: float = setting(0.05, 1e-3, 5.0, "Time constant with which the gains follow the precision, s")
    max_linear_speed: float = setting(0.4, 1e-3, 5.0, "A reference that leaps is followed at this speed, m/s")
    max_angular_speed: float = setting(1.2, 1e-3, 20.0, "A reference that leaps is followed at this speed, rad/s")
    max_linear_acceleration: float = setting(40.0, 0.1, 1e3, "What an error asks for at most, m/s^2")
    max_angular_acceleration: float = setting(120.0, 0.1, 1e4, "What an error asks for at most, rad/s^2")
    max_inertia: float = setting(100.0, 1.0, 1e4, "What a hand is taken for at most where the arm is stretched, kg")
    posture_stiffness: float = setting(4.0, 1e-3, 1e3, "Stiffness of the null space towards the rest posture, 1/s^2")
    posture_damping: float = setting(4.0, 1e-3, 1e3, "Damping of the null space, 1/s")
    hold_frequency: float = setting(20.0, 0.1, 100.0, "Bandwidth with which the other joints hold still, rad/s")
    leading_damping: float = setting(0.3, 1e-3, 50.0, "Damping of an arm without reference, N m s/rad")
    blend_time: float = setting(0.5, 1e-3, 60.0, "A reference takes hold, and lets go, over this time, s")
    torque_rate: float = setting(30.0, 0.1, 1e3, "Largest change of a torque, effort limits per second, 1/s")
    max_time_step: float = setting(0.02, 1e-3, 1.0, "A longer pause between two steps counts as this long, s")

    def __post_init__(self) -> None:
        """Raises ValueError for values out of their range, or bounds out of order."""
        check_settings(self)
        if self.min_stiffness > self.max_stiffness:
            raise ValueError(f"min_stiffness {self.min_stiffness} is above max_stiffness {self.max_stiffness}")


@dataclass(frozen=True, slots=True)
class PoseReference:
    """Where the hand should be, how surely, and how it moves; all in base axes.

    pose : (7,), x, y, z, qx, qy, qz, qw
    covariance : (6, 6), position (m), then rotation vector about the fixed axes (rad)
    twist, acceleration : (6,), linear then angular; zero if not given

    Raises ValueError for wrong shapes. Values are judged by the controller, which must answer to any of them.
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
class TorqueCommand:
    """Torques (nv,) in N m (N), in model order. Unless limited, tau is the sum of the five terms.

    feedforward : gravity and Coriolis torques, also those of the hand's motion
    feedback : the impedance of the hand, and the reference's acceleration
    null_space : the posture of the arm, as far as the hand does not feel it
    hold : the other joints, holding the posture in which they were found
    leading : damping of an arm without reference
    error : (6,), from the hand to the reference, m and rad about the fixed axes; zero without reference
    stiffness, damping : (6, 6), Lambda K_P and Lambda K_V, what the hand shows to the outside: N/m and N
        m/rad, N s/m and N m s/rad; zero without reference
    blend : 0 (gravity compensation) to 1 (the reference has full hold)
    limited : whether an effort or rate limit took something away
    reason : why the reference or the state was refused; empty when nothing was
    """

    tau: Array
    feedforward: Array
    feedback: Array
    null_space: Array
    hold: Array
    leading: Array
    error: Array
    stiffness: Array
    damping: Array
    blend: float
    limited: bool
    reason: str


@dataclass(frozen=True, slots=True)
class _Target:
    """A reference that was found good, and its K_V (6, 6); K_P = K_V^2 / 2."""

    reference: PoseReference
    K_V: Array


@dataclass(frozen=True, slots=True)
class _Task:
    """Torques (n,) of the arm's joints that the target asks for, and what they are made of."""

    bias: Array
    spring: Array
    damper: Array
    posture: Array
    error: Array
    stiffness: Array
    damping: Array


class ImpedanceController:
    """Cartesian impedance of one hand; the joints that do not move it hold the posture in which they were found."""

    def __init__(
        self,
        robot: RobotModel,
        endpoint: str = "left",
        config: ImpedanceConfig | None = None,
        rest_posture: ArrayLike | None = None,
    ) -> None:
        """rest_posture (nv,): where the null space draws the arm, the robot's home if not given.

        Raises ValueError for an unknown end point or a rest posture that is not (nv,) finite numbers.
        """
        if endpoint not in robot.endpoints:
            raise ValueError(f"the robot has no end point {endpoint!r}; it has {list(robot.endpoints)}")
        self.robot, self.endpoint = robot, endpoint
        rest = np.array(robot.home if rest_posture is None else rest_posture, dtype=np.float64)
        if rest.shape != (robot.nv,) or not np.isfinite(rest).all():
            raise ValueError(f"rest_posture must be {robot.nv} finite numbers, got {rest}")
        self._arm = robot.indices(robot.endpoints[endpoint].joints)
        self._arm_block = np.ix_(self._arm, self._arm)
        self._others = np.setdiff1d(np.arange(robot.nv), self._arm)
        self._rest = rest[self._arm]
        self._data = robot.create_data()
        self.configure(config or ImpedanceConfig())
        self.reset()
        self._compile()

    def _compile(self) -> None:
        """One step with a reference, so that no later one waits for the compiler."""
        self._data.update(self.robot.home)
        here = PoseReference(self._data.pose(self.endpoint), np.eye(6))
        for _ in range(2):
            self.step(self.robot.home, np.zeros(self.robot.nv), here, self.config.max_time_step)
        self.reset()

    def configure(self, config: ImpedanceConfig) -> None:
        """Take other parameters, also while a reference is followed: the gains change over `gain_time`."""
        self.config = config
        length = config.characteristic_length
        self._control_cost = config.control_cost * np.array([1.0, 1.0, 1.0, *[length**2] * 3])
        self._torque_rate = config.torque_rate * self.robot.effort_limits

    def reset(self) -> None:
        """Forget the reference, the posture and the last torque; the next step is gravity compensation."""
        self._target: _Target | None = None
        self._blend = 0.0
        self._posture: Array | None = None
        self._last_q: Array | None = None
        self._last_tau: Array | None = None

    def step(self, q: Array, v: Array, reference: PoseReference | None, dt: float) -> TorqueCommand:
        """Torques for positions q and velocities v (nv,), dt seconds after the last step.

        Without a reference, or with one that cannot be used, the last one is let go over `blend_time`; what
        remains is gravity compensation with damping. A state that is not finite gives gravity compensation at
        the last good state (no torque if there was none). Neither raises; the command says the reason. Raises
        ValueError for arrays of the wrong shape.
        """
        robot, arm = self.robot, self._arm
        q, v = np.asarray(q, dtype=np.float64), np.asarray(v, dtype=np.float64)
        if q.shape != (robot.nv,) or v.shape != (robot.nv,):
            raise ValueError(f"q and v have shapes {q.shape} and {v.shape}, expected ({robot.nv},)")
        # of a NaN or a step backwards nothing is known but that it is no time to act upon
        dt = min(dt, self.config.max_time_step) if dt > 0.0 else 0.0
        if not all_finite(q, v):
            return self._compensate(dt, "the joint state is not finite")
        self._data.update(q, v)
        reason = self._take(reference, dt)
        inertia = self._data.mass_matrix(q)
        command = self._at_rest(self._data.nonlinear_effects(q, v).copy(), reason)
        weight = self._weight()
        command.leading[arm] = -(1.0 - weight) * self.config.leading_damping * v[arm]
        command.hold[self._others] = self._hold(q, v, inertia)
        given = command.feedforward + command.hold + command.leading
        shortened = False
        if self._target is not None:
            task = self._task(self._target, weight, q[arm], v[arm], inertia[self._arm_block])
            command.feedforward[arm] += task.bias
            given[arm] += task.bias
            # what brakes goes first: a pull beyond the motors' strength must not take the damping away
            limits, brakes = robot.effort_limits[arm], task.damper + task.posture
            braking = fit(brakes, given[arm], limits)
            pulling = fit(task.spring, given[arm] + braking * brakes, limits)
            command.feedback[arm] = braking * task.damper + pulling * task.spring
            command.null_space[arm] = braking * task.posture
            shortened = min(braking, pulling) < 1.0
            command = replace(command, error=task.error, stiffness=task.stiffness, damping=task.damping)
        tau = given + command.feedback + command.null_space
        if not all_finite(tau):
            return self._compensate(dt, "the joint velocities are out of all proportion")
        self._last_q = q.copy()
        return self._limited(command, tau, dt, shortened)

    def _weight(self) -> float:
        """How much hold the reference has, 0 to 1, smooth at both ends."""
        return self._blend**2 * (3.0 - 2.0 * self._blend)

    def _take(self, reference: PoseReference | None, dt: float) -> str:
        """Let the reference take hold, or the last one go. Returns why the reference was refused, or ''."""
        target = self._judge(reference) if reference is not None else ""
        change = dt / self.config.blend_time
        if isinstance(target, _Target):
            self._blend = min(1.0, self._blend + change)
            self._target = self._approach(target, dt)
            return ""
        self._blend = max(0.0, self._blend - change)
        if self._blend == 0.0:
            self._target = None
        elif self._target is not None:
            still = replace(self._target.reference, twist=np.zeros(6), acceleration=np.zeros(6))
            self._target = replace(self._target, reference=still)
        return target

    def _approach(self, target: _Target, dt: float) -> _Target:
        """The target as far as it may have come since the last one, or from where the hand is."""
        last, config, reference = self._target, self.config, target.reference
        start = self._data.pose(self.endpoint) if last is None else last.reference.pose
        way = POSE.log(start, reference.pose)
        # it starts slowly: a reference that the arm does not follow yet would be caught up with in a leap
        reach = self._weight() * dt
        step = bounded_twist(way, config.max_linear_speed * reach, config.max_angular_speed * reach)
        twist = bounded_twist(reference.twist, config.max_linear_speed, config.max_angular_speed)
        pose = reference.pose if step is way else POSE.exp(start, step)
        # K_P follows as K_V^2 / 2, which keeps the damping ratio; leaps of the stiffness would feed in energy
        share = min(1.0, dt / config.gain_time)
        K_V = target.K_V if last is None else last.K_V + share * (target.K_V - last.K_V)
        return _Target(replace(reference, pose=pose, twist=twist), K_V)

    def _judge(self, reference: PoseReference) -> _Target | str:
        if not all_finite(reference.pose, reference.covariance, reference.twist, reference.acceleration):
            return "the reference is not finite"
        if not np.linalg.norm(reference.pose[3:]) > 1e-6:
            return "the quaternion of the reference is zero"
        try:
            gains = double_integrator_gains(
                np.linalg.inv(reference.covariance),
                self._control_cost,
                min_stiffness=self.config.min_stiffness,
                max_stiffness=self.config.max_stiffness,
            )
        except (np.linalg.LinAlgError, ValueError) as error:
            return f"the covariance of the reference is not positive definite ({error})"
        return _Target(reference, gains.damping)

    def _task(self, target: _Target, weight: float, q: Array, v: Array, inertia: Array) -> _Task:
        """Torques of the arm, all scaled by the weight; q, v (n,) and inertia (n, n) are of the arm's joints."""
        config, reference, K_V = self.config, target.reference, target.K_V
        jacobian = self._data.jacobian(self.endpoint)[:, self._arm]
        hand = OperationalSpace.at(jacobian, inertia, config.characteristic_length, config.max_inertia)
        to_torque = weight * hand.torques
        error = POSE.log(self._data.pose(self.endpoint), reference.pose)
        K_P = 0.5 * K_V @ K_V
        pull = bounded_twist(
            K_P @ error + reference.acceleration,
            config.max_linear_acceleration,
            config.max_angular_acceleration,
        )
        posture = config.posture_stiffness * (self._rest - q) - config.posture_damping * v
        return _Task(
            bias=-to_torque @ self._data.bias_acceleration(self.endpoint),
            spring=to_torque @ pull,
            damper=to_torque @ (K_V @ (reference.twist - self._data.twist(self.endpoint))),
            posture=weight * hand.null_space(inertia @ posture),
            error=error,
            stiffness=weight * (hand.inertia @ K_P),
            damping=weight * (hand.inertia @ K_V),
        )

    def _hold(self, q: Array, v: Array, inertia: Array) -> Array:
        """Torques of the joints that are not the arm's."""
        if self._posture is None:
            self._posture = q.copy()
        others, omega = self._others, self.config.hold_frequency
        accelerations = omega * (omega * (self._posture[others] - q[others]) - 2.0 * v[others])
        return inertia[others, others] * accelerations

    def _compensate(self, dt: float, reason: str) -> TorqueCommand:
        """Gravity compensation at the last good state, with everything else forgotten."""
        self._target, self._blend, self._posture = None, 0.0, None
        gravity = np.zeros(self.robot.nv) if self._last_q is None else self._data.gravity(self._last_q).copy()
        command = self._at_rest(gravity, reason)
        return self._limited(command, gravity, dt, shortened=False)

    def _at_rest(self, feedforward: Array, reason: str) -> TorqueCommand:
        """A command of nothing but the feedforward (nv,), whose other terms are still to be filled in."""
        feedback, null_space, hold, leading = np.zeros((4, self.robot.nv))
        return TorqueCommand(
            tau=feedforward,
            feedforward=feedforward,
            feedback=feedback,
            null_space=null_space,
            hold=hold,
            leading=leading,
            error=np.zeros(6),
            stiffness=np.zeros((6, 6)),
            damping=np.zeros((6, 6)),
            blend=self._blend,
            limited=False,
            reason=reason,
        )

    def _limited(self, command: TorqueCommand, tau: Array, dt: float, shortened: bool) -> TorqueCommand:
        limited = clamp(tau, self.robot.effort_limits)
        if self._last_tau is not None:
            limited = limit_rate(limited, self._last_tau, self._torque_rate, dt)
        self._last_tau = limited
        return replace(command, tau=limited, limited=shortened or not np.array_equal(limited, tau))
