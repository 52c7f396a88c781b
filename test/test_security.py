# SPDX-License-Identifier: Apache-2.0
"""Who may say and hear what: the policies name exactly what the running nodes have; nothing leaves this machine."""

from __future__ import annotations

import ipaddress
import os
import socket
import sys
import xml.etree.ElementTree as Xml
from collections.abc import Callable
from pathlib import Path

import pytest
from rclpy.node import Node

from ros_graph import ROBOT_FILE, ROOT, TASK_FILE, ros_arguments
from ros_testing import StartProcess, spin_until
from tpgmm_ros.task.task_file import Task

POLICIES = ROOT / "config" / "security" / "policies.xml"
THIS_MACHINE = ROOT / "config" / "security" / "this_machine.xml"
NODES = ("frame_tracker", "reproduction", "impedance_controller", "joint_motion", "baxter_simulator")
#: Topics and services that an action is made of.
ACTION = "/_action/"

type Names = dict[str, set[str]]
"""Absolute names by what a node does with them."""


def allowed(node: str) -> Names:
    """What the policies allow a node."""
    profile = Xml.parse(POLICIES).getroot().find(f".//enclave[@path='/{node}']//profile[@node='{node}'][@ns='/']")
    assert profile is not None
    names: Names = {}
    for group in profile:
        (rule, allows), *others = group.attrib.items()
        assert allows == "ALLOW" and not others
        absolute = {(item.text or "").strip().replace("~", node, 1) for item in group}
        names[f"{group.tag} {rule}"] = {"/" + name.lstrip("/") for name in absolute}
    return names


def had(asker: Node, node: str) -> Names:
    """What a running node has."""

    def names(ask: Callable[[str, str], list[tuple[str, list[str]]]]) -> set[str]:
        return {name for name, _ in ask(node, "/")}

    replies = names(asker.get_service_names_and_types_by_node)
    found = {
        "topics publish": names(asker.get_publisher_names_and_types_by_node),
        "topics subscribe": names(asker.get_subscriber_names_and_types_by_node),
        "services reply": replies,
        "services request": names(asker.get_client_names_and_types_by_node),
        "actions execute": {name for name in replies if ACTION in name},
    }
    actions = {name.split(ACTION)[0] for name in found.pop("actions execute")}
    plain = {what: {name for name in group if ACTION not in name} for what, group in found.items()}
    return {what: group for what, group in {**plain, "actions execute": actions}.items() if group}


def test_the_policies_name_exactly_what_the_running_nodes_have(ros_node: Node, start_process: StartProcess) -> None:
    both = {"use_sim_time": True, "autostart": True}
    start_process("frame_tracker", *ros_arguments(task_file=TASK_FILE, lockstep=True, use_sim_time=True))
    start_process("reproduction", *ros_arguments(task_file=TASK_FILE, lockstep_rate=100.0, **both))
    start_process(
        "impedance_controller", *ros_arguments(robot_file=ROBOT_FILE, lockstep=True, yield_force=15.0, **both)
    )
    start_process("joint_motion", *ros_arguments(robot_file=ROBOT_FILE, **both))
    start_process("baxter_simulator", *ros_arguments(robot_file=ROBOT_FILE, lockstep=True))
    different: dict[str, tuple[Names, Names]] = {}

    def is_equal() -> bool:
        running = set(ros_node.get_node_names())
        different.clear()
        different.update(
            {
                node: (had(ros_node, node) if node in running else {}, allowed(node))
                for node in NODES
                if node not in running or had(ros_node, node) != allowed(node)
            }
        )
        return not different

    try:
        spin_until(ros_node, is_equal, 60.0, "the names of the policies")
    except AssertionError:
        lines = []
        for node, (names, policy) in different.items():
            for what in sorted(set(names) | set(policy)):
                lines.append(
                    f"{node}, {what}: only the node {names.get(what, set()) - policy.get(what, set())}, "
                    f"only the policies {policy.get(what, set()) - names.get(what, set())}"
                )
        raise AssertionError("\n".join(lines)) from None


def test_perception_may_publish_the_frames_of_the_task_and_the_operator_no_motion() -> None:
    topics = {f"/{topic}" for topic in Task.load(TASK_FILE).topics.values()}
    assert allowed("perception")["topics publish"] - {"/rosout", "/parameter_events"} == topics
    operator = allowed("operator")
    assert operator["topics publish"] == {"/rosout", "/parameter_events"}
    replied = set().union(*(allowed(node)["services reply"] for node in NODES))
    assert (
        operator["services request"] <= replied
        and operator["actions call"] == allowed("reproduction")["actions execute"]
    )


def open_ports(pid: int) -> set[str]:
    """Addresses at which the UDP sockets of a process receive, hexadecimal as in /proc."""
    inodes = set()
    for link in Path(f"/proc/{pid}/fd").iterdir():
        try:
            target = os.readlink(link)
        except FileNotFoundError:
            continue
        if target.startswith("socket:["):
            inodes.add(target[8:-1])
    rows = [line.split() for line in Path(f"/proc/{pid}/net/udp").read_text().splitlines()[1:]]
    return {row[1].split(":")[0] for row in rows if row[9] in inodes}


FIND = """
import sys, time, rclpy
rclpy.init()
node = rclpy.create_node("asker")
end = time.monotonic() + 60.0
while "frame_tracker" not in node.get_node_names():
    time.sleep(0.1)
    if time.monotonic() > end:
        sys.exit("frame_tracker was not found")
"""


@pytest.mark.usefixtures("ros_domain")
def test_with_the_profile_for_this_machine_nodes_find_each_other_and_have_no_socket_on_a_network(
    start_process: StartProcess,
) -> None:
    closed = {"ROS_AUTOMATIC_DISCOVERY_RANGE": "SUBNET", "FASTRTPS_DEFAULT_PROFILES_FILE": str(THIS_MACHINE)}
    tracker = start_process("frame_tracker", *ros_arguments(task_file=TASK_FILE), env=closed)
    assert start_process(sys.executable, "-c", FIND, env=closed).wait(90.0) == 0
    addresses = {ipaddress.ip_address(socket.ntohl(int(address, 16))) for address in open_ports(tracker.pid)}
    assert addresses and all(address.is_loopback or address.is_multicast for address in addresses)


def test_tests_and_programs_keep_to_this_machine(ros_domain: int) -> None:
    assert os.environ["ROS_AUTOMATIC_DISCOVERY_RANGE"] == "LOCALHOST" and os.environ["ROS_DOMAIN_ID"] == str(ros_domain)
    packages = [ROOT / "src" / package / package for package in ("tpgmm_ros", "tpgmm_demos", "tpgmm_workbench")]
    programs = [path for folder in (ROOT / "benchmarks", *packages) for path in folder.rglob("*.py")]
    starting = {path: text for path in programs if "open_graph(" in (text := path.read_text())}
    assert len(starting) > 3
    assert all("own_domain(" in text or "require_own_network(" in text for text in starting.values())
    by_hand = {
        path: text for path in programs if "NodeProcesses(" in (text := path.read_text()) and path not in starting
    }
    keeps = '["ROS_AUTOMATIC_DISCOVERY_RANGE"] = "LOCALHOST"'
    assert all("domain_id()" in text and keeps in text for text in by_hand.values()), "or start nodes by open_graph"
