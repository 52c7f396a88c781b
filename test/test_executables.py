# SPDX-License-Identifier: Apache-2.0
"""Every executable, whatever it is given and whenever it is interrupted, ends quietly and says why in one line."""

from __future__ import annotations

import importlib.metadata
import os
import random
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest
from rclpy.node import Node

from forked_processes import run_all
from long_tests import mostly_long
from ros_graph import ROBOT_FILE, TASK_FILE, ros_arguments
from ros_testing import STARTUP_TIMEOUT, StartProcess, executable, spin_until
from tpgmm_ros import executables
from tpgmm_ros.runtime import entry

NODES: dict[str, dict[str, object]] = {
    "frame_tracker": {"task_file": TASK_FILE},
    "baxter_simulator": {"robot_file": ROBOT_FILE},
    "endpoint_poses": {"robot_file": ROBOT_FILE},
    "joint_reference": {"robot_file": ROBOT_FILE},
    "recognition": {"task_file": TASK_FILE},
    "joint_motion": {"robot_file": ROBOT_FILE, "autostart": True},
    "workbench": {"task_file": TASK_FILE, "robot_file": ROBOT_FILE},
    "reproduction": {"task_file": TASK_FILE, "autostart": True},
    "impedance_controller": {"robot_file": ROBOT_FILE, "autostart": True},
}
#: Arguments with which a program works for a while, in a folder of its own.
PROGRAMS = {
    "compose": ["frame_tracker", *ros_arguments(task_file=TASK_FILE)],
    "check_robot": [str(ROBOT_FILE)],
    "convert": ["--to", "bags", "--rate", "10", "--movement", "[0:3]", "none.npy"],
    "inspect": [str(TASK_FILE.parents[1] / "bags" / "pick_place")],
    "train": ["--task", str(TASK_FILE), "--output", "m.tpgmm", str(TASK_FILE.parents[1] / "bags" / "pick_place")],
    "recognize": ["--task", str(TASK_FILE), "--skill", "a=a.tpgmm", str(TASK_FILE.parents[1] / "bags" / "pick_place")],
    "evaluate": ["--task", str(TASK_FILE), str(TASK_FILE.parents[1] / "bags" / "pick_place")],
    "show": ["m.tpgmm"],
    "record": [str(TASK_FILE), "--to", "bags"],
    "teach": ["--task", str(TASK_FILE), "--output", "bag"],
    "demo": ["--lockstep", "--bags", str(TASK_FILE.parents[1] / "bags" / "pick_place")],
    "figure5": [],
}
EXECUTABLES = [*NODES, *PROGRAMS]


def test_every_executable_begins_where_signals_come_before_imports() -> None:
    points = importlib.metadata.distribution("tpgmm_ros").entry_points.select(group="console_scripts")
    if all("executables" not in point.value for point in points):
        pytest.fail("the installed executables are older than setup.py: run `make setup`")
    assert {point.name: point.value for point in points} == {
        name: f"tpgmm_ros.executables:{name}" for name in EXECUTABLES
    }
    assert all(callable(getattr(executables, name)) for name in EXECUTABLES)
    for package in ("tpgmm_ros", "tpgmm_demos", "tpgmm_workbench"):
        slow = "{'numpy', 'rclpy', 'tpgmm_core', 'argparse'}"
        check = f"import sys, {package}.executables\nsys.exit(bool({slow} & set(sys.modules)))"
        subprocess.run([sys.executable, "-c", check], check=True, timeout=60)


@pytest.mark.parametrize("command", [["demo"], ["figure5", "--seed", "7"], ["teach", "--scripted", "--output", "bags"]])
def test_without_tpgmm_demos_its_programs_say_what_to_install(command: list[str], tmp_path: Path) -> None:
    """As on a robot, where only tpgmm_ros is installed."""
    code = (
        "import os, sys; from tpgmm_ros import executables\n"
        "sys.path[:] = [path for path in sys.path if not os.path.isdir(os.path.join(path, 'tpgmm_demos'))]\n"
        f"sys.argv = {command}; sys.exit(executables.{command[0]}())"
    )
    ended = subprocess.run([sys.executable, "-c", code], cwd=tmp_path, capture_output=True, text=True, timeout=120)
    (line,) = ended.stderr.splitlines()
    assert (ended.returncode, ended.stdout) == (1, "") and line.startswith(f"error: {command[0]}")
    assert "tpgmm_demos, which is not installed" in line and "colcon build" in line and "make setup" in line


# -- interrupted at any moment


#: How many for each executable, within as many seconds; TPGMM_MOMENTS=8 for more of them.
MOMENTS = int(os.environ.get("TPGMM_MOMENTS", "2"))


def moments(name: str) -> list[float]:
    """Seconds after the start, from Python's own start to the middle of the work: others for each executable."""
    chance = random.Random(name)
    return [chance.uniform(i, i + 1) for i in range(MOMENTS)]


