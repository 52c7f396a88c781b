# SPDX-License-Identifier: Apache-2.0
"""The launch file, where a full ROS installation has the packages to evaluate it with."""

from __future__ import annotations

import importlib.util

import pytest

from ros_graph import ROOT
from ros_testing import executable

FILE = ROOT / "src" / "tpgmm_ros" / "launch" / "baxter_demo.launch.py"
NODES = {"frame_tracker", "reproduction", "impedance_controller", "baxter_simulator"}


def test_the_launch_file_names_executables_that_are_installed() -> None:
    text = FILE.read_text()
    for name in NODES:
        assert f'executable="{name}"' in text
        assert executable(name)


def test_the_launch_file_starts_the_four_nodes_and_takes_its_arguments() -> None:
    reason = "launch and launch_ros come with a full ROS installation only"
    pytest.importorskip("launch", reason=reason)
    pytest.importorskip("launch_ros", reason=reason)
    from launch.actions import DeclareLaunchArgument

    spec = importlib.util.spec_from_file_location("baxter_demo_launch", FILE)
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    entities = module.generate_launch_description().entities
    arguments = {item.name for item in entities if isinstance(item, DeclareLaunchArgument)}
    assert arguments == {"model", "task", "robot", "use_sim_time"}
    assert {item.node_executable for item in entities if hasattr(item, "node_executable")} == NODES
