# SPDX-License-Identifier: Apache-2.0
"""All four nodes in real time, objects that are seen, and movements of the simulated robot."""

from __future__ import annotations

import contextlib
import io
import signal
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any, ClassVar, Self

import numpy as np
from geometry_msgs.msg import PoseStamped
from rclpy.action import ActionClient
from rclpy.node import Node
from sensor_msgs.msg import JointState

from ros_graph import ALL, ALL_LATCHED, ROBOT_FILE, ROOT, TASK_FILE, Diagnostics, Inbox, result_of, ros_arguments
from ros_testing import STARTUP_TIMEOUT, RunningProcess, StartProcess, spin_until
from simulated_hand import ROBOT
from tpgmm_core.control.supervision import ControllerMode
from tpgmm_demos.scene.pick_place import Placement, random_placement
from tpgmm_msgs.action import Reproduce
from tpgmm_msgs.msg import ControllerState, Reference, TaskFrame, TaskParameters
from tpgmm_ros.messages import conversions
from tpgmm_ros.messages.qos import STREAM
from tpgmm_ros.programs import train
from tpgmm_ros.runtime.processes import REALTIME_PRIORITY

#: Duration of the movements that are asked for, s.
DURATION = 4.0
#: `torque_rate`, effort limits per second; and for how long a pause counts, s.
TORQUE_RATE, MAX_TIME_STEP = 30.0, 0.005
#: Without a restart, a node that has come back is at work within this, s.
RECOVERY = 30.0


