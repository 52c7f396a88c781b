# SPDX-License-Identifier: Apache-2.0
"""A real impedance_controller on one side, on the other a simulated robot and whoever spoils the inputs."""

from __future__ import annotations

import itertools
import time
from collections.abc import Callable
from pathlib import Path
from typing import ClassVar, Self

import numpy as np
from rclpy.node import Node
from sensor_msgs.msg import JointState

from ros_graph import (
    ACTIVATE,
    ALL,
    ALL_LATCHED,
    CONFIGURE,
    DEACTIVATE,
    ROBOT_FILE,
    Diagnostics,
    Inbox,
    change_state,
    ros_arguments,
    set_parameters,
)
from ros_testing import RunningProcess, StartProcess, spin_until
from simulated_hand import ROBOT, TICK_NS, SimulatedHand, pose_reference
from tpgmm_core.control.supervision import ControllerMode
from tpgmm_msgs.msg import ControllerState

NODE = "impedance_controller"
#: Of the effort limits, per ms: `torque_rate`.
RATE = 0.03
#: Longer than the defaults, so that a machine that is busy with other things makes no false alarm, s.
STATE_TIMEOUT, SILENCE_AFTER, HOLD_TIME = 0.25, 0.4, 0.3
#: Where the hand is sent from where it is.
AWAY = np.array([0.0, 0.03, 0.03, 0.0, 0.0, 0.0, 0.0])
#: What is called the safe torque may differ from gravity compensation by this share of the limits: residual motion.
AT_REST = 0.02
#: Who is to fall silent has done so within this time, s, however slow the machine is.
SILENT_WITHIN = 5.0


class ControllerBench:
    """A controller, the robot that it drives, and what it has said since it was activated."""

    name: ClassVar[str] = "controller"
    realtime: ClassVar[bool] = False

    def __init__(self, node: Node, start: StartProcess) -> None:
        self.node, self._start = node, start
        self.process = self._started()
        self.hand = SimulatedHand(node, self.process)
        self.states = Inbox(node, ControllerState, "controller_state", ALL_LATCHED)
        self.torques = Inbox(node, JointState, "joint_torques", ALL)
        self.diagnostics = Diagnostics(node)

    @classmethod
    def open(cls, node: Node, start: StartProcess, directory: Path) -> Self:
        return cls(node, start)

    def _started(self) -> RunningProcess:
        # the hand's time is its own: its stamps are of another clock
        process = self._start(NODE, *ros_arguments(robot_file=ROBOT_FILE, hold_time=HOLD_TIME, max_age=0.0))
        assert change_state(self.node, NODE, CONFIGURE)
        return process

    def prepare(self) -> None:
        if self.process.returncode is not None:
            self.process = self.hand.process = self._started()
        assert set_parameters(
            self.node, NODE, joint_state_timeout=STATE_TIMEOUT, silence_after=SILENCE_AFTER
        ).successful
        self.hand.simulator.reset()
        self.hand.stamp_ns += 20_000 * TICK_NS
        spin_until(
            self.node,
            lambda: self.hand.states.get_subscription_count() and self.hand.references.get_subscription_count(),
            message="the controller to listen",
            processes=(self.process,),
        )
        assert change_state(self.node, NODE, ACTIVATE)
        self.states.clear()
        self.torques.clear()

    def settle(self) -> str:
        if self.process.returncode is not None:
            return "the process has ended"
        step = self._come_back()
        assert change_state(self.node, NODE, DEACTIVATE)
        return f"back: ACTIVE, largest torque step {100 * step:.1f} % of its limit in 1 ms ({100 * RATE:g} % allowed)"

    def _come_back(self) -> float:
        """Good inputs again: it follows again; the largest step of a torque meanwhile, in shares of its limit."""
        self.states.clear()
        before = len(self.torques.messages)
        goal = self.hand.pose
        for tick in range(700):
            self.hand.tick(pose_reference(goal, self.hand.stamp_ns + TICK_NS))
            if tick == 0:  # the first torque after a silence has had more time
                before = len(self.torques.messages)
        assert self.states.last.state == ControllerState.ACTIVE, self.states.last.reason
        steps = np.abs(np.diff(self.efforts()[before:], axis=0))
        assert len(steps) > 600 and steps.max() < RATE + 1e-9, f"a torque step of {steps.max()} of its limit"
        np.testing.assert_allclose(self.hand.pose[:3], goal[:3], atol=0.02)
        self.assert_sound()
        return float(steps.max())

    def follow(self, ticks: int = 300) -> np.ndarray:
        """Follow a reference a little way off; returns the pose (7,) that is asked for."""
        goal = self.hand.pose + AWAY
        for _ in range(ticks):
            self.hand.tick(pose_reference(goal, self.hand.stamp_ns + TICK_NS))
        self.states.clear()
        return goal

    def push(self) -> np.ndarray:
        """Have the controller pull at a hand that is stuck; the torques (nv,) in shares of their limits."""
        stuck = self.hand.simulator.state.q
        for tick in range(400):
            goal = self.hand.pose + min(1.0, tick / 300) * AWAY
            self.hand.tick(pose_reference(goal, self.hand.stamp_ns + TICK_NS))
            self.hand.simulator.reset(stuck)
        return self.efforts()[-1]

    def modes(self) -> list[int]:
        """The modes one after the other, each change once."""
        return [mode for mode, _ in itertools.groupby(message.state for message in self.states.messages)]

    def wait_for(self, mode: int, reason: str = "", meanwhile: Callable[[], object] = lambda: None) -> str:
        """Wait until it says that it is in a mode for a reason, and return that; `meanwhile` is done all the time."""
        began = time.monotonic()

        def reached() -> bool:
            meanwhile()
            return any(message.state == mode and reason in message.reason for message in self.states.messages)

        spin_until(self.node, reached, message=f"mode {mode}: {reason}", processes=(self.process,))
        message = next(item for item in self.states.messages if item.state == mode and reason in item.reason)
        return f"{ControllerMode(mode).name} within {time.monotonic() - began:.2f} s ({message.reason})"

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

    def assert_carried(self) -> str:
        """The last torque carries the robot where it is."""
        apart = float(np.abs(self.efforts()[-1] - self.weight()).max())
        assert apart < AT_REST, f"the last torque is {apart} of a limit from gravity compensation"
        return f"last torque {100 * apart:.1f} % of a limit from gravity compensation"

    def assert_sound(self) -> None:
        """No torque beyond its limit, and none that is not finite."""
        efforts = self.efforts()
        assert np.isfinite(efforts).all()
        assert (np.abs(efforts) <= 1.0 + 1e-12).all()

    def assert_silent(self, seconds: float = 0.2, meanwhile: Callable[[], object] = lambda: None) -> None:
        """No torque leaves for some time: now, or soon, where the machine is slow."""
        deadline = time.monotonic() + SILENT_WITHIN
        silent = False
        while not silent:
            assert time.monotonic() < deadline, "torques are still sent"
            sent = len(self.torques.messages)
            self.spin_for(seconds, meanwhile)
            silent = len(self.torques.messages) == sent
