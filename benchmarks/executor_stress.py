# SPDX-License-Identifier: Apache-2.0
"""Whether a node at 1 kHz ever stands still beside peers that come and go and want another quality of service.

Real processes: simulator, controller, tracker and reproduction, and two peers that make and destroy publishers and
subscriptions that do not fit, several times a second, and are killed now and then. They use whatever
Fast DDS uses by itself, shared memory too. Every node publishes once a second on /diagnostics; one that is silent for
longer than SILENCE has stopped, and its log gets the stacks of its threads. Writes out/executor_stress/.
"""

from __future__ import annotations

import argparse
import os
import random
import subprocess
import sys
import tempfile
import time
from functools import partial
from pathlib import Path
from typing import Any

from diagnostic_msgs.msg import DiagnosticArray
from sensor_msgs.msg import JointState

from tpgmm_core.common.report import format_table
from tpgmm_ros.messages.qos import STREAM
from tpgmm_ros.programs.reporting import write_report
from tpgmm_ros.runtime.graph import open_graph, own_domain
from tpgmm_ros.runtime.processes import GraphError, end_with_parent
from tpgmm_ros.runtime.resources import config_file
from tpgmm_ros.runtime.transport import PROFILES, RANGE, TRANSPORTS

NODES = ("baxter_simulator", "impedance_controller", "frame_tracker", "reproduction")
#: A node that says nothing for this long stands still, s. A machine that is busy makes gaps of seconds.
SILENCE = 30.0
#: How long a peer lives before it is killed, s.
LIFE = 5.0
PEER = """
import random, time
import rclpy
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from sensor_msgs.msg import JointState
from geometry_msgs.msg import PoseStamped
from tpgmm_msgs.msg import ControllerState, Reference, TaskParameters

TOPICS = {"joint_states": JointState, "joint_torques": JointState, "reference": Reference,
          "task_parameters": TaskParameters, "controller_state": ControllerState, "object/pose": PoseStamped}
much = QoSProfile(depth=1, reliability=ReliabilityPolicy.RELIABLE, durability=DurabilityPolicy.TRANSIENT_LOCAL)
little = QoSProfile(depth=1, reliability=ReliabilityPolicy.BEST_EFFORT)
rclpy.init()
while True:
    node = rclpy.create_node("peer")
    for topic, kind in TOPICS.items():
        node.create_subscription(kind, topic, lambda message: None, random.choice([much, little]))
        if topic in ("task_parameters", "object/pose"):  # torques and states of others would be heard
            node.create_publisher(kind, topic, random.choice([much, little]))
    end = time.monotonic() + random.uniform(0.05, 0.5)
    while time.monotonic() < end:
        rclpy.spin_once(node, timeout_sec=0.02)
    node.destroy_node()
"""


def main() -> int:
    """Run it; returns the exit status, 0 where no node stopped."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--minutes", type=float, default=10.0, help="how long (default: %(default)s)")
    parser.add_argument("--rate", type=float, default=1000.0, help="of joint states, Hz (default: %(default)s)")
    arguments = parser.parse_args()
    with tempfile.TemporaryDirectory() as directory, own_domain(ros_log=Path(directory)):
        report = stress(Path("out/executor_stress/log"), 60.0 * arguments.minutes, arguments.rate)
    print(format_table(("node", "ticks done", "longest silence"), report.pop("rows")))
    write_report(Path("out/executor_stress"), report)
    print("passed" if report["passed"] else f"NOT passed: {report['error']}")
    return 0 if report["passed"] else 1


def _is_over(end: float) -> bool:
    return time.monotonic() >= end


def stress(log: Path, seconds: float, rate: float) -> dict[str, Any]:
    """Run it; the report, and the rows of its table."""
    heard: dict[str, float] = {}
    silences = dict.fromkeys(NODES, 0.0)
    ticks: dict[str, int] = {}
    torques = 0

    def take(message: DiagnosticArray) -> None:
        now = time.monotonic()
        for status in message.status:
            silences[status.name] = max(silences.get(status.name, 0.0), now - heard.get(status.name, now))
            heard[status.name] = now
            values = {item.key: item.value for item in status.values}
            ticks[status.name] = int(values.get("ticks_done", 0))

    def count(message: JointState) -> None:
        nonlocal torques
        torques += 1

    foreign = {key: value for key, value in os.environ.items() if key not in (TRANSPORTS, *PROFILES)}
    foreign[RANGE] = "LOCALHOST"
    peers: list[subprocess.Popen[bytes]] = []
    lives, error = 0, ""
    with open_graph("watch", log) as graph:
        graph.node.create_subscription(DiagnosticArray, "/diagnostics", take, 10)
        graph.node.create_subscription(JointState, "joint_torques", count, STREAM)
        start = graph.processes.start
        start("baxter_simulator", robot_file=config_file("baxter.yaml"), rate=rate)
        start("frame_tracker", task_file=config_file("pick_place.yaml"))
        start("impedance_controller", robot_file=config_file("baxter.yaml"), autostart=True)
        start("reproduction", task_file=config_file("pick_place.yaml"), autostart=True)
        try:
            graph.wait_for(lambda: len(heard) >= len(NODES), 120.0, "diagnostics of all nodes")
            begun = told = time.monotonic()
            due = [0.0, 0.0]
            while time.monotonic() - begun < seconds:
                pause = partial(_is_over, time.monotonic() + 0.5)
                graph.wait_for(pause, 60.0, "time to pass")
                now = time.monotonic()
                for i in range(len(due)):
                    if now >= due[i]:
                        due[i] = now + random.uniform(0.3, 1.0) * LIFE
                        if i < len(peers):
                            peers[i].kill()
                            peers[i].wait()
                        peer = subprocess.Popen(
                            [sys.executable, "-c", PEER],
                            env=foreign,
                            preexec_fn=end_with_parent,
                            stderr=subprocess.DEVNULL,  # a warning for each topic that does not fit
                        )
                        peers[i : i + 1] = [peer]
                        lives += 1
                for name in NODES:
                    silences[name] = max(silences[name], now - heard[name])
                    if now - heard[name] > SILENCE:
                        graph.processes.show_stacks(name)
                        raise GraphError(f"{name} stalled: nothing on /diagnostics for {SILENCE:g} s")
                if now - told >= 30.0:
                    told = now
                    print(f"{now - begun:5.0f} of {seconds:.0f} s: {lives} peers, {torques} torques", flush=True)
        except GraphError as caught:
            error = str(caught)
        finally:
            for peer in peers:
                peer.kill()
                peer.wait()
    if not error and not torques:
        error = "no torques came, although all nodes told that they go on"
    rows = [(name, str(ticks.get(name, 0)), f"{silences[name]:.1f} s") for name in NODES]
    return {
        "passed": not error,
        "error": error,
        "time_s": seconds,
        "rate_hz": rate,
        "peers": lives,
        "torques": torques,
        "longest_silence_s": {name: silences[name] for name in NODES},
        "ticks_done": {name: ticks.get(name, 0) for name in NODES},
        "rows": rows,
    }


if __name__ == "__main__":
    sys.exit(main())