@pytest.mark.parametrize(
    "name", mostly_long(EXECUTABLES, "frame_tracker", "impedance_controller", "train", "record", "demo")
)
def test_ctrl_c_at_any_moment_ends_an_executable_quietly(
    name: str, tmp_path: Path, ros_domain: int, start_process: StartProcess
) -> None:
    arguments = PROGRAMS.get(name) or ros_arguments(**NODES.get(name, {}))
    folders = []
    for i, moment in enumerate(moments(name)):
        folder = tmp_path / str(i)
        folder.mkdir()
        here = os.getcwd()
        os.chdir(folder)
        try:
            process = start_process(executable(name), *arguments)
        finally:
            os.chdir(here)
        until = time.monotonic() + moment
        while time.monotonic() < until and process.returncode is None:
            time.sleep(0.005)
        if process.returncode is None:
            process.send_signal(signal.SIGINT)
        status = process.wait(STARTUP_TIMEOUT)
        if "init_import_site" in process.output:  # Python itself was not up yet, and nobody else can say a word
            continue
        # A death by SIGINT, before Python heard of it, is what a shell calls 130 too.
        assert status in (0, entry.INTERRUPTED, -signal.SIGINT) or (status == 1 and name in PROGRAMS), process.output
        assert "Traceback" not in process.output and "KeyboardInterrupt" not in process.output, (moment, process.output)
        folders.append((moment, status))
    print(name, folders)


def test_a_signal_during_the_imports_ends_at_once(tmp_path: Path) -> None:
    """Imports that take for ever stand for slow ones; they begin to, and say so, before the signal comes."""
    (tmp_path / "slow.py").write_text("import time\nprint('importing', flush=True)\nwhile True: time.sleep(0.01)\n")
    for kind, number, expected in (
        ("program", signal.SIGINT, 130),
        ("program", signal.SIGTERM, -signal.SIGTERM),
        ("node", signal.SIGINT, 0),
        ("node", signal.SIGTERM, 0),
    ):
        code = f"import sys; from tpgmm_ros.runtime import entry; sys.exit(entry.{kind}('slow')())"
        path = os.pathsep.join([str(tmp_path), os.environ.get("PYTHONPATH", "")])
        with subprocess.Popen(
            [sys.executable, "-c", code],
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
            env={**os.environ, "PYTHONPATH": path},
        ) as process:
            assert process.stdout is not None and process.stdout.readline() == "importing\n"
            process.send_signal(number)
            _, errors = process.communicate(timeout=30)
        assert (process.returncode, errors) == (expected, ""), kind


# -- log directories


@pytest.mark.parametrize("where", ["a file", "below a file", "nowhere to be made"])
def test_a_log_directory_that_cannot_be_written_is_said_once_and_keeps_no_node_from_starting(
    where: str, tmp_path: Path, ros_node: Node, start_process: StartProcess
) -> None:
    (tmp_path / "file").write_text("")
    directory = {"a file": tmp_path / "file", "below a file": tmp_path / "file" / "log"}.get(where, Path("/proc/log"))
    process = start_process(
        executable("frame_tracker"), *ros_arguments(**NODES["frame_tracker"]), env={"ROS_LOG_DIR": str(directory)}
    )
    spin_until(ros_node, lambda: "frame_tracker" in ros_node.get_node_names(), processes=(process,))
    process.send_signal(signal.SIGINT)
    assert process.wait(STARTUP_TIMEOUT) == 0
    (warning,) = [line for line in process.output.splitlines() if "no log file is written" in line]
    assert str(directory) in warning and "ROS_LOG_DIR" in warning
    assert "Traceback" not in process.output


# -- whatever they are given


@pytest.mark.parametrize("name", EXECUTABLES)
def test_help_says_what_an_executable_is_for(name: str) -> None:
    (ended,) = run_all([[name, "--help"]])
    assert (ended.returncode, ended.stderr) == (0, "")
    assert ended.stdout.startswith(f"usage: {name} ")
    for parameter in NODES.get(name, {}):
        assert f"  {parameter}: " in ended.stdout


@pytest.mark.parametrize("name", EXECUTABLES)
def test_unknown_arguments_end_with_status_2(name: str) -> None:
    (ended,) = run_all([[name, "--no-such-option"]])
    assert ended.returncode == 2 and ended.stdout == "" and "Traceback" not in ended.stderr
    assert "error: " in ended.stderr.splitlines()[-1]


@pytest.mark.parametrize(("to", "status"), [(">/dev/full", 1), (">&-", 0)])
def test_output_that_cannot_be_written_is_said_in_one_line(to: str, status: int) -> None:
    command = ["sh", "-c", f'exec "$0" "$@" {to}', executable("check_robot"), str(ROBOT_FILE)]
    ended = subprocess.run(command, capture_output=True, text=True, timeout=120)
    assert ended.returncode == status
    assert ended.stderr.count("\n") == status and ended.stderr.startswith("error: the disk is full" * status)
