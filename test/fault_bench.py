# SPDX-License-Identifier: Apache-2.0
"""A real impedance_controller between a simulated robot and whoever spoils its inputs; what tests of faults share."""

from __future__ import annotations

import itertools
import time
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from rclpy.node import Node
from sensor_msgs.msg import JointState

from ros_graph import ALL, ALL_LATCHED, Inbox
from ros_testing import RunningProcess, spin_until
from simulated_hand import ROBOT, TICK_NS, SimulatedHand, pose_reference
from tpgmm_msgs.msg import ControllerState

#: Of the effort limits, per step; the rate limit is 0.03 per ms.
RATE = 0.03
#: Where the hand is sent from where it is.
AWAY = np.array([0.0, 0.03, 0.03, 0.0, 0.0, 0.0, 0.0])


@dataclass
class FaultBench:
    """A controller, the robot that it drives, and what it has said since it was activated."""

    node: Node
    process: RunningProcess
    hand: SimulatedHand
    states: Inbox
    torques: Inbox

    def follow(self, ticks: int = 300) -> np.ndarray:
        """Follow a reference a little way off; returns the pose (7,) that is asked for."""
        goal = self.hand.pose + AWAY
        for _ in range(ticks):
            self.hand.tick(pose_reference(goal, self.hand.stamp_ns + TICK_NS))
        return goal

    def modes(self) -> list[int]:
        """The modes one after the other, each change once."""
        return [mode for mode, _ in itertools.groupby(message.state for message in self.states.messages)]

    def wait_for(self, mode: int, reason: str = "", meanwhile: Callable[[], object] = lambda: None) -> ControllerState:
        """The message that says that it is in a mode for a reason; `meanwhile` is done all the time."""

        def reached() -> bool:
            meanwhile()
            return any(message.state == mode and reason in message.reason for message in self.states.messages)

        spin_until(self.node, reached, message=f"mode {mode}: {reason}", processes=(self.process,))
        return next(message for message in self.states.messages if message.state == mode and reason in message.reason)

    def spin_for(self, seconds: float, meanwhile: Callable[[], object] = lambda: None) -> None:
        """Let time pass; `meanwhile` is done all the time."""
        end = time.monotonic() + seconds

        def over() -> bool:
            meanwhile()
            return time.monotonic() > end

        spin_until(self.node, over)

    def efforts(self) -> np.ndarray:
        """All torques that were sent (T, nv), in shares of their limits."""
        return np.array([message.effort for message in self.torques.messages]).reshape(-1, ROBOT.nv) / (
            ROBOT.effort_limits
        )

    def weight(self) -> np.ndarray:
        """What carries the robot where it is, in shares of the limits (nv,)."""
        data = ROBOT.create_data()
        return data.gravity(self.hand.simulator.state.q).copy() / ROBOT.effort_limits

    def assert_sound(self) -> None:
        """No torque beyond its limit, and none that is not finite."""
        efforts = self.efforts()
        assert np.isfinite(efforts).all()
        assert (np.abs(efforts) <= 1.0).all()

    def assert_silent(self, seconds: float, meanwhile: Callable[[], object] = lambda: None) -> None:
        """No torque leaves for some time."""
        sent = len(self.torques.messages)
        self.spin_for(seconds, meanwhile)
        assert len(self.torques.messages) == sent

    def assert_comes_back_without_a_jump(self) -> None:
        """Good inputs again: it follows again, and no torque moves faster than the rate limit meanwhile."""
        self.states.clear()
        before = len(self.torques.messages)
        goal = self.hand.pose
        # the first torque after a silence has had more time
        for tick in range(700):
            self.hand.tick(pose_reference(goal, self.hand.stamp_ns + TICK_NS))
            if tick == 0:
                before = len(self.torques.messages)
        assert self.states.last.state == ControllerState.ACTIVE
        steps = np.abs(np.diff(self.efforts()[before:], axis=0))
        assert len(steps) > 600 and steps.max() < RATE
        np.testing.assert_allclose(self.hand.pose[:3], goal[:3], atol=0.02)
        self.assert_sound()


def bench_of(node: Node, process: RunningProcess) -> FaultBench:
    """A bench for a controller that is configured."""
    hand = SimulatedHand(node, process)
    states = Inbox(node, ControllerState, "controller_state", ALL_LATCHED)
    torques = Inbox(node, JointState, "joint_torques", ALL)
    spin_until(
        node,
        lambda: hand.states.get_subscription_count() and hand.references.get_subscription_count(),
        message="the controller to listen",
        processes=(process,),
    )
    return FaultBench(node, process, hand, states, torques)
