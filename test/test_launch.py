# SPDX-License-Identifier: Apache-2.0
"""The launch files, where a full ROS installation has the packages to evaluate them with."""

from __future__ import annotations

import ast
import importlib
import importlib.util

import pytest
import yaml

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
            *("controller", "law", "horizon_steps", "horizon_time_step", "outputs", "command_rate", "poses"),
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


def test_the_loop_gives_parameters_that_its_nodes_have_with_their_own_defaults() -> None:
    """Read from the text, since a misspelt name is passed over in silence where the nodes are started."""
    nodes = ("frame_tracker", "reproduction", "impedance_controller", "joint_motion", "endpoint_poses")
    declared = {
        item.name: item for node in nodes for item in importlib.import_module(f"tpgmm_ros.nodes.{node}").PARAMETERS
    }
    given, defaults = set(), {}
    for item in ast.walk(ast.parse((DIRECTORY / "loop.launch.py").read_text())):
        if isinstance(item, ast.Dict):
            given |= {ast.literal_eval(key) for key in item.keys if key is not None}
        if isinstance(item, ast.Call) and getattr(item.func, "id", "") == "DeclareLaunchArgument":
            values = [keyword.value for keyword in item.keywords if keyword.arg == "default_value"]
            defaults[ast.literal_eval(item.args[0])] = [yaml.safe_load(ast.literal_eval(value)) for value in values]
    given -= {"realtime_priority"}  # of the process, not of a node
    assert {"law", "horizon_steps", "horizon_time_step"} <= given <= set(declared), given - set(declared)
    for name in given & set(defaults) - {"autostart"}:  # a launch file starts its nodes by itself
        assert defaults[name] in ([], [declared[name].default]), name


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
