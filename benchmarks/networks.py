# SPDX-License-Identifier: Apache-2.0
"""The demo's task on three hosts: a camera, the nodes that reason, and the robot; joined by a poor network.

Packets are lost, every cable is slow, and the camera's is unplugged for a while during the movement. Nothing may need a
restart, and the robot must not jump. Linux, without privileges: see `lossy_switch`. Writes out/networks/report.json.
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
import threading
import time
from collections.abc import Callable
from contextlib import ExitStack, closing
from pathlib import Path
from typing import Any

from benchmarks.lossy_switch import NETWORK, Host, LossySwitch, enter_own_network
from tpgmm_core.common.report import format_table
from tpgmm_ros.programs import train
from tpgmm_ros.programs.reporting import write_report
from tpgmm_ros.runtime.resources import config_file
from tpgmm_ros.task.task_file import Task

TASK_FILE = config_file("pick_place.yaml")
#: The camera is unplugged so long after the start of the movement, s.
UNPLUGGED_AFTER = 2.0
#: The whole may take this long, s.
TIMEOUT = 300.0


def main() -> int:
    """Run it; returns the exit status, 0 where all of it went well."""
    arguments = _parser().parse_args()
    enter_own_network()
    arguments.output.mkdir(parents=True, exist_ok=True)
    model_file = arguments.output / "pick_place.tpgmm"
    if not model_file.exists():
        train.main(["--task", str(TASK_FILE), "--output", str(model_file), "bags/pick_place"])
    report = run(arguments, model_file)
    write_report(arguments.output, report)
    print(format_table(("what", "measured"), [(key, str(value)) for key, value in report.items()]))
    return 0 if report["passed"] else 1


def run(arguments: argparse.Namespace, model_file: Path) -> dict[str, Any]:
    """Start the hosts and their programs; returns what was measured."""
    os.environ |= {"ROS_DOMAIN_ID": "0", "ROS_LOG_DIR": str(arguments.output / "log"), "PYTHONPATH": "."}
    os.environ.pop("ROS_AUTOMATIC_DISCOVERY_RANGE", None)  # other hosts are to be found
    told: dict[str, Any] = {}
    has_started, has_ended = threading.Event(), threading.Event()

    def hear(line: str) -> None:
        print(f"robot: {line}")
        if line.startswith("{"):
            told.update(json.loads(line))
            has_started.set()
            if "passed" in told:
                has_ended.set()

    with ExitStack() as stack:
        camera, reasoning, robot = hosts = [
            stack.enter_context(closing(Host(name, i + 1))) for i, name in enumerate(("camera", "reasoning", "robot"))
        ]
        switch = LossySwitch(hosts, arguments.loss, arguments.bits)
        stack.callback(switch.close)
        seen, shown = os.pipe()
        python = [sys.executable, "-m"]
        processes = {
            "camera": camera.start([*python, "benchmarks.networks_camera"], stdin=seen, **_log(arguments, "camera")),
            "reasoning": reasoning.start(
                [*python, "tpgmm_ros.programs.compose", "frame_tracker", "reproduction", "--ros-args",
                 "-p", f"task_file:={TASK_FILE}", "-p", f"reproduction:model_file:={model_file}",
                 "-p", f"joint_state_rate:={arguments.network_rate}", "-p", "autostart:=true", *_remapped()],
                **_log(arguments, "reasoning"),
            ),
            "robot": robot.start(
                [*python, "benchmarks.networks_robot", "--rate", str(arguments.rate),
                 "--network-rate", str(arguments.network_rate), "--seed", str(arguments.seed),
                 "--sightings", str(shown), "--output", str(arguments.output)],
                pass_fds=(shown,), stdout=subprocess.PIPE,
            ),
        }  # fmt: skip
        for process in processes.values():
            stack.callback(_end, process)
        os.close(seen)
        stack.callback(os.close, shown)  # what is shown to the camera has no end before its program is looked after
        _hear_lines(processes["robot"], hear)
        deadline = time.monotonic() + TIMEOUT
        if has_started.wait(TIMEOUT):
            time.sleep(UNPLUGGED_AFTER)  # what the camera's host does meanwhile is what is measured
            switch.unplug("camera", arguments.unplugged)
            while not has_ended.wait(0.2) and time.monotonic() < deadline and processes["robot"].poll() is None:
                pass
        alive = [name for name in ("camera", "reasoning") if processes[name].poll() is None]
    whole = {
        "packets": dict(switch.counts), "loss": arguments.loss, "bits_per_s": arguments.bits,
        "unplugged_s": arguments.unplugged, "rate_hz": arguments.rate,
        "network_rate_hz": arguments.network_rate, "load": os.getloadavg()[0], **told,
    }  # fmt: skip
    whole["nothing ended"] = len(alive) == 2
    whole["passed"] = bool(told.get("passed")) and len(alive) == 2
    return whole


def _hear_lines(process: subprocess.Popen[str], tell: Callable[[str], None]) -> None:
    """Hand over what a process says, line by line, in a thread."""

    def read() -> None:
        assert process.stdout is not None
        for line in process.stdout:
            tell(line.rstrip("\n"))

    threading.Thread(target=read, daemon=True).start()


def _remapped() -> list[str]:
    """What reasons gets joint states and the hand's pose as they come for the network."""
    topics = "joint_states", Task.load(TASK_FILE).movement
    return [word for topic in topics for word in ("-r", f"{topic}:={NETWORK}/{topic}")]


def _log(arguments: argparse.Namespace, name: str) -> dict[str, Any]:
    return {"stdout": (arguments.output / f"{name}.log").open("w"), "stderr": subprocess.STDOUT}


def _end(process: subprocess.Popen[str]) -> None:
    process.terminate()
    try:
        process.wait(10.0)
    except subprocess.TimeoutExpired:
        process.kill()


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(prog="networks", description=__doc__)
    parser.add_argument("--loss", type=float, default=0.1, help="share of packets that are lost (default: %(default)s)")
    parser.add_argument("--bits", type=float, default=1e6, help="of each cable, bit/s (default: %(default)s)")
    parser.add_argument(
        "--unplugged", type=float, default=5.0, help="how long the camera is cut off, s (default: %(default)s)"
    )
    parser.add_argument(
        "--rate", type=float, default=200.0, help="of the robot's own control, Hz (default: %(default)s)"
    )
    parser.add_argument(
        "--network-rate",
        type=float,
        default=50.0,
        help="of joint states and references on the cables, Hz; at 100 Hz "
        "they do not fit 1 Mbit/s (default: %(default)s)",
    )
    parser.add_argument("--seed", type=int, default=1, help="number of the situation (default: %(default)s)")
    parser.add_argument(
        "--output", type=Path, default=Path("out/networks"), help="report, model, logs (default: %(default)s)"
    )
    return parser


if __name__ == "__main__":
    sys.exit(main())
