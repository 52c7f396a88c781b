# SPDX-License-Identifier: Apache-2.0
"""What the simulated robot does about commands that stop, or that it cannot follow."""

from __future__ import annotations

import numpy as np

from faults.robot_bench import AT_REST, RobotBench
from faults.table import fault
from simulated_hand import NAMES, ROBOT
from tpgmm_ros.messages import conversions

OTHER_NAMES = [name for name in NAMES if name != "head_pan"]


@fault(
    RobotBench,
    "the robot's torques stop while it moves",
    "after command_timeout (0.1 s) it carries its own weight and brakes at braking_rate (20 1/s): at rest",
)
def torques_stop(bench: RobotBench) -> str:
    speed = bench.drive()
    before = bench.state()[0]
    rest = bench.wait(lambda: bench.speed() < AT_REST, "rest")
    way = float(np.abs(bench.state()[0] - before).max())
    assert way < 0.15, f"{way} rad until rest"
    return f"from {speed:.2f} rad/s at rest after {rest:.2f} s and {way:.3f} rad"


BAD_TORQUES: dict[str, tuple[list[str], np.ndarray, str]] = {
    "with NaN": (NAMES, np.where(np.arange(len(NAMES)) == 3, np.nan, 0.0), "is not finite"),
    "that lack a joint": (OTHER_NAMES, np.zeros(len(OTHER_NAMES)), "joints missing: head_pan"),
    "of wrong length": (NAMES, np.zeros(3), "effort has 3 numbers"),
}


def enter_bad_torques(name: str, names: list[str], effort: np.ndarray, reason: str) -> None:
    @fault(
        RobotBench,
        f"torques {name}, while the robot moves",
        "refused with an error in the log; as if none came: it brakes after command_timeout",
    )
    def bad_torques(bench: RobotBench) -> str:
        speed = bench.drive()

        def at_rest() -> bool:
            bench.command(effort, names)
            return bench.speed() < AT_REST and reason in bench.process.output

        rest = bench.wait(at_rest, f"rest, and '{reason}' in the log")
        assert np.isfinite(bench.applied()).all()
        return f"'{reason}', from {speed:.2f} rad/s at rest after {rest:.2f} s"


for _name, (_names, _effort, _reason) in BAD_TORQUES.items():
    enter_bad_torques(_name, _names, _effort, _reason)


@fault(RobotBench, "torques a thousand times their limits", "limited to what the motors have")
def torques_beyond(bench: RobotBench) -> str:
    count = len(bench.states.messages)

    def commanded() -> bool:
        bench.command(1e3 * ROBOT.effort_limits)
        return float(np.abs(bench.applied()[count:] / ROBOT.effort_limits).max(initial=0.0)) > 0.99

    bench.wait(commanded, "the torques to be applied")
    bench.wait(lambda: bench.speed() < AT_REST, "rest")
    share = float(np.abs(bench.applied() / ROBOT.effort_limits).max())
    positions = bench.state()[0]
    assert share <= 1.0 + 1e-9 and np.isfinite(positions).all()
    return f"applied at most {100 * share:.1f} % of the limits"


@fault(
    RobotBench,
    "external wrenches at an unknown link, or with NaN",
    "refused with the reason; the robot stays at rest",
)
def bad_wrenches(bench: RobotBench) -> str:
    wrenches = {
        "nowhere": conversions.wrench_from_array([50.0, 0, 0, 0, 0, 0], 0, "nowhere"),
        "is not finite": conversions.wrench_from_array([np.nan, 0, 0, 0, 0, 0], 0, "left_gripper"),
    }
    bench.states.clear()
    bench.wait(lambda: bench.states.messages, "joint states")
    for reason, wrench in wrenches.items():

        def told(reason: str = reason, wrench: object = wrench) -> bool:
            bench.wrenches.publish(wrench)
            lines = [line for line in bench.process.output.splitlines() if "wrench refused" in line]
            return any(reason in line for line in lines)

        bench.wait(told, f"'{reason}' in the log")
    speed = max(float(np.abs(message.velocity).max()) for message in bench.states.messages)
    assert speed < 2.0 * AT_REST, f"a joint moved at {speed} rad/s"
    return f"both refused, no joint faster than {speed:.4f} rad/s"


@fault(RobotBench, "a push that is not repeated", "ends after wrench_timeout (0.2 s); the robot brakes to rest")
def push_ends(bench: RobotBench) -> str:
    push = conversions.wrench_from_array([0.0, 30.0, 0.0, 0.0, 0.0, 0.0], 0, "left_gripper")

    def moves() -> bool:
        bench.wrenches.publish(push)
        return bench.speed() > 0.1

    bench.wait(moves, "the arm to move")
    rest = bench.wait(lambda: bench.speed() < AT_REST, "rest")
    return f"at rest {rest:.2f} s after the last one"
