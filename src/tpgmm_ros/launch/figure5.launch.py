# SPDX-License-Identifier: Apache-2.0
"""The nodes of Figure 5 in real time: a simulated Baxter that holds a cup level, and a sugar cube above it.

ros2 launch tpgmm_ros figure5.launch.py models:=out/figure5
ros2 param set /joint_reference active hold_cup             (or hold_sugar, hold_cup,hold_sugar, or nothing)

The models are those that `figure5` learns. Push the robot by wrenches on `external_wrench`.
"""

from launch.actions import DeclareLaunchArgument
from launch.substitutions import LaunchConfiguration, PathJoinSubstitution
from launch_ros.actions import Node
from launch_ros.substitutions import FindPackageShare

from launch import LaunchDescription

TASKS = ("hold_cup", "hold_sugar")


def generate_launch_description() -> LaunchDescription:
    """The simulator, the task references and the controller, each in a process."""
    config = PathJoinSubstitution([FindPackageShare("tpgmm_ros"), "config"])
    models, robot = LaunchConfiguration("models"), {"robot_file": LaunchConfiguration("robot")}
    return LaunchDescription(
        [
            DeclareLaunchArgument("models", description="directory with the models that `figure5` learned"),
            DeclareLaunchArgument(
                "active",
                default_value=",".join(TASKS),
                description="tasks that are active at first, separated by commas",
            ),
            DeclareLaunchArgument(
                "robot",
                default_value=PathJoinSubstitution([config, "baxter.yaml"]),
                description="path of the robot file: URDF, joint groups, limits, friction",
            ),
            Node(
                package="tpgmm_ros",
                executable="joint_reference",
                parameters=[
                    robot,
                    {
                        "task_files": [PathJoinSubstitution([config, f"{name}.yaml"]) for name in TASKS],
                        "model_files": [PathJoinSubstitution([models, f"{name}.tpgmm"]) for name in TASKS],
                        "active": LaunchConfiguration("active"),
                    },
                ],
            ),
            Node(
                package="tpgmm_ros",
                executable="impedance_controller",
                # the law of the program `figure5`: soft enough for what wrists can bear
                parameters=[robot, {"autostart": True, "joint_control_cost": 1.0}],
            ),
            Node(package="tpgmm_ros", executable="baxter_simulator", parameters=[robot]),
        ]
    )
