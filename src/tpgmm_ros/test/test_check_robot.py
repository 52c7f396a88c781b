# SPDX-License-Identifier: Apache-2.0
"""check_robot says how the hands stand and are turned at home, with units, and one line where it cannot."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest

from tpgmm_core.geometry import quaternion
from tpgmm_core.robot.model import RobotModel
from tpgmm_ros.programs import check_robot
from tpgmm_ros.runtime.resources import config_file


@pytest.mark.parametrize("name", ["baxter", "panda", "ur5"])
def test_the_pose_of_each_end_point_at_home_is_printed_as_a_message_has_it(
    name: str, capsys: pytest.CaptureFixture[str]
) -> None:
    path = config_file(f"{name}.yaml")
    assert check_robot.main([str(path)]) == 0
    printed, robot = capsys.readouterr().out, RobotModel.from_file(path)
    data = robot.create_data()
    data.update(robot.home)
    _, _, poses = printed.partition(f"end points in the frame {robot.base_frame}, with the robot at home\n")
    for endpoint in robot.endpoints:
        (line,) = [line for line in poses.splitlines() if line.startswith(f"{endpoint}  ")]
        numbers = np.array([float(word) for word in re.findall(r"-?\d+\.\d+", line)])
        pose = data.pose(endpoint)
        np.testing.assert_allclose(numbers[:3], pose[:3], atol=5.1e-4)
        assert quaternion.angle_between(quaternion.normalize(numbers[3:7]), pose[3:]) < 1e-3 and numbers[6] >= 0.0
        x, y, z = (quaternion.exp(turn) for turn in np.diag(np.radians(numbers[7:])))
        turned = quaternion.multiply(z, quaternion.multiply(y, x))
        assert quaternion.angle_between(turned, pose[3:]) < np.radians(0.2)
        assert "-0.0 " not in line


def test_what_is_printed_says_its_units(capsys: pytest.CaptureFixture[str]) -> None:
    assert check_robot.main([str(config_file("panda.yaml"))]) == 0
    printed = capsys.readouterr().out
    for words in ("rad, m", "rad/s, m/s", "N m, N", "N m s/rad", "x y z (m)", "roll pitch yaw (deg)", "reaches x (m)"):
        assert words in printed


def test_a_task_file_is_called_so(capsys: pytest.CaptureFixture[str]) -> None:
    assert check_robot.main([str(config_file("pick_place.yaml"))]) == 1
    assert "is a task file, as it has 'movement'; expected a robot file" in capsys.readouterr().err


@pytest.mark.parametrize("content", [None, "", "\0\xff", "urdf: [", "- 1\n"])
def test_what_is_no_robot_file_is_one_line(
    tmp_path: Path, content: str | None, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "robot.yaml"
    if content is not None:
        path.write_bytes(content.encode("latin-1"))
    assert check_robot.main([str(path)]) == 1
    captured = capsys.readouterr()
    assert captured.out == "" and captured.err.startswith(f"error: {path}") and captured.err.count("\n") == 1
