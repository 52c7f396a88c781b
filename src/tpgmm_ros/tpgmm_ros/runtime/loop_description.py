# SPDX-License-Identifier: Apache-2.0
"""What `loop.launch.py` starts, as data: its arguments, and which processes follow from them.

The launch file hands this to `launch`; programs without it start the same processes by their commands.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import yaml
from ament_index_python.packages import get_package_prefix

from tpgmm_core.common.text import listed, shown

PACKAGE = "tpgmm_ros"


def _truth(text: str) -> bool:
    if text not in ("true", "false"):
        raise ValueError("true or false")
    return text == "true"


def _names(text: str) -> list[str]:
    value = yaml.safe_load(text)
    if not isinstance(value, list) or not all(isinstance(item, str) for item in value):
        raise ValueError("a list of names, such as [a, b]")
    return value


@dataclass(frozen=True, slots=True)
class LoopArgument:
    """An argument of the launch file.

    Attributes
    ----------
    name, description
        of the argument
    default
        as it is written; None: it has to be given
    read
        the text as a value; raises ValueError where it is none
    choices
        what it may be; empty: anything
    is_parameter
        whether it is a parameter of nodes, of the same name
    """

    name: str
    description: str
    default: str | None = None
    read: Callable[[str], Any] = str
    choices: tuple[str, ...] = ()
    is_parameter: bool = True


ARGUMENTS = (
    LoopArgument("robot", "path of the robot file: URDF, joint groups, limits", is_parameter=False),
    LoopArgument("task", "path of the task file: frames, their topics, the end point that moves", is_parameter=False),
    LoopArgument("model", "path of the model file (.tpgmm) that `train` wrote", is_parameter=False),
    LoopArgument("endpoint", "end point of the robot file that moves", "left"),
    LoopArgument("namespace", "namespace of the nodes and their topics", "", is_parameter=False),
    LoopArgument("joint_state_rate", "joint states per second that the robot publishes, Hz", "1000.0", float),
    LoopArgument(
        "controller",
        "joint_motion for a robot that takes positions or poses instead of torques",
        "impedance_controller",
        choices=("impedance_controller", "joint_motion"),
        is_parameter=False,
    ),
    LoopArgument(
        "law", "control law of the impedance_controller; those that look ahead need a horizon", "infinite_horizon"
    ),
    LoopArgument("horizon_steps", "how many Gaussians ahead each reference holds", "1", int),
    LoopArgument("horizon_time_step", "time between the Gaussians ahead, s", "0.005", float),
    LoopArgument("outputs", "outputs of joint_motion, as a list", "[joint_trajectory]", _names),
    LoopArgument("command_rate", "rate of these outputs, Hz", "100.0", float),
    LoopArgument("horizon", "time that the robot has to reach the first point of a trajectory, s", "0.03", float),
    LoopArgument(
        "poses",
        "compute the poses of the end points, for a robot whose driver publishes only joint states",
        "false",
        _truth,
        ("true", "false"),
        is_parameter=False,
    ),
    LoopArgument(
        "autostart",
        "configure and activate the nodes; false: a lifecycle manager does this",
        "true",
        _truth,
        ("true", "false"),
    ),
    LoopArgument(
        "use_sim_time", "take the time from /clock, which a simulator publishes", "false", _truth, ("true", "false")
    ),
    LoopArgument("realtime_priority", "real-time priority (SCHED_FIFO), 1 to 99; 0: none", "0", int),
    LoopArgument(
        "parameters",
        "path of a file of parameters (YAML) for what has no argument here; empty: none",
        "",
        os.path.expanduser,
        is_parameter=False,
    ),
    LoopArgument(
        "remap", "topics by other names, as a list: [joint_states:=arm/joint_states]", "[]", _names, is_parameter=False
    ),
)
#: Parameters that have another name than their argument.
_FILES = {"robot_file": "robot", "task_file": "task", "model_file": "model"}
#: Parameters of `endpoint_poses`.
_OF_POSES = ("robot_file", "use_sim_time")


@dataclass(frozen=True, slots=True)
class LoopProcess:
    """One process of the loop.

    Attributes
    ----------
    executable
        of this package
    arguments
        before those of ROS
    parameters
        of all of its nodes that have them
    parameter_file
        more of them; empty: none
    namespace
        of its nodes
    remappings
        of topics, each FROM:=TO
    """

    executable: str
    arguments: tuple[str, ...]
    parameters: Mapping[str, Any]
    parameter_file: str = ""
    namespace: str = ""
    remappings: tuple[str, ...] = ()

    def command(self) -> list[str]:
        """The words that start it without `launch`."""
        words = [str(Path(get_package_prefix(PACKAGE), "lib", PACKAGE, self.executable)), *self.arguments]
        words.append("--ros-args")
        for name, value in self.parameters.items():
            words += ["-p", f"{name}:={_written(value)}"]
        words += ["--params-file", self.parameter_file] if self.parameter_file else []
        words += ["-r", f"__ns:=/{self.namespace.lstrip('/')}"] if self.namespace else []
        for remapping in self.remappings:
            words += ["-r", remapping]
        return words


def loop_processes(given: Mapping[str, str]) -> list[LoopProcess]:
    """The processes that the launch file starts.

    Parameters
    ----------
    given
        arguments as they are written, NAME to VALUE; those that are missing have their defaults

    Returns
    -------
    list[LoopProcess]
        the nodes in one process, `compose`; and `endpoint_poses` where it was asked for

    Raises
    ------
    ValueError
        an argument that there is not, that is missing, or that has no such value.
    """
    unknown = given.keys() - {argument.name for argument in ARGUMENTS}
    if unknown:
        raise ValueError(
            f"there is no argument {listed(sorted(unknown))}; there are {listed(a.name for a in ARGUMENTS)}"
        )
    values = {argument.name: _value(argument, given) for argument in ARGUMENTS}
    files = {parameter: values[argument] for parameter, argument in _FILES.items()}
    shared = {
        "parameter_file": values["parameters"],
        "namespace": values["namespace"],
        "remappings": tuple(values["remap"]),
    }
    nodes = ("frame_tracker", "reproduction", values["controller"])
    parameters = files | {argument.name: values[argument.name] for argument in ARGUMENTS if argument.is_parameter}
    processes = [LoopProcess("compose", nodes, parameters, **shared)]
    if values["poses"]:
        processes.append(LoopProcess("endpoint_poses", (), {name: parameters[name] for name in _OF_POSES}, **shared))
    return processes


def _value(argument: LoopArgument, given: Mapping[str, str]) -> Any:
    text = given.get(argument.name, argument.default)
    if text is None:
        raise ValueError(f"{argument.name} is missing: {argument.description}")
    if argument.choices and text not in argument.choices:
        raise ValueError(f"{argument.name} is {shown(text)}; expected one of {listed(argument.choices)}")
    try:
        return argument.read(text)
    except (ValueError, yaml.YAMLError) as error:
        raise ValueError(f"{argument.name} is {shown(text)}: {error}") from None


def _written(value: Any) -> str:
    if isinstance(value, Sequence) and not isinstance(value, str):
        return f"[{', '.join(value)}]"
    return str(value).lower() if isinstance(value, bool) else str(value)
