# SPDX-License-Identifier: Apache-2.0
"""From object poses to a robot of your own: the loop in one process, started again where it ends.

By torques: ros2 launch tpgmm_ros loop.launch.py robot:=ROBOT.yaml task:=TASK.yaml model:=MODEL.tpgmm endpoint:=HAND
By positions: the same with controller:=joint_motion poses:=true, and outputs:="[positions]" or others
What is started is in tpgmm_ros/runtime/loop_description.py.
"""

from launch.actions import DeclareLaunchArgument, OpaqueFunction
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import Node

from launch import LaunchContext, LaunchDescription
from tpgmm_ros.runtime.loop_description import ARGUMENTS, PACKAGE, loop_processes


def nodes(context: LaunchContext) -> list[Node]:
    """The processes for the arguments as given."""
    given = {argument.name: LaunchConfiguration(argument.name).perform(context) for argument in ARGUMENTS}
    return [
        Node(
            package=PACKAGE,
            executable=process.executable,
            arguments=list(process.arguments),
            namespace=process.namespace,
            remappings=[tuple(item.split(":=", 1)) for item in process.remappings],
            output="screen",
            # The robot's own watchdog acts meanwhile; what comes back waits for a new goal
            respawn=True,
            respawn_delay=2.0,
            parameters=[dict(process.parameters), *([process.parameter_file] if process.parameter_file else [])],
        )
        for process in loop_processes(given)
    ]


def generate_launch_description() -> LaunchDescription:
    """The arguments, and what follows from them."""
    arguments = [
        DeclareLaunchArgument(
            argument.name,
            default_value=argument.default,
            description=argument.description,
            choices=list(argument.choices) or None,
        )
        for argument in ARGUMENTS
    ]
    return LaunchDescription([*arguments, OpaqueFunction(function=nodes)])
