# SPDX-License-Identifier: Apache-2.0
"""What the impedance_controller does about stale and bad references, and about parameters that make no sense."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from faults.controller import HOUR
from faults.controller_bench import AWAY, NODE, ControllerBench
from faults.table import fault
from ros_graph import set_parameters
from ros_testing import spin_until
from simulated_hand import TICK_NS, pose_reference
from tpgmm_msgs.msg import ControllerState
from tpgmm_msgs.msg import Reference as ReferenceMessage

# -- references -------------------------------------------------------------------------------------------------------


@fault(
    ControllerBench,
    "references stop",
    "HOLD after reference_timeout, at the last pose with its stiffness; DAMPING after hold_time more",
)
def references_stop(bench: ControllerBench) -> str:
    goal = bench.follow(900)
    hold = bench.wait_for(ControllerState.HOLD, "no reference for 0.1 s", bench.hand.tick)
    error = np.linalg.norm(bench.hand.pose[:3] - goal[:3])
    assert error < 0.01
    damping = bench.wait_for(ControllerState.DAMPING, "no reference for 0.4 s", bench.hand.tick)
    return f"{hold}, held {1e3 * error:.1f} mm from the last one, {damping}"


@fault(ControllerBench, "stamps of references do not change", "as when they stop: HOLD, then DAMPING")
def references_frozen(bench: ControllerBench) -> str:
    goal = bench.follow(100)
    stamp = bench.hand.stamp_ns

    def repeat() -> None:
        bench.hand.tick(pose_reference(goal, stamp))

    hold = bench.wait_for(ControllerState.HOLD, "", repeat)
    return f"{hold}, {bench.wait_for(ControllerState.DAMPING, '', repeat)}"


@fault(
    ControllerBench,
    "references that were 0.5 s on their way",
    "never followed: the age by the stamp counts as much as that since the arrival",
)
def references_late(bench: ControllerBench) -> str:
    start = bench.hand.pose
    for _ in range(300):
        bench.hand.tick(pose_reference(start + AWAY, bench.hand.stamp_ns - 500 * TICK_NS))
    assert set(bench.modes()) <= {ControllerState.WAITING, ControllerState.DAMPING}, bench.modes()
    moved = np.linalg.norm(bench.hand.pose[:3] - start[:3])
    assert moved < 0.005
    return f"DAMPING throughout, the hand moved by {1e3 * moved:.2f} mm"


@fault(
    ControllerBench,
    "references an hour ahead of the clock",
    "refused: HOLD, then DAMPING, which name the reason",
)
def references_from_the_future(bench: ControllerBench) -> str:
    bench.follow(50)
    ahead = bench.node.get_clock().now().nanoseconds + HOUR

    def early() -> None:
        bench.hand.tick(pose_reference(bench.hand.pose, ahead))

    hold = bench.wait_for(ControllerState.HOLD, "ahead of this machine's clock", early)
    bench.wait_for(ControllerState.DAMPING, "ahead of this machine's clock", early)
    return f"{hold}, then DAMPING"


def nan_mean(message: ReferenceMessage) -> None:
    message.gaussian.mean[1] = float("nan")


def infinite_covariance(message: ReferenceMessage) -> None:
    message.gaussian.covariance[0] = float("inf")


def negative_covariance(message: ReferenceMessage) -> None:
    message.gaussian.covariance[0] = -1.0


def short_covariance(message: ReferenceMessage) -> None:
    message.gaussian.covariance = message.gaussian.covariance[:-1]


def planar(message: ReferenceMessage) -> None:
    message.gaussian.manifold = "euclidean"


def elsewhere(message: ReferenceMessage) -> None:
    message.header.frame_id = "camera"


BAD_REFERENCES: dict[str, tuple[Callable[[ReferenceMessage], None], str]] = {
    "with NaN": (nan_mean, "not finite"),
    "with an infinite covariance": (infinite_covariance, "not finite"),
    "with a covariance that is not positive definite": (negative_covariance, "positive definite"),
    "of wrong length": (short_covariance, "expected"),
    "on another manifold": (planar, "euclidean"),
    "in a wrong frame_id": (elsewhere, "'camera'"),
}


def enter_bad_references(name: str, spoil: Callable[[ReferenceMessage], None], reason: str) -> None:
    @fault(
        ControllerBench,
        f"references {name}",
        "refused: HOLD at the last good one, then DAMPING; both name the reason",
        quick=name in ("with NaN", "in a wrong frame_id"),
    )
    def bad_references(bench: ControllerBench) -> str:
        goal = bench.follow(400)

        def bad() -> None:
            message = pose_reference(goal + 10 * AWAY, bench.hand.stamp_ns + TICK_NS)
            spoil(message)
            bench.hand.tick(message)

        hold = bench.wait_for(ControllerState.HOLD, reason, bad)
        bench.wait_for(ControllerState.DAMPING, "the newest was refused", bad)
        error = np.linalg.norm(bench.hand.pose[:3] - goal[:3])
        assert error < 0.03
        return f"{hold[:200]}, then DAMPING"


for _name, (_bad, _reason) in BAD_REFERENCES.items():
    enter_bad_references(_name, _bad, _reason)


@fault(
    ControllerBench,
    "a reference that leaps by 0.1 m",
    "followed at max_linear_speed (0.4 m/s), torques within their limits and rates",
)
def reference_leaps(bench: ControllerBench) -> str:
    start = bench.follow()
    first = len(bench.torques.messages)
    goal = start + np.array([0.0, 0.0, 0.1, 0.0, 0.0, 0.0, 0.0])
    heights = []
    for _ in range(600):
        bench.hand.tick(pose_reference(goal, bench.hand.stamp_ns + TICK_NS))
        heights.append(bench.hand.pose[2])
    speed = np.max(np.diff(heights)) / 1e-3
    step = np.abs(np.diff(bench.efforts()[first:], axis=0)).max()
    bench.assert_sound()
    assert speed < 0.6 and step <= 0.03 + 1e-9
    assert abs(heights[-1] - goal[2]) < 0.02
    return f"hand at most {speed:.2f} m/s, largest torque step {100 * step:.1f} % of a limit in 1 ms"


# -- parameters -------------------------------------------------------------------------------------------------------


@fault(
    ControllerBench,
    "parameters out of their range, or that contradict each other, while active",
    "refused as a whole with the reason; followed as before",
)
def bad_parameters(bench: ControllerBench) -> str:
    goal = bench.follow()
    reasons = []
    for values in ({"blend_time": -1.0}, {"torque_rate": 1e9}, {"min_stiffness": 3000.0}, {"robot_file": "other.yaml"}):
        result = set_parameters(bench.node, NODE, **values)
        assert not result.successful and next(iter(values)) in result.reason, result
        reasons.append(result.reason)
    # two values, of which one is good: none is taken
    assert not set_parameters(bench.node, NODE, hold_time=0.5, max_power=-1.0).successful
    bench.hand.tick(pose_reference(goal, bench.hand.stamp_ns + TICK_NS))
    spin_until(bench.node, lambda: bench.hand.answered())
    assert set(bench.modes()) <= {ControllerState.ACTIVE, ControllerState.HOLD, ControllerState.DAMPING}
    return f"refused {len(reasons) + 1} of {len(reasons) + 1}, e.g. '{reasons[2]}'"
