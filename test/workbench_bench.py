# SPDX-License-Identifier: Apache-2.0
"""A desk and its nodes, with a simulated robot, served until something is so; and projects that were taught before."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

from rclpy.node import Node
from rclpy.parameter import Parameter

from tpgmm_core.common.types import Array
from tpgmm_core.geometry.pose import pose_error
from tpgmm_ros.runtime.processes import NodeProcesses
from tpgmm_workbench.desk.desk import Desk
from tpgmm_workbench.desk.view import DeskView
from tpgmm_workbench.project.project import Project
from tpgmm_workbench.simulated import start_nodes

PATIENCE = 120.0
#: A hand that stays within this, m, for so long, s of simulated time, stands still: what one shows ends in rest.
STILL, REST = 0.001, 0.3


class Bench:
    """A desk and its nodes, served until something is so."""

    def __init__(self, node: Node, desk: Desk, processes: NodeProcesses) -> None:
        self.node, self.desk, self._processes = node, desk, processes

    def until(self, condition: Callable[[DeskView], object], what: str, timeout: float = PATIENCE) -> DeskView:
        executor, deadline, due = self.node.executor, time.monotonic() + timeout, 0.0
        assert executor is not None
        while True:
            executor.spin_once(timeout_sec=0.01)
            if time.monotonic() < due:
                continue
            due = time.monotonic() + 0.03
            view = self.desk.look()
            if condition(view):
                return view
            self._processes.check()
            said = (view.words, view.run, view.coached)
            assert time.monotonic() < deadline, f"not within {timeout} s: {what}; said: {said}"

    def look_ahead(self, duration: float) -> DeskView:
        """See where a movement of this duration (s) would go."""
        self.desk.set_duration(duration)
        self.desk.preview()
        return self.until(
            lambda view: view.preview is not None and view.preview.times[-1] == duration, f"a preview of {duration} s"
        )

    def lead(self, name: str, above: bool = False) -> DeskView:
        """Lead the hand to a place, until it stands still there."""
        self.desk.table.lead_to(name, above)
        rest: list[tuple[float, Array]] = []

        def stands_there(view: DeskView) -> bool:
            hand, now = view.graph.hand, 1e-9 * self.node.get_clock().now().nanoseconds
            if hand is None or view.to_go is None or view.to_go >= 0.008:
                return False
            if not rest or pose_error(hand, rest[0][1])[0] > STILL:
                rest[:] = [(now, hand)]
            return now - rest[0][0] > REST

        return self.until(stands_there, f"the hand to stand still at {name}")


@contextmanager
def served(node: Node, project: Project, logs: Path, coach_force: float = 0.0) -> Iterator[Bench]:
    """Start the nodes of a project, 250 joint states per second, and a desk."""
    with NodeProcesses(logs) as processes:
        start_nodes(processes, project, 250.0, coach_force)
        node.set_parameters([Parameter("use_sim_time", value=True)])
        desk = Desk(node, project, simulated=True, seed=3, coach_force=coach_force)
        try:
            yield Bench(node, desk, processes)
        finally:
            desk.close()
