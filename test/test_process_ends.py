# SPDX-License-Identifier: Apache-2.0
"""How the nodes start and end as processes: exit statuses, and one line that says why."""

from __future__ import annotations

import signal
from pathlib import Path

import pytest
from rclpy.node import Node

from ros_graph import ROBOT_FILE, TASK_FILE, ros_arguments
from ros_testing import StartProcess, executable, spin_until

NODES: dict[str, dict[str, object]] = {
    "frame_tracker": {"task_file": TASK_FILE},
    "baxter_simulator": {"robot_file": ROBOT_FILE},
    "reproduction": {"task_file": TASK_FILE, "autostart": True},
    "impedance_controller": {"robot_file": ROBOT_FILE, "autostart": True},
}


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGINT], ids=lambda number: number.name)
def test_every_node_ends_with_status_0_when_it_is_told_to(
    ros_node: Node, start_process: StartProcess, number: signal.Signals
) -> None:
    processes = {
        name: start_process(executable(name), *ros_arguments(**parameters)) for name, parameters in NODES.items()
    }
    spin_until(
        ros_node,
        lambda: (
            set(processes) <= set(ros_node.get_node_names())
            and ros_node.count_publishers("joint_torques") > 0
            and ros_node.count_publishers("reference") > 0
        ),
        message="all nodes to be there",
        processes=tuple(processes.values()),
    )
    for process in processes.values():
        process.send_signal(number)
    assert {name: process.wait(20.0) for name, process in processes.items()} == dict.fromkeys(processes, 0)
    for process in processes.values():
        assert "Traceback" not in process.output, process.output


def test_a_node_that_cannot_start_ends_with_status_1_and_says_why_in_one_line(
    ros_domain: int, start_process: StartProcess, tmp_path: Path
) -> None:
    task = tmp_path / "task.yaml"
    task.write_text("name: broken\nframes: {}\n")
    cases = {
        ("frame_tracker", "task_file", task): "lacks the key",
        ("frame_tracker", "task_file", tmp_path / "nowhere.yaml"): "nowhere.yaml",
        ("baxter_simulator", "robot_file", tmp_path / "nowhere.yaml"): "nowhere.yaml",
        ("reproduction", "task_file", task): "lacks the key",
        ("impedance_controller", "robot_file", tmp_path / "nowhere.yaml"): "nowhere.yaml",
    }
    processes = {}
    for name, parameter, path in cases:
        lifecycle = {"autostart": True} if "autostart" in NODES[name] else {}
        processes[name, parameter, path] = start_process(
            executable(name), *ros_arguments(**{parameter: path}, **lifecycle)
        )
    out_of_range = start_process(executable("baxter_simulator"), *ros_arguments(robot_file=ROBOT_FILE, rate=1.0))
    for case, process in processes.items():
        assert process.wait(30.0) == 1, process
        assert cases[case] in process.output
        assert "Traceback" not in process.output, process.output
    assert out_of_range.wait(30.0) == 1
    assert "rate" in out_of_range.output and "Traceback" not in out_of_range.output
