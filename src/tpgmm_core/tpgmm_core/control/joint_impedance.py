# SPDX-License-Identifier: Apache-2.0
"""`JointImpedanceLaw`: a Gaussian over joints and the robot's state to torques of these joints.

The infinite-horizon LQR of Section 5, with the reference's precision Q as the cost of positions and R = r M(q) as the
cost of accelerations, M the inertia: a control costs as much as its deviation from free motion, measured as in Gauss's
principle of least constraint. In the coordinates L^T q of M = L L^T this is a double integrator with R = r I, whose
closed form (`tpgmm_core.lqr`) reads, back in joint coordinates,

    tau = K (q_ref - q) - D v + gravity,   D = L (2 S)^(1/2) L^T,   K = D M^-1 D / 2 = L S L^T,   S² = L^-1 Q L^-T / r.

K and D are symmetric, each mode of the robot has the damping ratio 1 / sqrt(2), and none disturbs another: a push on
the robot where no task holds it does not move what a task holds. Coriolis torques are not compensated, since
without that the rate of the energy v^T M v / 2 + e^T K e / 2 is -v^T D v, as long as K and q_ref stay.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from tpgmm_core.common.blending import smoothstep
from tpgmm_core.common.settings import setting
from tpgmm_core.common.types import Array
from tpgmm_core.control.control_law import ControlLaw, DynamicState, Lag, LawConfig, LawTorques
from tpgmm_core.control.delay_margin import borne_share
from tpgmm_core.control.joint_target import JointGains, JointTarget, receding_joint_gains
from tpgmm_core.control.kernels_impedance import standing_torques
from tpgmm_core.control.kernels_joint import inertia_factor, joint_torques, precision_damping
from tpgmm_core.control.receding_gains import RecedingGains
from tpgmm_core.control.torque_limits import finite
from tpgmm_core.model.reference import Reference
from tpgmm_core.robot.model import RobotModel

#: The terms of which the torque is the sum.
TERMS = ("feedforward", "feedback", "hold", "hand_guiding")
#: The reference of hindered joints is no farther away than this (rad or m), to which it comes back at that speed (1/s).
LEASH, LEASH_SPEED = 0.1, 0.5


@dataclass(frozen=True, slots=True, kw_only=True)
class JointImpedanceConfig(LawConfig):
    """Parameters of the law; the eigenvalues of K_P = M^-1 K are squared frequencies."""

    joint_control_cost: float = setting(
        0.2, 1e-6, 1e3, "Cost of acceleration for references over joints: larger is softer (r in R = r M)"
    )
    joint_min_stiffness: float = setting(
        1.0, 1e-3, 1e4, "Smallest stiffness for references over joints, per unit of inertia, 1/s^2"
    )
    joint_max_stiffness: float = setting(
        1e4, 1e-3, 1e4, "Largest stiffness for references over joints, per unit of inertia, 1/s^2"
    )

    @property
    def bounds(self) -> dict[str, float]:
        """Of the stiffness, as the LQR takes them."""
        return {"min_stiffness": self.joint_min_stiffness, "max_stiffness": self.joint_max_stiffness}

    def __post_init__(self) -> None:
        """Raise ValueError for values out of their range, or bounds out of order."""
        LawConfig.__post_init__(self)
        if self.joint_min_stiffness > self.joint_max_stiffness:
            raise ValueError(
                f"joint_min_stiffness {self.joint_min_stiffness} is above "
                f"joint_max_stiffness {self.joint_max_stiffness}"
            )


class JointImpedanceLaw(ControlLaw[JointTarget]):
    """Joint-space impedance of any joints, such as those of both arms; the others hold the posture they were found in.

    Its terms: "feedforward", gravity, and Coriolis torques of joints that hold; "feedback", the impedance towards the
    reference; "hold", the joints that no reference is about; "hand_guiding", damping of the joints without one at
    present.

    Parameters
    ----------
    robot
        to be controlled
    joints
        groups of the robot file or joints by name, in the order of the references
    config
        parameters
    ahead
        where gains are those along the reference's horizon, not those of the reference alone

    Raises
    ------
    ValueError
        for unknown joints, none, and one that is named twice
    """

    def __init__(
        self,
        robot: RobotModel,
        joints: Sequence[str],
        config: JointImpedanceConfig | None = None,
        ahead: RecedingGains[JointGains] | None = None,
    ) -> None:
        self.robot, self.ahead = robot, ahead
        self._joints = np.concatenate([robot.indices(group) for group in joints]) if joints else np.zeros(0, np.intp)
        if len(np.unique(self._joints)) != len(self._joints) or not len(self._joints):
            raise ValueError(f"the law moves one or more joints, each named once; got {list(joints)}")
        self.joint_names = tuple(robot.joint_names[i] for i in self._joints)
        self._selection = np.eye(robot.nv)[self._joints]
        self._others = np.setdiff1d(np.arange(robot.nv), self._joints)
        self.configure(config or JointImpedanceConfig())
        self.reset()
        self._compile()

    def _compile(self) -> None:
        """Make a step, so that no later one waits for the compiler."""
        n = len(self._joints)
        target = JointTarget(self.robot.home[self._joints], np.zeros(n), np.eye(n))
        moment = DynamicState.at(self.robot.create_data(), self.robot.home, np.zeros(self.robot.nv))
        self.step(moment, target, 0.001)
        self.reset()

    def configure(self, config: JointImpedanceConfig) -> None:
        """Use other parameters, also while a reference is followed."""
        self.config = config

    def reset(self) -> None:
        """Forget the target and the posture; the next step starts from the state that it is given."""
        self._target: JointTarget | None = None
        self._blend = 0.0
        self._gains: JointGains | None = None
        self._leash = np.inf
        self._posture: Array | None = None
        if self.ahead is not None:
            self.ahead.reset()

    def target(self, reference: Reference, moving: bool) -> JointTarget:
        """Prepare a reference: positions, velocities if it is moving, and the precision.

        Raises
        ------
        ValueError
            for a reference that is not over these joints, not finite, or without an inverse covariance
        """
        gaussian, n = reference.gaussian, len(self._joints)
        if not gaussian.manifold.is_euclidean or gaussian.manifold.dim != n:
            raise ValueError(f"the reference is on '{gaussian.manifold}'; expected positions of {n} joints")
        if reference.dimensions and reference.dimensions != self.joint_names:
            raise ValueError(f"the reference is over {reference.dimensions}; expected {self.joint_names}")
        velocities = reference.velocity() if moving else np.zeros(n)
        if not np.isfinite(velocities).all():
            raise ValueError("the reference is not finite")
        try:
            precision = gaussian.precision
        except ValueError as error:
            raise ValueError(f"the reference cannot be followed: {error}") from error
        course = None if self.ahead is None else self.ahead.course(reference, moving)
        return JointTarget(np.array(gaussian.mean), velocities, precision, course=course)

    def step(self, moment: DynamicState, target: JointTarget | None, dt: float) -> LawTorques:
        """Torques of a state.

        Without a target the last one is released over `blend_time`; what remains is gravity compensation with
        damping. The `reason` is set when the joint velocities are too large to compute with.
        """
        config, joints, nv, n = self.config, self._joints, self.robot.nv, len(self._joints)
        change = dt / config.blend_time
        self._blend = min(1.0, max(0.0, self._blend + (change if target is not None else -change)))
        weight = smoothstep(self._blend)
        if target is not None or weight == 0.0:
            self._target = target
        feedforward, feedback, hold, hand_guiding, given = rows = np.zeros((len(TERMS) + 1, nv))
        if self._posture is None:
            self._posture = moment.q.copy()
        standing_torques(
            joints,
            self._others,
            moment.inertia,
            moment.inverse,
            moment.q,
            moment.v,
            self._posture,
            self._carried(moment),
            config.hold_frequency,
            (1.0 - weight) * config.hand_guiding_damping,
            moment.loop.delay,
            feedforward,
            hold,
            hand_guiding,
            given,
        )
        error, stiffness, damping = np.zeros(n), np.zeros((n, n)), np.zeros((n, n))
        found, margin, share, lag = 0, np.inf, 1.0, None
        if self._target is not None:
            L, F = np.zeros((n, n)), np.zeros((n, n))
            wanted = self._wanted(self._target, L, F, dt) if inertia_factor(joints, moment.inertia, L, F) else None
            if wanted is not None:
                # jumps of K would add energy
                last = wanted if self._gains is None else self._gains
                self._gains = last.towards(wanted, min(1.0, dt / config.gain_time))
                margin = self._gains.delay_margin
                share = borne_share(margin, moment.loop.delay)
                behind = self._target.positions - moment.q[joints]
                error[:] = self._leashed(behind, moment.loop.hindered, dt)
                lag = None if target is None else Lag.of_joints(behind, self.joint_names)
                push = self._gains.push.copy()
                if self._target.accelerations is not None:
                    push += L.T @ self._target.accelerations
                softness = moment.loop.softness
                found = joint_torques(
                    joints,
                    L,
                    F,
                    error,
                    self._target.velocities if target is not None else np.zeros(n),
                    moment.v,
                    self._gains.damping,
                    self._gains.ratio,
                    softness**2 * push if target is not None else np.zeros(n),
                    weight,
                    min(share, softness),
                    self.robot.effort_limits,
                    given,
                    feedback,
                    stiffness,
                    damping,
                )
            else:
                found = -1
        else:
            self._gains = None
        tau = given + feedback
        unusable = found < 0 or not finite(tau)
        return LawTorques(
            tau=tau,
            terms=dict(zip(TERMS, rows, strict=False)),
            error=error,
            stiffness=stiffness,
            damping=damping,
            jacobian=self._selection,
            blend=self._blend,
            saturated=found == 1,
            reason="the joint state is implausibly large" if unusable else "",
            lag=lag,
            delay_margin=margin,
            share=share,
            moves=float(np.abs(moment.v[joints]).max()),
            asked=0.0 if target is None else float(np.abs(target.velocities).max()),
        )

    def _leashed(self, behind: Array, hindered: bool, dt: float) -> Array:
        """The error (n,) that the joints are pulled by, without a jump: shorter than the lag of hindered joints."""
        furthest = float(np.abs(behind).max())
        if hindered:
            self._leash = max(LEASH, min(self._leash, furthest) - LEASH_SPEED * dt)
        elif self._leash < np.inf:
            self._leash += LEASH_SPEED * dt
            if self._leash >= furthest:
                self._leash = np.inf
        return behind if self._leash == np.inf else np.clip(behind, -self._leash, self._leash)

    def _carried(self, moment: DynamicState) -> Array:
        """Torques (nv,) that do not depend on the error."""
        carried = moment.nonlinear.copy()
        carried[self._joints] = moment.data.gravity(moment.q)[self._joints]
        return carried

    def _wanted(self, target: JointTarget, L: Array, F: Array, dt: float) -> JointGains | None:
        """The gains of a target, L and F = L^-1 (n, n) of the inertia; None where they cannot be computed."""
        config, n, ahead, course = self.config, len(L), self.ahead, target.course
        if ahead is not None and course is not None:
            where = course.means, course.covariances, course.time_step
            cost, bounds = config.joint_control_cost, config.bounds
            return ahead.at_present(dt, lambda: receding_joint_gains(L, *where, cost, bounds, ahead.along))
        damping = np.empty((n, n))
        cost, lowest, highest = config.joint_control_cost, config.joint_min_stiffness, config.joint_max_stiffness
        rate = precision_damping(L, F, target.precision, cost, lowest, highest, damping)
        return None if rate < 0.0 else JointGains(damping, 0.5 * np.eye(n), np.zeros(n), rate)
