# SPDX-License-Identifier: Apache-2.0
"""Models, goals, task parameters and parameters that are wrong, or change, during a movement of the whole graph."""

from __future__ import annotations

import math
from collections.abc import Callable
from pathlib import Path

from rclpy.qos import QoSProfile, ReliabilityPolicy

from faults.graph_bench import DURATION, GraphBench, trained
from faults.perception import assert_smooth
from faults.table import fault
from ros_graph import ACTIVATE, DEACTIVATE, call, change_state, set_parameters
from tpgmm_core.control.supervision import ControllerMode
from tpgmm_core.observation.tracked import FrameStatus, TrackedFrame
from tpgmm_msgs.msg import TaskFrame, TaskParameters
from tpgmm_msgs.srv import LoadModel
from tpgmm_ros.messages import conversions
from tpgmm_ros.messages.qos import LATCHED


def load(bench: GraphBench, path: Path | str) -> LoadModel.Response:
    return call(bench.node, LoadModel, "load_model", LoadModel.Request(path=str(path)))


@fault(
    GraphBench,
    "the model is swapped during a movement",
    "the new one takes over without a jump, and the movement ends well",
    quick=False,
)
def model_swapped(bench: GraphBench) -> str:
    other = trained(bench.directory / "other.tpgmm", "--retrieval", "trajectory")
    goal = bench.move(duration=2 * DURATION, until=0.2)
    loaded = load(bench, other)
    assert loaded.success, loaded.reason
    phase = bench.phase()
    result = bench.result(goal)
    assert result.success and phase < 1.0, result.reason
    assert load(bench, bench.model_file).success
    observed = f"{result.reason}; {assert_smooth(bench)}; {bench.assert_sound()}"
    return f"taken over before {100 * phase:.0f} % of the way; {observed}"


