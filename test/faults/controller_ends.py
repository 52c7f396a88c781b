# SPDX-License-Identifier: Apache-2.0
"""What the impedance_controller leaves the robot with when it ends, and who cannot hear it."""

from __future__ import annotations

import signal

import numpy as np
from rclpy.qos import QoSProfile, ReliabilityPolicy
from sensor_msgs.msg import JointState

from faults.controller_bench import NODE, RATE, ControllerBench
from faults.table import fault
from ros_graph import ACTIVATE, DEACTIVATE, change_state, set_parameters
from ros_testing import spin_until
from simulated_hand import TICK_NS, pose_reference
from tpgmm_msgs.msg import ControllerState


def let_go(bench: ControllerBench, pushed: np.ndarray) -> str:
    """The last torque carries the robot, and the way there kept the rate limit."""
    bench.spin_for(0.1)  # what is still on its way
    efforts = bench.efforts()
    pull = np.abs(pushed - bench.weight()).max()
    assert pull > 0.05, "there was nothing to let go of"
    step = np.abs(np.diff(efforts[-30:], axis=0)).max()
    assert step <= RATE + 1e-9
    carried = bench.assert_carried()
    bench.assert_silent()
    return (
        f"pulled with {100 * pull:.0f} % of a limit; largest step on the way {100 * step:.1f} %, {carried}, then silent"
    )


@fault(
    ControllerBench,
    "deactivated while it pulls",
    "the last torques lead to gravity compensation as fast as torque_rate permits; then nothing",
)
def deactivated(bench: ControllerBench) -> str:
    pushed = bench.push()
    assert change_state(bench.node, NODE, DEACTIVATE)
    observed = let_go(bench, pushed)
    assert change_state(bench.node, NODE, ACTIVATE)
    return observed


def enter_signal(number: signal.Signals) -> None:
    @fault(
        ControllerBench,
        f"{number.name} while it pulls",
        "the last torques lead to gravity compensation as fast as torque_rate permits; exit status 0",
    )
    def ended(bench: ControllerBench) -> str:
        assert set_parameters(bench.node, NODE, joint_state_timeout=5.0).successful
        pushed = bench.push()
        bench.process.send_signal(number)
        spin_until(bench.node, lambda: bench.process.returncode is not None, message="the process to end")
        assert bench.process.returncode == 0, bench.process.output
        return f"{let_go(bench, pushed)}, status 0"


for _number in (signal.SIGINT, signal.SIGTERM):
    enter_signal(_number)


@fault(
    ControllerBench,
    "joint states stop, with the default time-outs",
    "DAMPING after 0.02 s, silence after 0.22 s",
)
def default_timeouts(bench: ControllerBench) -> str:
    assert set_parameters(bench.node, NODE, joint_state_timeout=0.02, silence_after=0.2).successful
    bench.hand.tick()
    damping = bench.wait_for(ControllerState.DAMPING, "no new joint state for 0.02 s")
    waiting = bench.wait_for(ControllerState.WAITING, "no new joint state for 0.22 s: silent")
    bench.assert_silent(0.1)
    assert set_parameters(bench.node, NODE, joint_state_timeout=0.25).successful
    return f"{damping}, {waiting}"


@fault(
    ControllerBench,
    "a transition that the state does not have",
    "refused with an error in the log; goes on following",
)
def wrong_transition(bench: ControllerBench) -> str:
    goal = bench.follow(50)
    assert not change_state(bench.node, NODE, ACTIVATE)
    assert "it is not possible in the state 'active'" in bench.process.output
    for _ in range(20):
        bench.hand.tick(pose_reference(goal, bench.hand.stamp_ns + TICK_NS))
    return "refused, 'it is not possible in the state active', and answers joint states"


@fault(
    ControllerBench,
    "a robot driver that asks for reliable torques (QoS mismatch)",
    "the diagnostics and the log name driver, topic and what to set there",
)
def driver_with_other_qos(bench: ControllerBench) -> str:
    reliable = QoSProfile(depth=1, reliability=ReliabilityPolicy.RELIABLE)
    driver = bench.node.create_subscription(JointState, "joint_torques", lambda _: None, reliable)
    words = "/test cannot hear /joint_torques: set reliability best_effort there"
    spin_until(
        bench.node,
        lambda: words in bench.diagnostics.messages.get(NODE, ""),
        message="the diagnostics to name the driver",
        processes=(bench.process,),
    )
    assert words in bench.process.output
    bench.node.destroy_subscription(driver)
    spin_until(bench.node, lambda: words not in bench.diagnostics.messages[NODE], message="all to be well again")
    return f"'{words}'; gone from the diagnostics when the driver had gone"
