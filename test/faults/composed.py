# SPDX-License-Identifier: Apache-2.0
"""The nodes from pose to torque in one process: what is promised of them apart holds here too."""

from __future__ import annotations

from typing import ClassVar

import numpy as np

from faults import processes
from faults.graph_bench import GraphBench
from faults.table import fault, rows_of
from ros_graph import ros_arguments
from ros_testing import RunningProcess
from tpgmm_core.control.supervision import ControllerMode

LOOP = ("frame_tracker", "reproduction", "impedance_controller")


class ComposedBench(GraphBench):
    """The graph with two processes: the loop, and the robot."""

    name: ClassVar[str] = "composed"

    def start(self, name: str) -> RunningProcess:
        """Start the robot, or all of the loop, unless it runs already."""
        if name not in LOOP:
            return super().start(name)
        if name not in self.processes or self.processes[name].returncode is not None:
            given = {f"{node}:{key}": value for node in LOOP for key, value in self.parameters[node].items()}
            self.processes |= dict.fromkeys(LOOP, self._start("compose", *LOOP, *ros_arguments(**given)))
        return self.processes[name]


for _row in rows_of(GraphBench):
    # Nodes of one process cannot be killed or suspended one by one
    if _row.run.__module__ != processes.__name__ or _row.run is processes.robot_killed:
        fault(ComposedBench, f"{_row.name}, in one process", _row.promise, quick=False)(_row.run)


@fault(
    ComposedBench,
    "SIGKILL of the process of the loop while the robot moves, and its restart",
    "the robot brakes after command_timeout (0.1 s), at braking_rate (20 1/s); the new loop takes a new goal",
    quick=False,
)
def loop_killed(bench: ComposedBench) -> str:
    bench.move(until=0.3)
    bench.wait(lambda: bench.speed() > 10 * processes.AT_REST, "the arm to move")
    bench.states.clear()
    bench.kill("impedance_controller")
    rest = bench.wait(lambda: bench.states.last and bench.speed() < processes.AT_REST, "rest")
    states = bench.states.messages
    way = float(np.ptp([message.position for message in states], axis=0).max())
    fastest = float(np.abs([message.velocity for message in states]).max())
    assert way < 2.0 * fastest * (processes.COMMAND_TIMEOUT + 1.0 / processes.BRAKING_RATE)
    bench.clear()
    bench.start("impedance_controller")
    bench.wait(lambda: bench.modes.last and bench.modes.last.state == ControllerMode.DAMPING, "the new controller")
    return f"at most at {fastest:.2f} rad/s, at rest after {rest:.2f} s and {way:.3f} rad"
