# SPDX-License-Identifier: Apache-2.0
"""From object poses to a robot of your own: the loop in one process, started again where it ends.

By torques: ros2 launch tpgmm_ros loop.launch.py robot:=ROBOT.yaml task:=TASK.yaml model:=MODEL.tpgmm endpoint:=HAND
By positions: the same with controller:=joint_motion poses:=true, and outputs:="[positions]" or others
"""

from launch.actions import DeclareLaunchArgument
from launch.conditions import IfCondition
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import Node
from launch_ros.parameter_descriptions import ParameterValue

from launch import LaunchDescription


def generate_launch_description() -> LaunchDescription:
    """The nodes in one process, `compose`, and its arguments."""
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
            "controller",
            default_value="impedance_controller",
            choices=["impedance_controller", "joint_motion"],
            description="joint_motion for a robot that takes positions or poses instead of torques",
        ),
        DeclareLaunchArgument(
            "outputs", default_value="[joint_trajectory]", description="outputs of joint_motion, as a list"
        ),
        DeclareLaunchArgument("command_rate", default_value="100.0", description="rate of these outputs, Hz"),
        DeclareLaunchArgument(
            "poses",
            default_value="false",
            choices=["true", "false"],
            description="compute the poses of the end points, for a robot whose driver publishes only joint states",
        ),
        DeclareLaunchArgument(
            "autostart",
            default_value="true",
            description="configure and activate the nodes; false: a lifecycle manager does this",
        ),
        DeclareLaunchArgument(
            "realtime_priority",
            default_value="0",
            description="real-time priority (SCHED_FIFO), 1 to 99; 0: none",
        ),
    ]

    def given(name: str, kind: type) -> ParameterValue:
        return ParameterValue(LaunchConfiguration(name), value_type=kind)

    loop = Node(
        package="tpgmm_ros",
        executable="compose",
        arguments=["frame_tracker", "reproduction", LaunchConfiguration("controller")],
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
                "outputs": LaunchConfiguration("outputs"),  # read as YAML: a list
                "command_rate": given("command_rate", float),
                "autostart": given("autostart", bool),
                "realtime_priority": given("realtime_priority", int),
            }
        ],
    )
    endpoint_poses = Node(
        package="tpgmm_ros",
        executable="endpoint_poses",
        namespace=LaunchConfiguration("namespace"),
        output="screen",
        respawn=True,
        respawn_delay=2.0,
        condition=IfCondition(LaunchConfiguration("poses")),
        parameters=[{"robot_file": given("robot", str)}],
    )
    return LaunchDescription([*arguments, loop, endpoint_poses])
