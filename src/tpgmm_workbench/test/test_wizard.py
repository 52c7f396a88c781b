# SPDX-License-Identifier: Apache-2.0
"""A robot file is proposed for robots that have none, and says what was guessed and what is suspicious."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from tpgmm_core.robot.description import resolve_urdf
from tpgmm_core.robot.model import RobotModel
from tpgmm_ros.task.task_file import Task
from tpgmm_workbench.project.errors import ProjectError
from tpgmm_workbench.project.from_urdf import create_from_urdf
from tpgmm_workbench.project.wizard import known_urdfs, propose_robot_file

ROOT = Path(__file__).resolve().parents[3]
ROBOTS = "package://example-robot-data/robots/"


@pytest.mark.parametrize(
    ("urdf", "joints", "endpoints"),
    [
        ("ur_description/urdf/ur5_robot.urdf", 6, {"arm"}),
        ("panda_description/urdf/panda.urdf", 7, {"arm"}),
        ("baxter_description/urdf/baxter.urdf", 14, {"left", "right"}),
        ("z1_description/urdf/z1.urdf", 6, {"arm"}),
    ],
)
def test_the_proposed_file_is_a_robot_that_can_be_used(
    urdf: str, joints: int, endpoints: set[str], tmp_path: Path
) -> None:
    assert ROBOTS + urdf in known_urdfs()
    found = propose_robot_file(ROBOTS + urdf)
    assert not found.problem
    path = tmp_path / "robot.yaml"
    path.write_text(found.text)
    robot = RobotModel.from_file(path)
    assert robot.nv == joints and set(robot.endpoints) == endpoints == set(found.endpoints)
    data = robot.create_data()
    data.update(robot.home)
    for name, end in robot.endpoints.items():
        moved = data.jacobian(name)[:, robot.indices(end.joints)]
        assert np.linalg.matrix_rank(moved, tol=1e-3) == 6, "at home the hand moves in all directions"
    if "baxter" in urdf or "panda" in urdf:  # as in the files that people wrote
        assert {end.frame for end in robot.endpoints.values()} <= {"left_gripper", "right_gripper", "panda_hand_tcp"}
    assert not any("home of" in text or "hardly move" in text for text in found.suspicions)


def test_what_a_urdf_does_not_say_is_guessed_and_said_so(tmp_path: Path) -> None:
    links = "".join(
        f'<link name="l{i}"><inertial><origin xyz="0 0 0.1"/><mass value="1"/>'
        f'<inertia ixx="0.01" ixy="0" ixz="0" iyy="0.01" iyz="0" izz="0.01"/></inertial></link>'
        for i in range(7)
    )
    axes = ("0 0 1", "0 1 0", "0 1 0", "0 0 1", "0 1 0", "0 0 1")
    joints = "".join(
        f'<joint name="j{i}" type="revolute"><parent link="l{i}"/><child link="l{i + 1}"/><origin xyz="0 0 0.2"/>'
        f'<axis xyz="{axis}"/><limit effort="0" velocity="10000"/></joint>'
        for i, axis in enumerate(axes)
    )
    (tmp_path / "mine.urdf").write_text(f'<robot name="mine">{links}{joints}</robot>')
    found = propose_robot_file("mine.urdf", tmp_path)
    assert not found.problem
    assert any("guessed" in word and "j0" in word for word in found.words)
    assert found.text.count("# guessed") >= 6
    (tmp_path / "robot.yaml").write_text(found.text)
    robot = RobotModel.from_file(tmp_path / "robot.yaml")
    assert (robot.velocity_limits == 1.5).all() and (robot.effort_limits == 10.0).all()


def test_a_robot_without_an_arm_is_refused_in_words(tmp_path: Path) -> None:
    (tmp_path / "box.urdf").write_text('<robot name="box"><link name="box"/></robot>')
    with pytest.raises(ValueError, match="has no arm"):
        propose_robot_file("box.urdf", tmp_path)


def test_a_urdf_alone_becomes_a_project_with_a_task_for_its_arm(tmp_path: Path) -> None:
    project, found = create_from_urdf(tmp_path / "known", ROBOTS + "z1_description/urdf/z1.urdf")
    assert project.robot().base_frame == project.task.base_frame == "world"
    assert project.task.endpoint == "arm" and set(project.task.topics) == {"object", "target"}
    assert project.task.model == Task.load(ROOT / "config" / "pick_place.yaml").model
    assert any("joint6 moves so little" in words for words in found.suspicions)
    with pytest.raises(ProjectError, match="not empty"):
        create_from_urdf(tmp_path / "known", ROBOTS + "z1_description/urdf/z1.urdf")

    own = resolve_urdf(ROBOTS + "ur_description/urdf/ur3_robot.urdf", tmp_path)
    project, _ = create_from_urdf(tmp_path / "own", str(own))
    assert (project.folder / own.name).read_bytes() == own.read_bytes() and project.robot().nv == 6
