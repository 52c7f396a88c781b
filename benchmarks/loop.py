# SPDX-License-Identifier: Apache-2.0
"""The 1 kHz loop in real time during one movement: ticks that were kept, torques' age, and what it takes of a core.

The nodes are apart or in one process, on an idle machine or beside two busy programs (`graph.CASES`).
"""

from __future__ import annotations

import os
import sys
import time
from pathlib import Path

from diagnostic_msgs.msg import DiagnosticArray

from benchmarks.graph import CASES, Scene, running
from benchmarks.report import without_options, write_report
from tpgmm_core.common.report import Row

LOOP = ("frame_tracker", "reproduction", "impedance_controller")
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
        """Forget what was said so far."""
        self.rows.clear()

    def _take(self, array: DiagnosticArray) -> None:
        for status in array.status:
            self.rows.setdefault(status.name, []).append({item.key: item.value for item in status.values})


def measure(scene: Scene) -> tuple[Counters, bool]:
    """What the nodes say of themselves during one movement, and whether it succeeded."""
    counters = Counters(scene)

    def forget_the_start() -> None:
        counters.clear()
        timer.cancel()

    timer = scene.node.create_timer(BEGIN, forget_the_start)
    outcome = scene.reproduce(DURATION)
    print(f"movement: {outcome.reason}")
    return counters, outcome.success


def ticks(counters: Counters, case: str, node: str, to_reach: float) -> Row:
    """Ticks of a node, and its time per step."""
    first, last = counters.rows[node][0], counters.rows[node][-1]
    asked, done = (int(last[key]) - int(first[key]) for key in ("ticks_asked", "ticks_done"))
    steps = {key: float(last[key]) for key in ("step_p50_ms", "step_p99_ms")}
    return {
        "case": case,
        "node": node,
        "asked": asked,
        "done": done,
        "share": done / asked,
        **steps,
        "passed": done >= to_reach * asked,
    }


def torque_age(counters: Counters, case: str, bound: float) -> Row:
    """Age of the joint state that the torques answer, when the simulator applies them."""
    last = counters.rows["baxter_simulator"][-1]
    ages = {key: float(last[key]) for key in ("age_p50_ms", "age_p99_ms")}
    return {"case": case, **ages, "passed": ages["age_p99_ms"] <= bound}


def cpu_seconds(scene: Scene) -> float:
    """Processor time of the nodes from pose to torque so far, s."""
    times = 0.0
    for pid in {scene.graph.processes.pid(name) for name in LOOP}:
        fields = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
        times += (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")
    return times


if __name__ == "__main__":
    without_options(__doc__)
    outcomes: list[Row] = []
    shares: list[Row] = []
    ages: list[Row] = []
    cpu: list[Row] = []
    for name, together, load in CASES:
        with running(together, load) as running_scene:
            running_scene.run_for(2.0)
            before, began = cpu_seconds(running_scene), time.monotonic()
            result, success = measure(running_scene)
            used = (cpu_seconds(running_scene) - before) / (time.monotonic() - began)
        shares += [ticks(result, name, node, 0.99 if load else 0.999) for node in NODES]
        ages.append(torque_age(result, name, 3.0 if load else 2.0))
        cpu.append({"case": name, "cores": used, "passed": used <= 0.6 if together else None})
        outcomes.append({"case": name, "passed": success})
    status = write_report("loop_movements", outcomes) | write_report("loop", shares)
    sys.exit(status | write_report("torque_age", ages) | write_report("loop_cpu", cpu))
