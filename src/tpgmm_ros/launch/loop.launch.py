# SPDX-License-Identifier: Apache-2.0
"""From object poses to joint torques on a robot of your own: the loop in one process, started again where it ends.

ros2 launch tpgmm_ros loop.launch.py robot:=ROBOT.yaml task:=TASK.yaml model:=MODEL.tpgmm
"""

from launch.actions import DeclareLaunchArgument
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import Node
from launch_ros.parameter_descriptions import ParameterValue

from launch import LaunchDescription


def generate_launch_description() -> LaunchDescription:
    arguments = [
        DeclareLaunchArgument("robot", description="path of the robot file: URDF, joint groups, limits"),
        DeclareLaunchArgument(
            "task", description="path of the task file: frames, their topics, the end point that moves"
        ),
        DeclareLaunchArgument("model", description="path of the model file (.tpgmm) that `train` wrote"),
        DeclareLaunchArgument("endpoint", default_value="left", description="end point of the robot file that moves"),
        DeclareLaunchArgument("namespace", default_value="", description="namespace of the nodes and their topics"),
        DeclareLaunchArgument(
            "joint_state_rate",
            default_value="1000.0",
            description="joint states per second that the robot publishes, Hz",
        ),
        DeclareLaunchArgument(
            "autostart",
            default_value="true",
            description="configure and activate the nodes; false: leave that to a lifecycle manager",
        ),
        DeclareLaunchArgument(
            "realtime_priority",
            default_value="0",
            description="run ahead of ordinary programs (SCHED_FIFO), 1 to 99; 0: no",
        ),
    ]

    def given(name: str, kind: type) -> ParameterValue:
        return ParameterValue(LaunchConfiguration(name), value_type=kind)

    loop = Node(
        package="tpgmm_ros",
        executable="compose",
        arguments=["frame_tracker", "reproduction", "impedance_controller"],
        namespace=LaunchConfiguration("namespace"),
        output="screen",
        # The robot's own watchdog acts meanwhile; what comes back waits for a new goal
        respawn=True,
        respawn_delay=2.0,
        parameters=[
            {
                "robot_file": given("robot", str),
                "task_file": given("task", str),
                "model_file": given("model", str),
                "endpoint": given("endpoint", str),
                "joint_state_rate": given("joint_state_rate", float),
                "autostart": given("autostart", bool),
                "realtime_priority": given("realtime_priority", int),
            }
        ],
    )
    return LaunchDescription([*arguments, loop])
