# SPDX-License-Identifier: Apache-2.0
"""The laws by name, and `ReferenceLaw`, with which each follows references of poses and of joints.

A reference on "R3 x S3" is a pose, of the law's end point. A Euclidean one whose dimensions are names of joints is a
Gaussian over these joints. When references change from one kind to the other, or to other joints, the torques are
blended from one law to the other within `blend_time`; each is a sum that carries the robot, and so is every blend.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from functools import partial
from typing import Any

import numpy as np

from tpgmm_core.common.blending import smoothstep
from tpgmm_core.common.text import listed, shown
from tpgmm_core.control.control_law import ControlLaw, DynamicState, LawTorques
from tpgmm_core.control.impedance import ImpedanceConfig, ImpedanceLaw
from tpgmm_core.control.joint_impedance import JointImpedanceConfig, JointImpedanceLaw
from tpgmm_core.control.planning import PlanConfig, Planning, Submit, at_once
from tpgmm_core.control.receding_gains import RecedingGains
from tpgmm_core.geometry.manifold import POSE
from tpgmm_core.model.reference import Reference
from tpgmm_core.robot.model import RobotModel

#: Names of the joints that a law moves; none: those of the end point, by its pose.
type Joints = tuple[str, ...]
type _Law = ImpedanceLaw | JointImpedanceLaw


@dataclass(frozen=True, slots=True)
class LawSettings:
    """Parameters of all laws: each uses those that it knows.

    Parameters
    ----------
    pose
        of laws that follow poses
    joint
        of laws that follow references of joints
    plan
        of laws that look ahead
    """

    pose: ImpedanceConfig = field(default_factory=ImpedanceConfig)
    joint: JointImpedanceConfig = field(default_factory=JointImpedanceConfig)
    plan: PlanConfig = field(default_factory=PlanConfig)

    @classmethod
    def filled(cls, fill: Callable[[type], Any]) -> LawSettings:
        """Make each of the parts by `fill`, which is called with its class. Raises what `fill` raises."""
        return cls(fill(ImpedanceConfig), fill(JointImpedanceConfig), fill(PlanConfig))


#: Classes whose fields are the laws' parameters; they share some.
CONFIGS: tuple[type, ...] = (ImpedanceConfig, JointImpedanceConfig, PlanConfig)


@dataclass(frozen=True, slots=True)
class LawTarget:
    """A reference that was checked, and the law that follows it."""

    law: ControlLaw[Any]
    of_law: Any


class ReferenceLaw(ControlLaw[LawTarget]):
    """One of `LAWS`, for references of any kind; see the module.

    The laws of the end point's pose and of its joints are made at once, so that all is compiled; that of other joints
    when they are named first, which takes some ms, once.

    Parameters
    ----------
    name
        one of `LAWS`
    robot
        to be controlled
    endpoint
        whose poses are followed
    settings
        parameters of all laws
    submit
        where the predictive law's plans are made

    Raises
    ------
    ValueError
        for an unknown law or end point
    ImportError
        where a law's solver is not installed
    """

    def __init__(
        self,
        name: str,
        robot: RobotModel,
        endpoint: str = "left",
        settings: LawSettings | None = None,
        submit: Submit[Any] = at_once,
    ) -> None:
        if name not in LAWS:
            raise ValueError(f"there is no law {shown(name)}; expected one of {', '.join(LAWS)}")
        if endpoint not in robot.endpoints:
            raise ValueError(f"the robot has no end point {shown(endpoint)}; it has {listed(robot.endpoints)}")
        self.name, self.robot, self.endpoint, self._submit = name, robot, endpoint, submit
        self._settings = settings or LawSettings()
        arm = tuple(robot.joint_names[i] for i in robot.indices(robot.endpoints[endpoint].joints))
        self._of_pose, self._of_joints = self._made(()), (arm, self._made(arm))
        self.reset()

    def configure(self, settings: LawSettings) -> None:
        """Use other parameters, also while a reference is followed."""
        self._settings = settings
        for law in (self._of_pose, self._of_joints[1]):
            for planning in (law, law.ahead):
                if isinstance(planning, Planning):
                    planning.plan = settings.plan
            if isinstance(law, ImpedanceLaw):
                law.configure(settings.pose)
            else:
                law.configure(settings.joint)

    @property
    def plan_age(self) -> float | None:
        """Age of the state that the present plan was made from, s; None for laws that have no plan."""
        return getattr(self._current, "latency", None)

    def reset(self) -> None:
        """Forget targets and postures; the next step starts from the state that it is given."""
        self._current: ControlLaw[Any] = self._of_pose
        self._former: ControlLaw[Any] | None = None
        self._share = 1.0
        self._current.reset()

    def target(self, reference: Reference, moving: bool) -> LawTarget:
        """Prepare a reference by the law of its kind.

        Raises
        ------
        ValueError
            for a reference that is neither of a pose nor of joints of the robot, and as that law does
        """
        law = self._law_of(self._joints_of(reference))
        return LawTarget(law, law.target(reference, moving))

    def step(self, moment: DynamicState, target: LawTarget | None, dt: float) -> LawTorques:
        """Torques of a state; during a change of laws the blend of both, with the new law's gains and error."""
        if target is not None and target.law is not self._current:
            if target.law is self._former:
                self._share = 1.0 - self._share
            else:
                target.law.reset()
                self._share = 0.0
            self._former, self._current = self._current, target.law
        asked = self._current.step(moment, None if target is None else target.of_law, dt)
        if self._former is None:
            return asked
        before = self._former.step(moment, None, dt)
        self._share = min(1.0, self._share + dt / self._settings.pose.blend_time)
        if self._share == 1.0:
            self._former = None
        return _between(before, asked, smoothstep(self._share))

    def _joints_of(self, reference: Reference) -> Joints:
        manifold = reference.gaussian.manifold
        if manifold == POSE:
            return ()
        names = reference.dimensions
        known = all(name in self.robot.joint_names for name in names)
        if not manifold.is_euclidean or not known or len(names) != manifold.dim:
            raise ValueError(
                f"the reference is on '{manifold}' with the dimensions {listed(names)}; expected a pose on '{POSE}', "
                f"or a Gaussian over joints, which its dimensions name, of {listed(self.robot.joint_names, 40)}"
            )
        return names

    def _law_of(self, joints: Joints) -> _Law:
        if not joints:
            return self._of_pose
        if self._of_joints[0] != joints:
            self._of_joints = joints, self._made(joints)
        return self._of_joints[1]

    def _made(self, joints: Joints) -> _Law:
        return LAWS[self.name](self.robot, self.endpoint, joints, self._settings, self._submit)


