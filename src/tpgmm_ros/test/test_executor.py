# SPDX-License-Identifier: Apache-2.0
"""How nodes are run."""

import os
import re
import subprocess
import sys
from pathlib import Path

import pytest
from domain_coordinator import domain_id

from tpgmm_ros.runtime.transport import PROFILES, TRANSPORTS

PROBE = """
from rclpy.node import Node
from std_msgs.msg import Empty
from tpgmm_ros.runtime.executor import run

class Probe(Node):
    def __init__(self):
        super().__init__("probe")
        self.create_publisher(Empty, "written", 1)
        self.create_subscription(Empty, "heard", print, 1)

    def loop(self, executor, stop):
        topics = [*self.publishers, *self.subscriptions]
        print(len(topics), sum(len(topic.event_handlers) for topic in topics))

run(Probe)
"""


def test_no_status_event_of_the_middleware_is_asked_for() -> None:
    """Two locks, taken in either order, would let the node stand still when such an event comes beside a message."""
    with domain_id() as domain:
        environment = {**os.environ, "ROS_DOMAIN_ID": str(domain), "ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST"}
        run = subprocess.run(
            [sys.executable, "-c", PROBE], env=environment, capture_output=True, text=True, timeout=120.0
        )
    assert run.returncode == 0, run.stderr
    topics, events = map(int, run.stdout.split())
    assert topics >= 2  # those of the probe, and what every node writes
    assert events == 0


FAILING = """
from rclpy.node import Node
from tpgmm_ros.runtime.executor import run

class Probe(Node):
    def __init__(self):
        super().__init__("probe")
        self.create_timer(0.01, lambda: self.executor.create_task(self.fail))

    def fail(self):
        raise RuntimeError("at a later turn")

    def destroy_node(self):
        print("its last words")
        super().destroy_node()

run(Probe)
"""


def test_a_node_whose_task_fails_ends_in_its_own_words_and_says_where() -> None:
    """rclpy's executor crashes the process then: a controller would leave its last torques as they are."""
    with domain_id() as domain:
        environment = {**os.environ, "ROS_DOMAIN_ID": str(domain), "ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST"}
        run = subprocess.run(
            [sys.executable, "-c", FAILING], env=environment, capture_output=True, text=True, timeout=120.0
        )
    assert run.returncode == 1 and run.stdout == "its last words\n"
    assert "in fail" in run.stderr and "RuntimeError: at a later turn" in run.stderr


MAPPED = """
import os
from tpgmm_ros.runtime.rclpy_workarounds import init_rclpy
import rclpy
from rclpy.node import Node
from tpgmm_ros.runtime.transport import uses_shared_memory

init_rclpy()
node = Node("probe")
print(uses_shared_memory(os.getpid()))
"""


@pytest.mark.parametrize(
    ("environment", "shared"),
    [
        ({}, False),
        ({"ROS_AUTOMATIC_DISCOVERY_RANGE": "SUBNET"}, False),
        ({"ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST"}, False),
        ({"ROS_AUTOMATIC_DISCOVERY_RANGE": "OFF"}, False),
        ({"ROS_LOCALHOST_ONLY": "1"}, False),
        ({"ROS_AUTOMATIC_DISCOVERY_RANGE": "SUBNET", "FASTDDS_BUILTIN_TRANSPORTS": "DEFAULT"}, True),
    ],
)
def test_a_process_that_is_killed_cannot_block_the_nodes_by_shared_memory_unless_somebody_has_chosen_it(
    environment: dict[str, str], shared: bool
) -> None:
    names = ("ROS_AUTOMATIC_DISCOVERY_RANGE", "ROS_LOCALHOST_ONLY", TRANSPORTS, *PROFILES)
    rest = {name: value for name, value in os.environ.items() if name not in names}
    with domain_id() as domain:
        run = subprocess.run(
            [sys.executable, "-c", MAPPED],
            env={**rest, "ROS_DOMAIN_ID": str(domain), **environment},
            capture_output=True,
            text=True,
            timeout=120.0,
        )
    assert run.stdout.split() == [str(shared)], run.stderr


def test_no_program_starts_rclpy_in_another_way() -> None:
    assert modules_with(r"rclpy\.init\(") == ["rclpy_workarounds.py"]


def test_private_parts_of_rclpy_are_used_in_two_modules() -> None:
    """Names of rclpy 7.1 that begin with an underscore, or that its documentation does not have."""
    names = r"rclpy\.impl\b", r"\._service_change_state\b", r"\._state_machine\b", r"\.handle\b", r"\.send_response\b"
    assert sorted(modules_with("|".join(names))) == ["rclpy_events.py", "rclpy_workarounds.py"]


def test_every_node_is_served_by_the_executor_whose_tasks_may_fail() -> None:
    assert modules_with(r"\bEventsExecutor\(") == []


def modules_with(pattern: str) -> list[str]:
    """Names of the files of both packages whose text has it."""
    packages = (
        Path(__file__).parents[2] / package / package for package in ("tpgmm_ros", "tpgmm_demos", "tpgmm_workbench")
    )
    modules = (path for package in packages for path in package.rglob("*.py"))
    return [path.name for path in modules if re.search(pattern, path.read_text())]
