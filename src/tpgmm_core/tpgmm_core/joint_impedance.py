# SPDX-License-Identifier: Apache-2.0
"""`JointImpedanceLaw`: a Gaussian over joints and the robot's state to torques of these joints.

The infinite-horizon LQR of Section 5, with the reference's precision Q as the cost of positions and R = r M(q) as the
cost of accelerations, M the inertia: a control is as dear as its deviation from free motion, measured as in Gauss's
principle of least constraint. In the coordinates L^T q of M = L L^T this is a double integrator with R = r I, whose
closed form (`control.lqr`) reads, back in joint coordinates,

    tau = K (q_ref - q) - D v + gravity,   D = L (2 S)^(1/2) L^T,   K = D M^-1 D / 2 = L S L^T,   S² = L^-1 Q L^-T / r.

K and D are symmetric, the modes of the robot are damped by 1 / sqrt(2) each, and none disturbs another: what pushes the
robot where no task holds it does not move what a task holds. Coriolis torques are left to the robot, since
without them the rate of the energy v^T M v / 2 + e^T K e / 2 is -v^T D v, as far as K and q_ref stay.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tpgmm_core.control_law import LawConfig, LawTorques, RobotMoment
from tpgmm_core.kernels import cholesky, compiled, invert_lower
from tpgmm_core.kernels_impedance import standing_torques
from tpgmm_core.reference import Reference
from tpgmm_core.robot import RobotModel
from tpgmm_core.settings import setting
from tpgmm_core.torque_limits import finite, fit

Array = NDArray[np.float64]
Indices = NDArray[np.intp]

#: The terms of which the torque is the sum.
TERMS = ("feedforward", "feedback", "hold", "leading")


@dataclass(frozen=True, slots=True, kw_only=True)
class JointImpedanceConfig(LawConfig):
    """Parameters of the law; the eigenvalues of K_P = M^-1 K are squared frequencies."""

    joint_control_cost: float = setting(0.1, 1e-6, 1e3, "Cost of accelerations, r in R = r M, of the joint-space law")
    joint_min_stiffness: float = setting(1.0, 1e-3, 1e4, "Smallest eigenvalue of K_P of the joint-space law, 1/s^2")
    joint_max_stiffness: float = setting(1e4, 1e-3, 1e4, "Largest eigenvalue of K_P of the joint-space law, 1/s^2")

    def __post_init__(self) -> None:
        """Raises ValueError for values out of their range, or bounds out of order."""
        LawConfig.__post_init__(self)
        if self.joint_min_stiffness > self.joint_max_stiffness:
            raise ValueError(
                f"joint_min_stiffness {self.joint_min_stiffness} is above "
                f"joint_max_stiffness {self.joint_max_stiffness}"
            )


@dataclass(frozen=True, slots=True)
class JointTarget:
    """A reference that was found good: positions and velocities (n,), rad and rad/s, and the precision (n, n)."""

    positions: Array
    velocities: Array
    precision: Array


class JointImpedanceLaw:
    """Joint-space impedance of any joints, such as those of both arms; the others hold the posture they were found in.

    Its terms: "feedforward", gravity, and Coriolis torques of joints that hold; "feedback", what the reference asks
    for; "hold", the joints without reference; "leading", damping of the joints that have none at present.
    """

    def __init__(self, robot: RobotModel, joints: Sequence[str], config: JointImpedanceConfig | None = None) -> None:
        """joints : groups of the robot file or joints by name, in the order of the references.

        Raises ValueError for unknown joints, none, and one that is named twice.
        """
        self.robot = robot
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
        """A step, so that no later one waits for the compiler."""
        n = len(self._joints)
        target = JointTarget(self.robot.home[self._joints], np.zeros(n), np.eye(n))
        moment = RobotMoment.at(self.robot.create_data(), self.robot.home, np.zeros(self.robot.nv))
        self.step(moment, target, 0.001)
        self.reset()

    def configure(self, config: JointImpedanceConfig) -> None:
        """Take other parameters, also while a reference is followed."""
        self.config = config

    def reset(self) -> None:
        """Forget the target and the posture; the next step starts from the state that it is given."""
        self._target: JointTarget | None = None
        self._blend = 0.0
        self._damping: Array | None = None
        self._posture: Array | None = None

    def target(self, reference: Reference, moving: bool) -> JointTarget:
        """What the law makes of a reference: positions, velocities if it is moving, and the precision.

        Raises ValueError for a reference that is not over these joints, not finite, or without an inverse covariance.
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
        return JointTarget(np.array(gaussian.mean), velocities, precision)

    def step(self, moment: RobotMoment, target: JointTarget | None, dt: float) -> LawTorques:
        """Torques dt seconds after the last step.

        Without a target the last one is let go over `blend_time`; what remains is gravity compensation with
        damping. The `reason` is given when the state is beyond all proportion.
        """
        config, joints, nv, n = self.config, self._joints, self.robot.nv, len(self._joints)
        change = dt / config.blend_time
        self._blend = min(1.0, max(0.0, self._blend + (change if target is not None else -change)))
        weight = self._blend**2 * (3.0 - 2.0 * self._blend)
        if target is not None or weight == 0.0:
            self._target = target
        feedforward, feedback, hold, leading, given = rows = np.zeros((len(TERMS) + 1, nv))
        if self._posture is None:
            self._posture = moment.q.copy()
        carried = moment.nonlinear.copy()
        carried[joints] = moment.data.gravity(moment.q)[joints]
        standing_torques(
            joints,
            self._others,
            moment.inertia,
            moment.q,
            moment.v,
            self._posture,
            carried,
            config.hold_frequency,
            (1.0 - weight) * config.leading_damping,
            feedforward,
            hold,
            leading,
            given,
        )
        error, stiffness, damping = np.zeros(n), np.zeros((n, n)), np.zeros((n, n))
        found = 0
        if self._target is not None:
            # gains follow through D alone, which keeps every mode's damping ratio; leaps of K would feed in energy
            known = self._damping is not None
            share = min(1.0, dt / config.gain_time) if known else 1.0
            self._damping = self._damping if self._damping is not None else np.zeros((n, n))
            error[:] = self._target.positions - moment.q[joints]
            found = joint_torques(
                joints,
                moment.inertia,
                error,
                self._target.velocities if target is not None else np.zeros(n),
                moment.v,
                self._target.precision,
                config.joint_control_cost,
                config.joint_min_stiffness,
                config.joint_max_stiffness,
                share,
                weight,
                self.robot.effort_limits,
                given,
                self._damping,
                feedback,
                stiffness,
                damping,
            )
        else:
            self._damping = None
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
            shortened=found == 1,
            reason="the joint state is out of all proportion" if unusable else "",
        )


