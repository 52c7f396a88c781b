# SPDX-License-Identifier: Apache-2.0
"""The launch files, where a full ROS installation has the packages to evaluate them with."""

from __future__ import annotations

import importlib
import importlib.util

import pytest

from ros_graph import ROOT
from ros_testing import executable
from tpgmm_ros.runtime.loop_description import ARGUMENTS, loop_processes

DIRECTORY = ROOT / "src" / "tpgmm_ros" / "launch"
#: File -> the executables that it starts, its arguments.
FILES = {
    "baxter_demo": (
        {"frame_tracker", "reproduction", "impedance_controller", "baxter_simulator"},
        {"model", "task", "robot", "use_sim_time"},
    ),
    "loop": ({"compose", "endpoint_poses"}, {argument.name for argument in ARGUMENTS}),
    "figure5": ({"joint_reference", "impedance_controller", "baxter_simulator"}, {"models", "active", "robot"}),
}
#: What the loop cannot do without, and what starts both of its processes.
GIVEN = {"robot": "robot.yaml", "task": "task.yaml", "model": "a.tpgmm", "poses": "true"}


def test_every_launch_file_is_known_here() -> None:
    assert {path.name.removesuffix(".launch.py") for path in DIRECTORY.glob("*.launch.py")} == set(FILES)


@pytest.mark.parametrize("name", FILES)
def test_a_launch_file_names_executables_that_are_installed(name: str) -> None:
    text = (DIRECTORY / f"{name}.launch.py").read_text()
    compile(text, name, "exec")
    for node in FILES[name][0]:
        assert f'executable="{node}"' in text or name == "loop"
        assert executable(node)
    assert {process.executable for process in loop_processes(GIVEN)} == FILES["loop"][0]


def test_the_loop_gives_parameters_that_its_nodes_have_with_their_own_defaults() -> None:
    """A misspelt name is passed over in silence where the nodes are started."""
    nodes = ("frame_tracker", "reproduction", "impedance_controller", "joint_motion", "endpoint_poses")
    declared = {
        item.name: item for node in nodes for item in importlib.import_module(f"tpgmm_ros.nodes.{node}").PARAMETERS
    }
    for process in loop_processes(GIVEN):
        given = dict(process.parameters)
        for name in ("realtime_priority", "use_sim_time"):  # of the process; of every node of ROS
            given.pop(name, None)
        assert given.keys() <= declared.keys()
        for name, value in given.items():
            if not name.endswith("_file") and name != "autostart":  # a launch file starts its nodes by itself
                assert value == declared[name].default, name


def test_the_home_folder_is_known_where_a_shell_leaves_it_as_it_is(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("HOME", "/home/ann")
    assert loop_processes(GIVEN | {"parameters": "~/more.yaml"})[0].parameter_file == "/home/ann/more.yaml"


def test_the_loop_starts_what_its_arguments_say() -> None:
    loop, poses = loop_processes(
        GIVEN
        | {"controller": "joint_motion", "outputs": "[positions, servo_pose]", "namespace": "left", "horizon": "0.1"}
        | {"parameters": "more.yaml", "remap": "[joint_states:=arm/joint_states]"}
    )
    words = loop.command()
    assert words[0] == executable("compose") and words[1:5] == [
        *("frame_tracker", "reproduction", "joint_motion", "--ros-args")
    ]
    for part in (
        ["-p", "outputs:=[positions, servo_pose]"],
        ["-p", "horizon:=0.1"],
        ["-p", "autostart:=true"],
        ["--params-file", "more.yaml"],
        ["-r", "__ns:=/left"],
        ["-r", "joint_states:=arm/joint_states"],
    ):
        assert any(words[i : i + 2] == part for i in range(len(words))), part
    assert poses.command()[1:4] == ["--ros-args", "-p", "robot_file:=robot.yaml"]
    assert [process.executable for process in loop_processes(GIVEN | {"poses": "false"})] == ["compose"]


@pytest.mark.parametrize(
    ("given", "reason"),
    [
        ({"robots": "a.yaml"}, "there is no argument robots"),
        ({"controller": "mine"}, "controller is 'mine'; expected one of impedance_controller, joint_motion"),
        ({"command_rate": "fast"}, "command_rate is 'fast': could not convert"),
        ({"outputs": "positions"}, "outputs is 'positions': a list of names"),
    ],
)
def test_arguments_of_the_loop_that_make_no_sense_are_refused(given: dict[str, str], reason: str) -> None:
    with pytest.raises(ValueError, match=reason):
        loop_processes(GIVEN | given)
    with pytest.raises(ValueError, match="model is missing: path of the model file"):
        loop_processes({"robot": "robot.yaml", "task": "task.yaml"})


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
    if name == "loop":  # its nodes depend on the values of its arguments
        context = importlib.import_module("launch").LaunchContext()
        context.launch_configurations.update({item.name: item.default or "" for item in ARGUMENTS} | GIVEN)
        entities = module.nodes(context)
    assert {item.node_executable for item in entities if hasattr(item, "node_executable")} == nodes