@fault(
    GraphBench,
    "damaged, foreign and missing model files by service, during a movement",
    "each refused with the reason; the movement goes on with the model in use and ends well",
    quick=False,
)
def model_damaged(bench: GraphBench) -> str:
    whole = bench.model_file.read_bytes()
    files = {"half.tpgmm": whole[: len(whole) // 2], "flipped.tpgmm": whole.replace(b"priors", b"pr1ors")}
    files["foreign.tpgmm"] = b"no model at all"
    for name, content in files.items():
        (bench.directory / name).write_bytes(content)
    goal = bench.move(until=0.1)
    reasons = []
    for name in (*files, "nowhere.tpgmm"):
        refused = load(bench, bench.directory / name)
        assert not refused.success and name in refused.reason, refused
        reasons.append(refused.reason.replace(str(bench.directory), ""))
    result = bench.result(goal)
    assert result.success, result.reason
    return f"refused 4 of 4, e.g. '{reasons[0]}'; {result.reason}; {assert_smooth(bench)}; {bench.assert_sound()}"


def contradicting(item: TaskFrame) -> None:
    item.a = item.a[:-3]


def not_finite(item: TaskFrame) -> None:
    item.b[0] = math.nan


def enormous(item: TaskFrame) -> None:
    item.rows = item.cols = 2**31


DAMAGES: dict[str, Callable[[TaskFrame], None]] = {
    "whose sizes contradict each other": contradicting,
    "with NaN": not_finite,
    "that claim 2^31 rows": enormous,
}


def enter_damage(name: str, damage: Callable[[TaskFrame], None]) -> None:
    @fault(
        GraphBench,
        f"task parameters {name}, from another node, during a movement",
        "refused as a whole with an error in the log; the good ones stay in use, and the other publisher is named",
        quick=False,
    )
    def damaged(bench: GraphBench) -> str:
        other = bench.node.create_publisher(TaskParameters, "task_parameters", LATCHED)
        log = bench.processes["reproduction"]
        already = log.output.count("task parameters refused")
        goal = bench.move(until=0.1)

        def send() -> bool:
            tracked = [
                TrackedFrame(name, FrameStatus.VISIBLE, 1.0, bench.now_ns(), place + [0.3, 0, 0, 0, 0, 0, 0])
                for name, place in bench.places.items()
            ]
            message = conversions.task_parameters_message(tracked, bench.now_ns(), "base")
            damage(message.frames[-1])
            other.publish(message)
            return log.output.count("task parameters refused") > already

        bench.wait(send, "the refusal in the log")
        bench.wait(bench.said("reproduction", "2 publishers on /task_parameters"), "the diagnostics to tell")
        result = bench.result(goal)
        bench.node.destroy_publisher(other)
        assert result.success, result.reason
        line = [text for text in log.output.splitlines() if "task parameters refused" in text][-1]
        return f"'{line[line.index('task parameters refused') :]}'; {result.reason}; {assert_smooth(bench)}"


for _name, _damage in DAMAGES.items():
    enter_damage(_name, _damage)


@fault(
    GraphBench,
    "task parameters from a node with other QoS",
    "reproduction says who is not heard, on which topic, and what to set there",
    quick=False,
)
def qos_mismatch(bench: GraphBench) -> str:
    best_effort = QoSProfile(depth=1, reliability=ReliabilityPolicy.BEST_EFFORT)
    other = bench.node.create_publisher(TaskParameters, "task_parameters", best_effort)
    words = "/test is not heard on /task_parameters: set reliability reliable and durability transient_local there"
    bench.wait(bench.said("reproduction", words), "the diagnostics to tell")
    assert words in bench.processes["reproduction"].output
    bench.node.destroy_publisher(other)
    bench.wait(lambda: not bench.said("reproduction", words)(), "the diagnostics to be well again")
    return f"'{words}', in the log too"


@fault(
    GraphBench,
    "a frame is not known when a movement is asked for",
    "nothing moves; after start_timeout the goal is aborted and names the frame",
    quick=False,
)
def frame_unknown(bench: GraphBench) -> str:
    del bench.places["target"]
    bench.wait(lambda: bench.seen("target") and bench.seen("target")[-1].status == TaskFrame.MISSING, "MISSING")
    result = bench.result(bench.move())
    assert not result.success and "target" in result.reason and "object" not in result.reason, result.reason
    assert bench.phase() in (0.0, 1.0), "a movement has begun"
    return f"'{result.reason}'"


@fault(
    GraphBench,
    "another goal during a movement",
    "the former is aborted with the reason; torques within limits and rates",
    quick=False,
)
def another_goal(bench: GraphBench) -> str:
    former = bench.move(until=0.4)
    latter = bench.move()
    reason = bench.result(former).reason
    assert reason == "another movement was requested"
    result = bench.result(latter)
    assert result.success, result.reason
    return f"former: '{reason}'; latter: {result.reason}; {bench.assert_sound()}"


@fault(
    GraphBench,
    "reproduction deactivated during a movement",
    "the goal is aborted with the reason; the controller holds, then damps",
    quick=False,
)
def deactivated(bench: GraphBench) -> str:
    goal = bench.move(until=0.3)
    since = bench.now_ns()
    assert change_state(bench.node, "reproduction", DEACTIVATE)
    hold = bench.mode_since(ControllerMode.HOLD, since)
    damping = bench.mode_since(ControllerMode.DAMPING, since)
    result = bench.result(goal)
    assert not result.success and "deactivated" in result.reason, f"the goal ended with {result}"
    observed = bench.assert_sound()
    assert change_state(bench.node, "reproduction", ACTIVATE)
    return f"'{result.reason}', HOLD after {hold:.2f} s, DAMPING after {damping:.2f} s, {observed}"


@fault(
    GraphBench,
    "parameters of all nodes out of range, during a movement",
    "each refused with the reason; the movement ends well",
    quick=False,
)
def parameters_out_of_range(bench: GraphBench) -> str:
    goal = bench.move(until=0.1)
    bad: dict[str, dict[str, bool | int | float | str]] = {
        "frame_tracker": {"rate": 5.0},
        "reproduction": {"speed": 9.0, "blend_time": -1.0},
        "impedance_controller": {"hold_time": -1.0},
        "baxter_simulator": {"command_timeout": 1e9},
    }
    reasons = {}
    for node, values in bad.items():
        result = set_parameters(bench.node, node, **values)
        assert not result.successful and result.reason, (node, result)
        reasons[node] = result.reason
    unknown = set_parameters(bench.node, "reproduction", retrieval="fortune")
    assert not unknown.successful and "fortune" in unknown.reason
    ended = bench.result(goal)
    assert ended.success, ended.reason
    return f"refused 5 of 5, e.g. '{reasons['impedance_controller']}'; {ended.reason}; {bench.assert_sound()}"