@compiled
def joint_torques(
    joints: Indices,
    M: Array,
    error: Array,
    velocities: Array,
    v: Array,
    precision: Array,
    control_cost: float,
    min_stiffness: float,
    max_stiffness: float,
    share: float,
    weight: float,
    effort_limits: Array,
    given: Array,
    D: Array,
    feedback: Array,
    stiffness: Array,
    damping: Array,
) -> int:
    """Torques (nv,) that the reference of n joints asks for, scaled by the weight (0 to 1).

    joints (n,) : places in the vectors (nv,); M (nv, nv), v (nv,); error, velocities (n,) of the reference
    precision (n, n), symmetric; share : by which the gains go on to those of the precision
    given (nv,) : what the motors give besides; D (n, n), in and out : the damping of the last step
    feedback (nv,), stiffness, damping (n, n), out

    Returns 0, 1 where motors too weak made it shorten something, -1 where the inertia or the precision is beyond
    reckoning.
    """
    n = len(joints)
    M_j, L, F = np.empty((n, n)), np.zeros((n, n)), np.empty((n, n))
    for i in range(n):
        for j in range(n):
            M_j[i, j] = M[joints[i], joints[j]]
    if not cholesky(M_j, n, L):
        return -1
    invert_lower(L, n, F)
    for i in range(n):
        L[i, i] = 1.0 / L[i, i]  # the kernel keeps reciprocals
    S = F @ precision @ F.T
    for i in range(n):
        for j in range(i + 1):
            if not np.isfinite(S[i, j]):
                return -1
            S[i, j] = S[j, i] = 0.5 * (S[i, j] + S[j, i])
    values, vectors = np.linalg.eigh(S)
    for k in range(n):
        frequency = np.sqrt(max(values[k], 0.0) / control_cost)
        # a fourth root, since the product with its own transpose follows
        root = (2.0 * min(max(frequency, min_stiffness), max_stiffness)) ** 0.25
        for i in range(n):
            vectors[i, k] *= root
    modes = L @ vectors
    wanted = modes @ modes.T
    for i in range(n):
        for j in range(n):
            D[i, j] += share * (wanted[i, j] - D[i, j])
    half = F @ D
    K = 0.5 * (half.T @ half)
    pull, brake = K @ error, np.zeros(n)
    sofar, limits = np.empty(n), np.empty(n)
    for i in range(n):
        for j in range(n):
            brake[i] += weight * D[i, j] * (velocities[j] - v[joints[j]])
            stiffness[i, j], damping[i, j] = weight * K[i, j], weight * D[i, j]
        pull[i] *= weight
        sofar[i], limits[i] = given[joints[i]], effort_limits[joints[i]]
        if not (np.isfinite(pull[i]) and np.isfinite(brake[i]) and np.isfinite(sofar[i])):
            return -1
    # what brakes goes first: a pull beyond the motors' strength must not take the damping away
    braking = fit(brake, sofar, limits)
    for i in range(n):
        sofar[i] += braking * brake[i]
    pulling = fit(pull, sofar, limits)
    for i in range(n):
        feedback[joints[i]] = braking * brake[i] + pulling * pull[i]
    return 1 if min(braking, pulling) < 1.0 else 0
