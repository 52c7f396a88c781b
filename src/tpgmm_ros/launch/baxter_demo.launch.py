# SPDX-License-Identifier: Apache-2.0
"""The whole way from object poses to joint torques on a simulated Baxter.

ros2 launch tpgmm_ros baxter_demo.launch.py model:=/path/to/model.tpgmm
"""

from launch.actions import DeclareLaunchArgument, EmitEvent, RegisterEventHandler, SetEnvironmentVariable
from launch.events import matches_action
from launch.substitutions import EnvironmentVariable, LaunchConfiguration, PathJoinSubstitution
from launch_ros.actions import LifecycleNode, Node
from launch_ros.event_handlers import OnStateTransition
from launch_ros.events.lifecycle import ChangeState
from launch_ros.parameter_descriptions import ParameterValue
from launch_ros.substitutions import FindPackageShare
from lifecycle_msgs.msg import Transition

from launch import LaunchDescription, LaunchDescriptionEntity


def activated(node: LifecycleNode) -> list[LaunchDescriptionEntity]:
    """Start a lifecycle node, then configure and activate it."""

    def change_state(transition: int) -> EmitEvent:
        return EmitEvent(event=ChangeState(lifecycle_node_matcher=matches_action(node), transition_id=transition))

    # Only on the way up: a node that someone deactivates stays inactive
    activate_once_configured = RegisterEventHandler(
        OnStateTransition(
            target_lifecycle_node=node,
            start_state="configuring",
            goal_state="inactive",
            entities=[change_state(Transition.TRANSITION_ACTIVATE)],
        )
    )
    return [activate_once_configured, node, change_state(Transition.TRANSITION_CONFIGURE)]


def generate_launch_description() -> LaunchDescription:
    """The four nodes, the controlling ones brought up by this launch."""
    config = PathJoinSubstitution([FindPackageShare("tpgmm_ros"), "config"])
    arguments = [
        DeclareLaunchArgument("model", description="path of the model file (.tpgmm) that `train` wrote"),
        DeclareLaunchArgument(
            "task",
            default_value=PathJoinSubstitution([config, "pick_place.yaml"]),
            description="path of the task file: frames, their topics, the end point that moves",
        ),
        DeclareLaunchArgument(
            "robot",
            default_value=PathJoinSubstitution([config, "baxter.yaml"]),
            description="path of the robot file: URDF, joint groups, limits, friction",
        ),
        DeclareLaunchArgument(
            "use_sim_time",
            default_value="false",
            choices=["true", "false"],
            description="run the simulator in lockstep; it publishes /clock, which the stamps of poses must use",
        ),
    ]
    clock = {"use_sim_time": ParameterValue(LaunchConfiguration("use_sim_time"), value_type=bool)}
    task = {"task_file": LaunchConfiguration("task")}
    robot = {"robot_file": LaunchConfiguration("robot")}
    model = {"model_file": LaunchConfiguration("model")}

    frame_tracker = Node(
        package="tpgmm_ros",
        executable="frame_tracker",
        name="frame_tracker",
        output="screen",
        parameters=[task, clock],
    )
    baxter_simulator = Node(
        package="tpgmm_ros",
        executable="baxter_simulator",
        name="baxter_simulator",
        output="screen",
        # a clock that nobody else would publish
        parameters=[robot, {"lockstep": clock["use_sim_time"]}],
    )
    reproduction = LifecycleNode(
        package="tpgmm_ros",
        executable="reproduction",
        name="reproduction",
        namespace="",
        output="screen",
        parameters=[model, task, clock],
    )
    impedance_controller = LifecycleNode(
        package="tpgmm_ros",
        executable="impedance_controller",
        name="impedance_controller",
        namespace="",
        output="screen",
        parameters=[robot, clock],
    )
    discovery = "ROS_AUTOMATIC_DISCOVERY_RANGE"
    this_machine = SetEnvironmentVariable(discovery, EnvironmentVariable(discovery, default_value="LOCALHOST"))
    return LaunchDescription(
        [
            *arguments,
            this_machine,
            baxter_simulator,
            frame_tracker,
            *activated(reproduction),
            *activated(impedance_controller),
        ]
    )
