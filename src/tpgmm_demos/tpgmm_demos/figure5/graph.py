# SPDX-License-Identifier: Apache-2.0
"""The nodes of the experiment: a domain of their own, the controller, and what computes its references."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

from rcl_interfaces.msg import Parameter as ParameterMessage
from rcl_interfaces.msg import ParameterType, ParameterValue
from rcl_interfaces.srv import SetParameters

from tpgmm_core.robot.model import RobotModel
from tpgmm_demos.figure5.measures import LAW
from tpgmm_demos.figure5.session import START_TIMEOUT, Session
from tpgmm_ros.runtime.graph import open_graph, own_domain
from tpgmm_ros.runtime.processes import REALTIME_PRIORITY, GraphError
from tpgmm_ros.runtime.resources import config_file
from tpgmm_ros.runtime.scheduling import end_realtime, request_realtime


@contextmanager
def open_session(robot: RobotModel, log_directory: Path, lockstep: bool) -> Iterator[Session]:
    """A session on a ROS domain that nobody else uses; its nodes end with it.

    In real time the program runs ahead of ordinary ones, as its nodes do: a teacher who comes late shakes the arm.

    Parameters
    ----------
    robot
        that is simulated
    log_directory
        of the nodes' logs
    lockstep
        simulated time, as fast as all can; else real time

    Yields
    ------
    Session
        the running graph
    """
    with own_domain(), open_graph("figure5", log_directory, use_sim_time=lockstep) as graph:
        refused = "" if lockstep else request_realtime(REALTIME_PRIORITY)
        if refused:
            graph.node.get_logger().warning(f"no real-time priority: {refused}")
        try:
            yield Session(graph, robot, lockstep)
        finally:
            if not lockstep:
                end_realtime()


def start_controller(session: Session, robot_file: Path) -> None:
    """Start and activate the controller."""
    session.graph.processes.start(
        "impedance_controller",
        robot_file=robot_file,
        joint_control_cost=LAW.joint_control_cost,
        lockstep=session.lockstep,
        use_sim_time=session.lockstep,
        realtime_priority=session.priority,
    )
    session.graph.bring_up("impedance_controller", START_TIMEOUT)


def start_joint_reference(
    session: Session, robot_file: Path, tasks: Sequence[str], models: Path
) -> Callable[[tuple[str, ...]], None]:
    """Start what computes the references of these tasks, with the models <task>.tpgmm of a directory.

    Without tasks the robot is free to be led.

    Returns
    -------
    Callable[[tuple[str, ...]], None]
        what sets the tasks that hold, once all nodes have answered the present state
    """
    session.graph.processes.start(
        "joint_reference",
        robot_file=robot_file,
        task_files=str([str(config_file(f"{name}.yaml")) for name in tasks] or [""]),
        model_files=str([str((models / f"{name}.tpgmm").absolute()) for name in tasks] or [""]),
        use_sim_time=session.lockstep,
        realtime_priority=session.priority,
    )
    client = session.graph.node.create_client(SetParameters, "joint_reference/set_parameters")
    session.graph.wait_for(client.service_is_ready, START_TIMEOUT, "joint_reference to appear")

    def choose(names: tuple[str, ...]) -> None:
        session.settle()
        value = ParameterValue(type=ParameterType.PARAMETER_STRING, string_value=",".join(names))
        request = SetParameters.Request(parameters=[ParameterMessage(name="active", value=value)])
        for result in session.graph.result(client.call_async(request), START_TIMEOUT, "the choice of tasks").results:
            if not result.successful:
                raise GraphError(f"joint_reference refused the tasks {names}: {result.reason}")

    return choose