def _impedance(
    robot: RobotModel,
    endpoint: str,
    joints: Joints,
    settings: LawSettings,
    submit: Submit[Any],
    gains: Callable[[PlanConfig], RecedingGains[Any]] | None = None,
) -> _Law:
    ahead = None if gains is None else gains(settings.plan)
    if joints:
        return JointImpedanceLaw(robot, joints, settings.joint, ahead)
    return ImpedanceLaw(robot, endpoint, settings.pose, ahead=ahead)


def _predictive(robot: RobotModel, endpoint: str, joints: Joints, settings: LawSettings, submit: Submit[Any]) -> _Law:
    from tpgmm_core.control.predictive_law import PredictiveLaw  # its solver is optional

    if joints:
        return PredictiveLaw(robot, joints, None, settings.joint, plan=settings.plan, submit=submit)
    arm = (robot.endpoints[endpoint].joints,)
    return PredictiveLaw(robot, arm, endpoint, settings.joint, plan=settings.plan, submit=submit)


#: The laws of minimal intervention control; docs/how-to/choose-a-law.md says which to choose.
LAWS: Mapping[str, Callable[[RobotModel, str, Joints, LawSettings, Submit[Any]], _Law]] = {
    "infinite_horizon": _impedance,
    "finite_horizon": partial(_impedance, gains=RecedingGains),
    "predictive": _predictive,
    "risk_sensitive": partial(_impedance, gains=partial(RecedingGains, risk_sensitive=True)),
}


def _between(before: LawTorques, after: LawTorques, share: float) -> LawTorques:
    """Torques a share (0 to 1) of the way from one law to the other, term by term."""
    zero = np.zeros_like(after.tau)
    names = dict.fromkeys((*after.terms, *before.terms))
    terms = {name: share * after.terms.get(name, zero) + (1.0 - share) * before.terms.get(name, zero) for name in names}
    return replace(
        after,
        tau=share * after.tau + (1.0 - share) * before.tau,
        terms=terms,
        stiffness=share * after.stiffness,
        damping=share * after.damping,
        saturated=after.saturated or before.saturated,
        reason=after.reason or before.reason,
        delay_margin=min(before.delay_margin, after.delay_margin),
        share=min(before.share, after.share),
    )
