# SPDX-License-Identifier: Apache-2.0
"""What an installation of the packages offers, here as on a full ROS installation."""

import os
import subprocess
import sys
from importlib.metadata import EntryPoint, distribution
from pathlib import Path

import pytest
from ament_index_python.packages import get_package_share_directory

from ros_testing import executable

REPOSITORY = Path(__file__).parents[1]
PROGRAMS = [
    (package, program)
    for package in ("tpgmm_ros", "tpgmm_demos", "tpgmm_workbench")
    for program in distribution(package).entry_points.select(group="console_scripts")
]


@pytest.mark.parametrize(("package", "program"), PROGRAMS, ids=[f"{package}-{item.name}" for package, item in PROGRAMS])
def test_every_executable_is_installed_and_can_be_loaded(package: str, program: EntryPoint) -> None:
    assert os.access(executable(program.name, package), os.X_OK)
    assert callable(program.load())


@pytest.mark.parametrize(("directory", "pattern"), [("config", "*.yaml"), ("src/tpgmm_ros/launch", "*.launch.py")])
def test_configuration_and_launch_files_are_installed(directory: str, pattern: str) -> None:
    sources = list((REPOSITORY / directory).glob(pattern))
    installed = Path(get_package_share_directory("tpgmm_ros")) / Path(directory).name
    assert sources
    assert {path.name for path in sources} <= {path.name for path in installed.iterdir()}


def test_a_process_without_any_environment_finds_the_workspace() -> None:
    program = (
        "import rclpy, tpgmm_msgs.msg\n"
        "from ament_index_python.packages import get_package_prefix\n"
        "from rclpy.type_support import check_for_type_support\n"
        "check_for_type_support(tpgmm_msgs.msg.Reference)\n"
        "get_package_prefix('tpgmm_ros')"
    )
    run = subprocess.run([sys.executable, "-c", program], env={}, capture_output=True, text=True)
    assert run.returncode == 0, run.stderr
