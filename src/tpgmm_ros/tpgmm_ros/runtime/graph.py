# SPDX-License-Identifier: Apache-2.0
"""A graph of nodes on a ROS domain of its own, as a program sees it: bring nodes up, call services, wait."""

from __future__ import annotations

import os
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Any

import rclpy
from domain_coordinator import domain_id
from lifecycle_msgs.msg import State, Transition
from lifecycle_msgs.srv import ChangeState, GetState
from rclpy.executors import Executor
from rclpy.node import Node
from rclpy.parameter import Parameter
from rclpy.task import Future

from tpgmm_ros.runtime.executor import init
from tpgmm_ros.runtime.processes import GraphError, GraphTimeoutError, NodeProcesses
from tpgmm_ros.runtime.rclpy_events import NodeExecutor

#: A service that has not answered is asked again, s.
ASK_AGAIN = 8.0


class Graph:
    """What a program needs to deal with running nodes: wait for conditions, call services, bring nodes up.

    Parameters
    ----------
    node
        the program's own node
    executor
        the executor that serves it
    processes
        checked while waiting, so that a node that died ends the waiting at once
    """

    def __init__(self, node: Node, executor: Executor, processes: NodeProcesses) -> None:
        self.node = node
        self.executor = executor
        self.processes = processes

    def wait_for(self, condition: Callable[[], bool], timeout: float, what: str) -> None:
        """Serve the node until ``condition()`` holds.

        Raises
        ------
        GraphTimeoutError
            it does not within ``timeout`` seconds of steady time.
        GraphError
            a process ended.
        """
        deadline = time.monotonic() + timeout
        while not condition():
            self.executor.spin_once(timeout_sec=0.02)
            self.processes.check()
            if time.monotonic() > deadline:
                raise GraphTimeoutError(
                    f"timed out: waited {timeout:g} s for {what}; see {self.processes.log_directory}"
                )

    def result(self, future: Future, timeout: float, what: str) -> Any:
        """What a future (of a service or an action) comes to.

        Parameters
        ----------
        future
            the future
        timeout
            s
        what
            what is waited for, in words

        Returns
        -------
        Any
            its result

        Raises
        ------
        GraphError
            like `wait_for`
        """
        self.wait_for(future.done, timeout, what)
        return future.result()

    def bring_up(self, name: str, timeout: float = 30.0) -> None:
        """Configure and activate a lifecycle node.

        Raises
        ------
        GraphError
            it does not appear, or refuses.
        """
        for label, transition, goal in (
            ("configure", Transition.TRANSITION_CONFIGURE, State.PRIMARY_STATE_INACTIVE),
            ("activate", Transition.TRANSITION_ACTIVATE, State.PRIMARY_STATE_ACTIVE),
        ):
            request = ChangeState.Request(transition=Transition(id=transition))
            if self.call(ChangeState, f"{name}/change_state", request, timeout).success:
                continue
            # Asked again after a response that was lost, a node refuses to do what it has done.
            if self.call(GetState, f"{name}/get_state", GetState.Request(), timeout).current_state.id != goal:
                raise GraphError(f"{name} refused to {label}; the end of its log:\n{self.processes.log_tail(name)}")

    def call(self, kind: type, name: str, request: Any, timeout: float) -> Any:
        """The response of a service.

        It is asked again every `ASK_AGAIN` seconds: the middleware drops a response where the server has not discovered
        yet who wants it, although it has the request.

        Parameters
        ----------
        kind
            type of the service
        name
            of the service
        request
            the request
        timeout
            s

        Returns
        -------
        Any
            the response

        Raises
        ------
        GraphError
            like `wait_for`
        """
        client = self.node.create_client(kind, name)
        asked: list[Future] = []
        due = 0.0

        def is_answered() -> bool:
            nonlocal due
            if time.monotonic() >= due:
                due = time.monotonic() + ASK_AGAIN
                asked.append(client.call_async(request))
            return any(future.done() for future in asked)

        try:
            self.wait_for(client.service_is_ready, timeout, f"the service {name} to appear")
            self.wait_for(is_answered, timeout, f"{name} to answer")
            return next(future.result() for future in asked if future.done())
        finally:
            self.node.destroy_client(client)


@contextmanager
def own_domain(domain: int | None = None, ros_log: Path | None = None) -> Iterator[None]:
    """Rclpy on a ROS domain that nobody else on this machine uses, and that no other machine sees.

    Parameters
    ----------
    domain
        in place of a free one, for those who want to watch.
    ros_log
        directory of the log files that ROS writes; where it usually writes them without.

    Yields
    ------
    None
        nothing; the domain ends with the block
    """
    with ExitStack() as stack:
        if domain is None:
            domain = stack.enter_context(domain_id())
            os.environ["ROS_AUTOMATIC_DISCOVERY_RANGE"] = "LOCALHOST"
        os.environ["ROS_DOMAIN_ID"] = str(domain)
        if ros_log is not None:
            os.environ["ROS_LOG_DIR"] = str(ros_log)
        init([])
        stack.callback(rclpy.try_shutdown)
        yield


@contextmanager
def open_graph(name: str, log_directory: Path, use_sim_time: bool = False) -> Iterator[Graph]:
    """A program's own node, and processes that end with it, within `own_domain`.

    Parameters
    ----------
    name
        of the node.
    log_directory
        see `NodeProcesses`.
    use_sim_time
        whether the node's clock is the simulated one.

    Yields
    ------
    Graph
        the node and the processes
    """
    node = Node(name, parameter_overrides=[Parameter("use_sim_time", value=use_sim_time)])
    executor = NodeExecutor()
    executor.add_node(node)
    try:
        with NodeProcesses(log_directory) as processes:
            yield Graph(node, executor, processes)
    finally:
        executor.remove_node(node)
        node.destroy_node()
