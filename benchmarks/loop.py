# SPDX-License-Identifier: Apache-2.0
"""The 1 kHz loop: reproduction, controller and simulator as separate processes in real time, during one movement."""

from __future__ import annotations

from diagnostic_msgs.msg import DiagnosticArray

from benchmarks.graph import Scene, running
from benchmarks.report import write_report

NODES = ("reproduction", "impedance_controller", "baxter_simulator")
DURATION = 15.0
#: What comes before this time of the movement does not count, s
BEGIN = 1.5


class Counters:
    """What each node says once a second about its ticks."""

    def __init__(self, scene: Scene) -> None:
        self.rows: dict[str, list[dict[str, str]]] = {}
        scene.node.create_subscription(DiagnosticArray, "/diagnostics", self._take, 10)

    def clear(self) -> None:
        self.rows.clear()

    def _take(self, array: DiagnosticArray) -> None:
        for status in array.status:
            self.rows.setdefault(status.name, []).append({item.key: item.value for item in status.values})


def measure(scene: Scene) -> Counters:
    """What the nodes say of themselves during one movement."""
    counters = Counters(scene)

    def forget_the_start() -> None:
        counters.clear()
        timer.cancel()

    timer = scene.node.create_timer(BEGIN, forget_the_start)
    outcome = scene.reproduce(DURATION)
    print(f"movement: {outcome.reason}")
    return counters


def ticks(counters: Counters, node: str) -> dict[str, str | float | bool]:
    """Ticks of a node, and its time per step."""
    first, last = counters.rows[node][0], counters.rows[node][-1]
    asked, done = (int(last[key]) - int(first[key]) for key in ("ticks_asked", "ticks_done"))
    steps = {key: float(last[key]) for key in ("step_p50_ms", "step_p99_ms")}
    return {"node": node, "asked": asked, "done": done, "share": done / asked, **steps, "passed": done >= 0.99 * asked}


def torque_age(counters: Counters) -> dict[str, str | float | bool]:
    """Age of the joint state that the torques answer, when the simulator applies them."""
    last = counters.rows["baxter_simulator"][-1]
    ages = {key: float(last[key]) for key in ("age_p50_ms", "age_p99_ms")}
    return {"what": "torque age", **ages, "passed": ages["age_p99_ms"] <= 3.0}


if __name__ == "__main__":
    with running() as running_scene:
        running_scene.run_for(2.0)
        result = measure(running_scene)
    write_report("loop", [ticks(result, node) for node in NODES])
    write_report("torque_age", [torque_age(result)])
