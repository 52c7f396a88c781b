# SPDX-License-Identifier: Apache-2.0
"""What did not come in time is put down to a busy machine; nothing else is, and what is borne is borne."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node

from tpgmm_demos.demo.causes import (
    MAX_LOST_SHARE,
    MAX_TORQUE_AGE_MS,
    MIN_PERCEPTION_SHARE,
    cause_of_waiting_in_vain,
    machine_figures,
)
from tpgmm_ros.runtime.graph import Graph
from tpgmm_ros.runtime.processes import GraphError, GraphTimeoutError, NodeProcesses

NODES = ("reproduction", "impedance_controller", "baxter_simulator")


def borne(asked: int = 10_000) -> dict[str, Any]:
    """A run in real time with the worst of everything that counts as keeping up."""
    return {
        "lockstep": False,
        "ticks": {node: {"asked": asked, "done": asked - round(MAX_LOST_SHARE * asked)} for node in NODES},
        "torque_age_ms": {"p50": 1.0, "p99": MAX_TORQUE_AGE_MS},
        "perception": {"camera_hz": 30.0, "rate_hz": {"object": 30.0 * MIN_PERCEPTION_SHARE}},
    }


def test_what_is_just_borne_is_no_fault_of_the_machine_and_a_little_more_is() -> None:
    assert machine_figures(borne()) == []
    for node in NODES:
        late = borne()
        late["ticks"][node]["done"] -= 1
        assert len(machine_figures(late)) == 1 and node in machine_figures(late)[0]
    assert machine_figures(borne() | {"torque_age_ms": {"p50": 1.0, "p99": 1.01 * MAX_TORQUE_AGE_MS}})
    starved = {"camera_hz": 30.0, "rate_hz": {"object": 29.9 * MIN_PERCEPTION_SHARE}}
    assert machine_figures(borne() | {"perception": starved})


def test_nodes_that_had_no_time_to_say_what_they_did_are_named() -> None:
    figures = machine_figures(borne(asked=0))
    assert len(figures) == len(NODES) and all(node in text for node, text in zip(NODES, figures, strict=True))


@pytest.mark.parametrize("load", [3.5, 9.0, 120.0])
def test_a_wait_in_vain_on_a_busy_machine_names_its_load_and_what_to_do(load: float) -> None:
    cause = cause_of_waiting_in_vain(load, 2, lockstep=False)
    assert f"{load:.1f} programs" in cause and "2 cores" in cause and "--lockstep" in cause
    assert "--lockstep" not in cause_of_waiting_in_vain(load, 2, lockstep=True), "what is done already is no advice"


@pytest.mark.parametrize(("load", "cores"), [(0.0, 1), (2.0, 1), (3.0, 2), (9.0, 8)])
def test_a_machine_that_had_time_is_not_blamed(load: float, cores: int) -> None:
    assert cause_of_waiting_in_vain(load, cores, lockstep=False) == ""


def test_what_did_not_come_in_time_is_told_from_a_process_that_ended(ros_node: Node, tmp_path: Path) -> None:
    executor = SingleThreadedExecutor(context=ros_node.context)
    with NodeProcesses(tmp_path) as processes:
        graph = Graph(ros_node, executor, processes)
        with pytest.raises(GraphTimeoutError, match=r"waited 0\.1 s for a pose"):
            graph.wait_for(lambda: False, 0.1, "a pose")
        processes.start("no_such")  # ends at once: there is no such node
        with pytest.raises(GraphError, match="no_such ended with status 1") as ended:
            graph.wait_for(lambda: False, 120.0, "a pose")
        assert not isinstance(ended.value, GraphTimeoutError)
    executor.shutdown()
