# SPDX-License-Identifier: Apache-2.0
"""What is suspicious of a robot file is said, and nothing of the project's own."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest

pytest.importorskip("pinocchio")

from robots import CONFIG, GRIPPER_URDF, write_arm
from tpgmm_core.control.robot_check import suspicions, workspace
from tpgmm_core.robot.model import RobotModel

OWN = ["baxter", "panda", "ur5", "xarm7"]


@pytest.mark.parametrize("name", OWN)
def test_nothing_is_suspicious_of_the_projects_own_robots(name: str) -> None:
    assert suspicions(RobotModel.from_file(CONFIG / f"{name}.yaml")) == []


def panda(folder: Path, *replace: tuple[str, str]) -> RobotModel:
    text = (CONFIG / "panda.yaml").read_text()
    for old, new in replace:
        assert old in text
        text = text.replace(old, new)
    (folder / "panda.yaml").write_text(text)
    return RobotModel.from_file(folder / "panda.yaml")


@pytest.mark.parametrize(
    ("replace", "message"),
    [
        ((("panda_joint1: 0.0", "panda_joint1: 2.85"),), "home of panda_joint1 is 0.0473 rad from its limit"),
        ((("limits:\n", "limits:\n  panda_joint4: {effort: 25}\n"),), "panda_joint4 needs 88% of its effort"),
        ((("limits:\n", "limits:\n  panda_joint1: {lower: -166, upper: 166}\n"),), "panda_joint1 may move .* in degrees"),  # noqa: E501
        ((("coulomb: 0.2", "coulomb: 3.0"),), "panda_joint7 moves so little .* armature: {panda_joint7"),
        ((("coulomb: 0.2", "coulomb: 0.0"),), "no friction is given for panda_joint1, panda_joint2"),
        ((("panda_joint4: -2.356", "panda_joint4: -0.5"), ("panda_joint6: 1.571", "panda_joint6: 0.0"),), "hand: at home"),  # noqa: E501
        ((("base_frame: panda_link0", "base_frame: panda_link0\ngravity: [0, 0, 9.81]"),), "gravity is 0.00, 0.00, 9.81"),  # noqa: E501
        ((("base_frame: panda_link0", "base_frame: panda_link0\ngravity: [0, 0, -9810]"),), "gravity is 9810 m.* another unit"),  # noqa: E501
        ((("panda_joint6, panda_joint7]", "panda_joint6]"),), "hand: it is also moved by panda_joint7"),
        ((("panda_joint6, panda_joint7]", "panda_joint6]"),), "panda_joint7: in no joint group"),
        ((("frame: panda_hand_tcp", "frame: panda_link5"),), "joints that do not move it: panda_joint6, panda_joint7"),
    ],
)  # fmt: skip
def test_what_is_suspicious_is_said(tmp_path: Path, replace: tuple[tuple[str, str], ...], message: str) -> None:
    found = "\n".join(suspicions(panda(tmp_path, *replace)))
    assert len([line for line in found.splitlines() if re.search(message, line)]) == 1, found


def test_an_arm_of_few_joints_and_a_loose_gripper_are_noticed(tmp_path: Path) -> None:
    home: dict[str, Any] = {"home": {"turn": 0.0, "slide": 0.25, "grip": 0.02, "grip_too": 0.02}}
    found = suspicions(RobotModel.from_file(write_arm(tmp_path, home, replace=("</robot>", GRIPPER_URDF))))
    assert any(text.startswith("end point tool: 2 joints cannot reach every pose") for text in found)
    assert any(text.startswith("grip, grip_too: in no joint group") for text in found)


@pytest.mark.parametrize(("turn", "x"), [("revolute", -1.5 * np.cos(np.pi - 2.0)), ("continuous", -1.5)])
def test_the_workspace_is_what_postures_within_the_limits_reach(tmp_path: Path, turn: str, x: float) -> None:
    lower, upper = workspace(RobotModel.from_file(write_arm(tmp_path, turn=turn)), "tool")
    np.testing.assert_allclose(upper, [1.5, 1.5, 0.0], atol=0.05)
    np.testing.assert_allclose(lower, [x, -1.5, 0.0], atol=0.05)
