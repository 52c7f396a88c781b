# SPDX-License-Identifier: Apache-2.0
"""`PoseGovernor`: the pose that the hand is asked for on its way to the reference (a reference governor).

A reference may be anywhere, and jump. The pose that `ImpedanceLaw` pulls to begins where the hand is, moves on no
faster than the speed limits, waits for a hand that cannot keep up, and takes its gains over without jumps.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from tpgmm_core.common.blending import smoothstep
from tpgmm_core.common.types import Array
from tpgmm_core.control.impedance_config import ImpedanceConfig
from tpgmm_core.control.kernels_pose import approach, lead, waiting_share
from tpgmm_core.control.operational_space import bound_twist
from tpgmm_core.control.pose_target import PoseReference, PoseTarget, receding_pose_target
from tpgmm_core.control.receding_gains import RecedingGains

#: The pose of a hindered hand is no farther away than this (m, rad), and moves at this share of the speed.
LEASH, ANGULAR_LEASH, HINDERED_SPEED = 0.03, 0.2, 0.25


class PoseGovernor:
    """See the module. `target` is what the hand is asked for now; None where nothing is.

    Parameters
    ----------
    ahead
        where gains are those along the reference's horizon, not those of the reference alone
    """

    def __init__(self, ahead: RecedingGains[PoseTarget] | None) -> None:
        self.config = ImpedanceConfig()
        self._ahead = ahead
        self.reset()

    def reset(self) -> None:
        """Forget the target; the next one begins where the hand is."""
        self.target: PoseTarget | None = None
        self.blend = 0.0
        self._push = np.zeros(6)  # what the gains of a horizon ask for beside the error
        if self._ahead is not None:
            self._ahead.reset()

    @property
    def weight(self) -> float:
        """Weight of the target, 0 to 1, smooth at both ends."""
        return smoothstep(self.blend)

    def step(self, target: PoseTarget | None, hand: Array, dt: float, hindered: bool) -> None:
        """Blend a target in, or the last one out.

        Parameters
        ----------
        target
            what is to be reached; None: the last target is released over `blend_time`, at rest
        hand
            (7,), where the hand is
        dt
            since the last step, s
        hindered
            whether something keeps the hand from following: the target then stays near it, and is slow
        """
        change = dt / self.config.blend_time
        if target is not None:
            target = self._with_gains_ahead(target, dt)
            self.blend = min(1.0, self.blend + change)
            self.target = self._approach(target, hand, dt, hindered)
            return
        self.blend = max(0.0, self.blend - change)
        if self.blend == 0.0:
            self.target = None
        elif self.target is not None:
            still = replace(self.target.reference, twist=np.zeros(6), acceleration=np.zeros(6))
            self.target = replace(self.target, reference=still)

    def _with_gains_ahead(self, target: PoseTarget, dt: float) -> PoseTarget:
        """With gains of the course that comes, where the target has one."""
        config, ahead, course = self.config, self._ahead, target.course
        if ahead is None or course is None:
            return target
        cost, length, bounds = config.control_cost, config.characteristic_length, config.bounds
        planned = ahead.at_present(
            dt, lambda: receding_pose_target(target.reference, course, ahead, cost, length, bounds)
        )
        # the feedforward belongs to the gains, and comes as they do
        self._push += min(1.0, dt / config.gain_time) * (planned.reference.acceleration - self._push)
        return replace(planned, reference=replace(target.reference, acceleration=self._push.copy()))

    def _waits(self, hand: Array) -> float:
        """Share of its speed with which the pose moves on; see `waiting_share`."""
        last, config = self.target, self.config
        if last is None:
            return 1.0
        limits = config.max_linear_speed, config.max_angular_speed
        return float(waiting_share(hand, last.reference.pose, last.K_V, last.ratio, *limits))

    def _approach(self, target: PoseTarget, hand: Array, dt: float, hindered: bool) -> PoseTarget:
        """The target, as far as its speed permits since the last one, or from where the hand is."""
        last, config, reference = self.target, self.config, target.reference
        pose = (hand if last is None else last.reference.pose).copy()
        # it starts slowly: otherwise the arm would jump to a reference that it does not follow yet
        reach = self.weight * dt * (HINDERED_SPEED if hindered else self._waits(hand))
        approach(pose, reference.pose, config.max_linear_speed * reach, config.max_angular_speed * reach)
        if hindered:
            lead(pose, hand, LEASH, ANGULAR_LEASH, config.max_linear_speed * dt, config.max_angular_speed * dt)
        twist = reference.twist.copy()
        bound_twist(twist, config.max_linear_speed, config.max_angular_speed)
        # jumps of the stiffness would add energy
        share = 1.0 if last is None else min(1.0, dt / config.gain_time)
        before = target if last is None else last
        K_V = before.K_V + share * (target.K_V - before.K_V)
        ratio = before.ratio + share * (target.ratio - before.ratio)
        # bounds of what is blended, since the largest eigenvalue is convex
        rate = before.rate + share * (target.rate - before.rate)
        firmness = before.firmness + share * (target.firmness - before.firmness)
        goal = PoseReference(pose, reference.covariance, twist, reference.acceleration)
        return PoseTarget(goal, K_V, ratio, rate, firmness)
