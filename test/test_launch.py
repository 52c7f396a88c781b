# SPDX-License-Identifier: Apache-2.0
"""The launch files, where a full ROS installation has the packages to evaluate them with."""

from __future__ import annotations

import importlib.util

import pytest

from ros_graph import ROOT
from ros_testing import executable

DIRECTORY = ROOT / "src" / "tpgmm_ros" / "launch"
#: File -> the executables that it starts, its arguments.
FILES = {
    "baxter_demo": (
        {"frame_tracker", "reproduction", "impedance_controller", "baxter_simulator"},
        {"model", "task", "robot", "use_sim_time"},
    ),
    "loop": (
        {"compose", "endpoint_poses"},
        {
            *("robot", "task", "model", "endpoint", "namespace", "joint_state_rate", "autostart", "realtime_priority"),
            *("controller", "outputs", "command_rate", "poses"),
        },
    ),
    "figure5": ({"joint_reference", "impedance_controller", "baxter_simulator"}, {"models", "active", "robot"}),
}


def test_every_launch_file_is_known_here() -> None:
    assert {path.name.removesuffix(".launch.py") for path in DIRECTORY.glob("*.launch.py")} == set(FILES)


@pytest.mark.parametrize("name", FILES)
def test_a_launch_file_names_executables_that_are_installed(name: str) -> None:
    text = (DIRECTORY / f"{name}.launch.py").read_text()
    compile(text, name, "exec")
    for node in FILES[name][0]:
        assert f'executable="{node}"' in text
        assert executable(node)


@pytest.mark.parametrize("name", FILES)
def test_a_launch_file_starts_its_nodes_and_takes_its_arguments(name: str) -> None:
    reason = "launch and launch_ros come with a full ROS installation only"
    pytest.importorskip("launch", reason=reason)
    pytest.importorskip("launch_ros", reason=reason)
    from launch.actions import DeclareLaunchArgument

    spec = importlib.util.spec_from_file_location(f"{name}_launch", DIRECTORY / f"{name}.launch.py")
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    entities = module.generate_launch_description().entities
    nodes, arguments = FILES[name]
    assert {item.name for item in entities if isinstance(item, DeclareLaunchArgument)} == arguments
    assert {item.node_executable for item in entities if hasattr(item, "node_executable")} == nodes