class GraphBench:
    """frame_tracker, reproduction, impedance_controller and baxter_simulator, and what they have published.

    Attributes:
        places: the pose of each frame that is seen, published 50 times per second; what is taken out is not seen.
        distort: called with each pose message of a frame before it is published.
        usual: what the reference does without a fault: its speed at most, m/s, and its largest change in one step.
    """

    name: ClassVar[str] = "graph"
    realtime: ClassVar[bool] = True
    #: Joint states per second; slow cores that are to run four nodes and this program bear less.
    joint_state_rate: ClassVar[float] = 500.0
    #: Further parameters of the nodes.
    more: ClassVar[dict[str, dict[str, object]]] = {}

    def __init__(self, node: Node, start: StartProcess, directory: Path) -> None:
        self.node, self._start, self.directory = node, start, directory
        self.model_file = trained(directory / "model.tpgmm")
        real_time = {"realtime_priority": REALTIME_PRIORITY}
        task, robot = {"task_file": TASK_FILE, **real_time}, {"robot_file": ROBOT_FILE, **real_time}
        answering = {"autostart": True, "joint_state_rate": self.joint_state_rate}
        self.parameters: dict[str, dict[str, object]] = {
            "frame_tracker": task,
            "reproduction": {
                **task, **answering, "model_file": self.model_file, "settle_time": 0.5, "start_timeout": 2.0
            },
            "impedance_controller": {**robot, **answering},
            "baxter_simulator": {**robot, "rate": self.joint_state_rate},
        }  # fmt: skip
        for name, values in self.parameters.items():
            values.update(self.more.get(name, {}))
        self.situation: Placement = random_placement(np.random.default_rng(3))
        self.places: dict[str, np.ndarray] = {}
        self.distort: Callable[[str, PoseStamped], object] = lambda name, message: None
        self.torques = Inbox(node, JointState, "joint_torques", ALL)
        self.states = Inbox(node, JointState, "joint_states", ALL)
        self.references = Inbox(node, Reference, "reference", ALL)
        self.modes = Inbox(node, ControllerState, "controller_state", ALL_LATCHED)
        self.frames = Inbox(node, TaskParameters, "task_parameters", ALL_LATCHED)
        self.diagnostics = Diagnostics(node)
        self.client = ActionClient(node, Reproduce, "reproduce")
        self._eyes = {name: node.create_publisher(PoseStamped, f"{name}/pose", STREAM) for name in ("object", "target")}
        node.create_timer(0.02, self._see)
        self.processes: dict[str, RunningProcess] = {}
        for name in self.parameters:
            self.start(name)
        self.see_all()
        self.wait(self.is_ready, "all nodes to be at work", 3 * STARTUP_TIMEOUT)
        self.usual = (0.0, 0.0)

    @classmethod
    def open(cls, node: Node, start: StartProcess, directory: Path) -> Self:
        return cls(node, start, directory)

    def is_ready(self) -> bool:
        """Whether a movement may be asked for."""
        seen = {item.name for message in self.frames.messages[-1:] for item in message.frames if item.confidence == 1.0}
        return self.client.server_is_ready() and bool(self.torques.messages) and seen >= set(self.places)

    def prepare(self) -> None:
        self.alive()
        self.see_all()
        self.wait(self.is_ready, "all nodes to be at work")
        if self.usual == (0.0, 0.0):
            for _ in range(2):  # the second begins where the first has ended, as all others do
                result = self.result(self.move())
                assert result.success, result.reason
            self.usual = self.reference_steps()
        self.clear()

    def settle(self) -> str:
        """Whatever happened: objects are seen, and the next movement comes to its end, within all limits."""
        self.see_all()
        began = time.monotonic()
        deadline = began + RECOVERY
        while True:
            goal = self.move()
            result = self.result(goal)
            if result.success:
                break
            assert time.monotonic() < deadline, f"no movement succeeds any more: {result.reason}"
        self.assert_sound()
        return (
            f"back: a movement ended {1e3 * result.final_position_error:.1f} mm off, "
            f"torques changed at most at {100 * self.rate():.0f} % of torque_rate"
        )

    # -- nodes --------------------------------------------------------------------------------------------------------

    def start(self, name: str) -> RunningProcess:
        """Start a node of the graph, or start it again; lifecycle nodes activate themselves."""
        self.processes[name] = self.spare(name)
        return self.processes[name]

    def spare(self, name: str) -> RunningProcess:
        """Start a node of the graph, which may be there already."""
        return self._start(name, *ros_arguments(**self.parameters[name]))

    def start_program(self, *command: str) -> RunningProcess:
        """Start a program on the domain of the nodes."""
        return self._start(*command)

    def kill(self, name: str) -> None:
        """SIGKILL: it says nothing more."""
        self.processes[name].send_signal(signal.SIGKILL)
        self.wait(lambda: self.processes[name].returncode is not None, f"{name} to end")

    def wait(self, condition: Callable[[], Any], what: str, timeout: float = STARTUP_TIMEOUT) -> float:
        """Serve the topics until a condition holds; how long that took, s."""
        began = time.monotonic()
        spin_until(self.node, condition, timeout, what)
        return time.monotonic() - began

    def spin_for(self, seconds: float) -> None:
        end = time.monotonic() + seconds
        spin_until(self.node, lambda: time.monotonic() > end, seconds + STARTUP_TIMEOUT)

    def alive(self) -> None:
        """No node has ended."""
        for name, process in self.processes.items():
            assert process.returncode is None, f"{name} ended with {process.returncode}:\n{process.output[-2000:]}"

    # -- what is seen -------------------------------------------------------------------------------------------------

    def see_all(self) -> None:
        """All objects lie where they lay at first, and are seen."""
        self.places = {"object": self.situation.object, "target": self.situation.target}
        self.distort = lambda name, message: None

    def _see(self) -> None:
        for name, place in self.places.items():
            message = conversions.pose_stamped(place, self.now_ns(), "base")
            self.distort(name, message)
            self._eyes[name].publish(message)

    # -- movements ----------------------------------------------------------------------------------------------------

    def move(self, duration: float = DURATION, until: float = 0.0) -> Any:
        """Ask for a movement and wait until it has come so far (0 to 1); the goal's handle."""
        self.clear()
        deadline = time.monotonic() + STARTUP_TIMEOUT
        handle = None
        # of this movement: references of the one before go on until the new one is made ready
        phases: list[float] = [0.0]
        while handle is None:
            # a server that was killed is still known for some time: what is sent to it is lost
            assert time.monotonic() < deadline, "no reproduction takes a goal"
            self.wait(self.client.server_is_ready, "the action to be there")
            sent = self.client.send_goal_async(
                Reproduce.Goal(duration=duration),
                feedback_callback=lambda message: phases.append(message.feedback.phase),
            )
            with contextlib.suppress(AssertionError):
                handle = result_of(self.node, sent, "the goal to be accepted", 3.0)
        assert handle.accepted
        handle.outcome = handle.get_result_async()
        if until > 0.0:
            self.wait(lambda: phases[-1] >= until or handle.outcome.done(), "the movement to come on")
            assert not handle.outcome.done(), handle.outcome.result().result.reason
        return handle

    def result(self, handle: Any, timeout: float = STARTUP_TIMEOUT) -> Reproduce.Result:
        """How a movement ended."""
        return result_of(self.node, handle.outcome, "the movement to end", timeout).result

    def phase(self) -> float:
        """How far the movement is, 0 before its first reference."""
        return 0.0 if self.references.last is None else self.references.last.phase

    # -- what was observed --------------------------------------------------------------------------------------------

    def clear(self) -> None:
        """Forget what was published so far."""
        for inbox in (self.torques, self.states, self.references, self.modes, self.frames):
            inbox.clear()

    def now_ns(self) -> int:
        """The time of the stamps."""
        return self.node.get_clock().now().nanoseconds

    def seen(self, name: str) -> list[TaskFrame]:
        """A frame in all task parameters since `clear`."""
        return [item for message in self.frames.messages for item in message.frames if item.name == name]

    def said(self, node: str, words: str) -> Callable[[], bool]:
        """Whether the diagnostics of a node say something."""
        return lambda: words in self.diagnostics.messages.get(node, "")

    def mode_since(self, mode: ControllerMode, since_ns: int) -> float:
        """Wait for a mode of the controller; when it came, s after `since_ns`."""

        def times() -> list[int]:
            stamps = [
                conversions.time_to_ns(item.header.stamp) for item in self.modes.messages if item.state == int(mode)
            ]
            return [stamp for stamp in stamps if stamp >= since_ns]

        self.wait(times, mode.name)
        return 1e-9 * (times()[0] - since_ns)

    def rate(self) -> float:
        """The fastest change of a torque since `clear`, in shares of `torque_rate`."""
        if len(self.torques.messages) < 2:
            return 0.0
        efforts = np.array([message.effort for message in self.torques.messages]) / ROBOT.effort_limits
        steps = np.diff([conversions.time_to_ns(message.header.stamp) for message in self.torques.messages])
        # answers to silence carry the stamp of the last state; after it, a pause counts for MAX_TIME_STEP
        seconds = np.where(steps > 0, 1e-9 * steps, MAX_TIME_STEP)
        return float((np.abs(np.diff(efforts, axis=0)).max(axis=1) / seconds).max() / TORQUE_RATE)

    def speed(self) -> float:
        """The fastest joint at present, rad/s."""
        return float(np.abs(self.states.last.velocity).max()) if self.states.last else 0.0

    def assert_sound(self) -> str:
        """Torques are finite, within their limits and their rate."""
        efforts = np.array([message.effort for message in self.torques.messages]).reshape(-1, ROBOT.nv)
        assert np.isfinite(efforts).all()
        share = float((np.abs(efforts) / ROBOT.effort_limits).max(initial=0.0))
        assert share <= 1.0 + 1e-9, f"a torque of {share} of its limit"
        assert self.rate() <= 1.0 + 1e-6, f"torques changed at {self.rate()} of torque_rate"
        return f"torques at most {100 * share:.0f} % of their limits, {100 * self.rate():.0f} % of torque_rate"

    def reference_steps(self) -> tuple[float, float]:
        """The reference's speed at most, m/s, since the last movement began, and its largest change in one step.

        Where joint states had a pause, so had the references: the change counts by the steps that it took.
        """
        phases = np.array([message.phase for message in self.references.messages])
        begin = 1 + max(np.flatnonzero(np.diff(phases) < -0.5), default=-1)
        messages = self.references.messages[begin:]
        path = np.array([message.gaussian.mean[:3] for message in messages])
        seconds = 1e-9 * np.diff([conversions.time_to_ns(message.header.stamp) for message in messages])
        velocity = np.diff(path, axis=0)[seconds > 0] / seconds[seconds > 0, None]
        took = self.joint_state_rate * 0.5 * (seconds[seconds > 0][1:] + seconds[seconds > 0][:-1])
        change = np.linalg.norm(np.diff(velocity, axis=0), axis=1) / np.maximum(1.0, took)
        return float(np.linalg.norm(velocity, axis=1).max()), float(change.max())


def trained(path: Path, *options: str) -> Path:
    """A small model of the recorded demonstrations."""
    few = ["--components", "8", "--every", "10", *options]
    with contextlib.redirect_stdout(io.StringIO()):
        status = train.main(["--task", str(TASK_FILE), "--output", str(path), *few, str(ROOT / "bags" / "pick_place")])
    assert status == 0
    return path
