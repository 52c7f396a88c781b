# SPDX-License-Identifier: Apache-2.0
"""Odd URDFs: what cannot be is refused with the reason, what changes nothing is read, mechanisms hold grippers."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

pytest.importorskip("pinocchio")

from robots import ARM_URDF, write_arm
from tpgmm_core.control.robot_check import suspicions
from tpgmm_core.robot.description import RobotFileError
from tpgmm_core.robot.model import RobotModel

TOOL_INERTIA = (
    '<inertia ixx="0.01" iyy="0.01" izz="0.01" ixy="0" ixz="0" iyz="0"/></inertial></link>\n<joint name="slide"'
)
SLIDE = '<joint name="slide" type="prismatic">'


def refusal(folder: Path, *replace: tuple[str, str], changes: dict[str, Any] | None = None) -> str:
    """Why the arm is refused with texts in its URDF replaced; empty where it is not."""
    path = write_arm(folder, changes)
    urdf = folder / "arm.urdf"
    text = urdf.read_text()
    for old, new in replace:
        assert old in text, old
        text = text.replace(old, new, 1)
    urdf.write_text(text)
    try:
        RobotModel.from_file(path)
    except RobotFileError as error:
        assert str(error).startswith(str(path))
        return str(error)
    return ""


def inertia(ixx: float, iyy: float, izz: float, ixy: float = 0.0) -> tuple[str, str]:
    numbers = f'<inertia ixx="{ixx}" iyy="{iyy}" izz="{izz}" ixy="{ixy}" ixz="0" iyz="0"/></inertial></link>'
    return TOOL_INERTIA, f'{numbers}\n<joint name="slide"'


# -- bodies


@pytest.mark.parametrize(
    "numbers", [(-0.01, 0.01, 0.01), (0.01, 0.01, -1e-5), (0.01, 0.01, 0.01, 0.02), (-0.01, -0.01, -0.01)]
)
def test_a_negative_principal_inertia_is_refused(tmp_path: Path, numbers: tuple[float, ...]) -> None:
    reason = refusal(tmp_path, inertia(*numbers))
    assert "what slide moves (tool) has the principal inertias" in reason and "none of which can be negative" in reason


def test_a_negative_mass_is_refused(tmp_path: Path) -> None:
    assert "link 'tool' has the mass -0.5 kg" in refusal(tmp_path, ('<mass value="0.5"/>', '<mass value="-0.5"/>'))


def test_what_is_impossible_of_a_link_alone_may_be_part_of_a_body(tmp_path: Path) -> None:
    antenna = (
        '<link name="antenna"><inertial><mass value="1e-6"/>'
        '<inertia ixx="-1e-8" iyy="1e-8" izz="1e-8" ixy="0" ixz="0" iyz="0"/></inertial></link>'
        '<joint name="glue" type="fixed"><parent link="tool"/><child link="antenna"/></joint></robot>'
    )
    assert refusal(tmp_path, ("</robot>", antenna)) == ""


def test_an_inertia_beyond_the_triangle_inequality_is_suspicious(tmp_path: Path) -> None:
    assert refusal(tmp_path, inertia(0.1, 0.01, 0.01)) == ""
    found = "\n".join(suspicions(RobotModel.from_file(tmp_path / "arm.yaml")))
    assert "what slide moves (tool) has the principal inertias 0.01, 0.01, 0.1 kg m^2" in found
    assert refusal(tmp_path, inertia(0.0201, 0.01, 0.01)) == ""
    assert "principal" not in "\n".join(suspicions(RobotModel.from_file(tmp_path / "arm.yaml")))


def test_a_point_with_a_mass_is_suspicious_and_refused_where_the_joint_turns_about_it(tmp_path: Path) -> None:
    assert refusal(tmp_path, inertia(0.0, 0.0, 0.0)) == ""
    found = "\n".join(suspicions(RobotModel.from_file(tmp_path / "arm.yaml")))
    assert "too small for a mass of 0.5 kg" in found
    turning = (SLIDE, '<joint name="slide" type="revolute">')
    reason = refusal(tmp_path, turning, inertia(0.0, 0.0, 0.0))
    assert "the joints slide move no inertia: tool has a mass of 0.5 kg, but an <inertia> of zeros" in reason
    geared = {"armature": {"slide": {"inertia": 0.01}}}
    assert refusal(tmp_path, turning, inertia(0.0, 0.0, 0.0), changes=geared) == ""


def test_inertias_and_lengths_in_other_units_are_suspicious(tmp_path: Path) -> None:
    assert refusal(tmp_path, inertia(1e4, 1e4, 1e4)) == ""
    found = "\n".join(suspicions(RobotModel.from_file(tmp_path / "arm.yaml")))
    assert "too large for a mass of 0.5 kg; is <inertia> in kg m^2?" in found and "in m?" not in found
    assert refusal(tmp_path, ('<origin xyz="1 0 0"/>', '<origin xyz="1000 0 0"/>')) == ""
    found = "\n".join(suspicions(RobotModel.from_file(tmp_path / "arm.yaml")))
    assert "from the base; are the lengths in the URDF in m?" in found


# -- what changes nothing


@pytest.mark.parametrize(
    "head",
    [
        b"\n\n",
        b"\r\n  \t",
        b"\xef\xbb\xbf",
        b"\xef\xbb\xbf\n",
        b'\n<?xml version="1.0"?>\n',
        b'<?xml version="1.0" encoding="utf-8"?>\n<!-- Gr\xc3\xb6\xc3\x9fe -->\n',
        b'<?xml version="1.0" encoding="ISO-8859-1"?>\n<!-- Gr\xf6\xdfe -->\n',
        b'<?xml version="1.0" encoding="windows-1252"?>\n<!-- \x93arm\x94 -->\n',
    ],
)
def test_what_stands_before_a_urdf_changes_nothing(tmp_path: Path, head: bytes) -> None:
    path = write_arm(tmp_path)
    content = (tmp_path / "arm.urdf").read_bytes()
    (tmp_path / "arm.urdf").write_bytes(head + content)
    assert RobotModel.from_file(path).nv == 2


@pytest.mark.parametrize("encoding", ["utf-16", "utf-8-sig"])
def test_a_urdf_of_another_encoding_is_read(tmp_path: Path, encoding: str) -> None:
    path = write_arm(tmp_path)
    (tmp_path / "arm.urdf").write_bytes((tmp_path / "arm.urdf").read_text().encode(encoding))
    assert RobotModel.from_file(path).nv == 2


@pytest.mark.parametrize(
    "replace",
    [
        ('<robot name="arm">', '<robot name="arm" xmlns="http://www.ros.org">'),
        ('<robot name="arm">', '<robot name="arm" xmlns:xacro="http://www.ros.org/wiki/xacro">'),
        ('<link name="base"/>', '<link name="base"><visual><geometry><mesh filename="package://no/a.dae"/></geometry></visual></link>'),
        ("</robot>", '<gazebo reference="tool"><x>${a}</x></gazebo><ros2_control><joint/></ros2_control></robot>'),
        ("</robot>", '<transmission name="t"><joint name="turn"/></transmission></robot>'),
    ],
)  # fmt: skip
def test_what_the_nodes_do_not_need_is_left_alone(tmp_path: Path, replace: tuple[str, str]) -> None:
    assert refusal(tmp_path, replace) == ""


# -- what cannot be meant


@pytest.mark.parametrize(
    ("replace", "reason"),
    [
        (('<parent link="upper"/>', '<parent link="uper"/>'), "joint 'slide' has the parent link 'uper', which does"),
        (('<child link="tool"/>', ""), "joint 'slide' has the child link '', which does not exist"),
        (('<child link="tool"/>', '<child link="upper"/>'), "link 'upper' is moved by two joints, 'turn' and 'slide'"),
        (('<parent link="base"/>', '<parent link="tool"/>'), "joints form a loop|moved by two|parts that no joint"),
        (("</robot>", '<link name="loose"/></robot>'), "2 parts that no joint connects: world, loose"),
        (('<link name="base"/>', '<link name="base"/><link name="base"/>'), "several links have the name base"),
        (('name="slide"', 'name="turn"'), "several joints have the name turn"),
        ((' name="slide"', ""), "a joint has no name"),
        (('<link name="base"/>', f'<link name="{"b" * 300}"/>'), "a link has a name of more than 200 characters"),
        (('type="prismatic"', 'type="slider"'), "joint 'slide' of arm.urdf is of type 'slider', which"),
        ((' type="prismatic"', ""), "joint 'slide' of arm.urdf has no type"),
        (('type="prismatic"', 'type="floating"'), "joint 'slide' of arm.urdf is floating; only joints of one degree"),
        (('<axis xyz="1 0 0"/>', '<axis xyz="0 0 0"/>'), "joint 'slide' of arm.urdf has an axis of length 0"),
        (('<axis xyz="1 0 0"/>', '<axis xyz="1 0"/>'), "joint 'slide': xyz of <axis> is '1 0', expected 3"),
        (('damping="0.3"', 'damping="0,3"'), "joint 'turn': damping of <dynamics> is '0,3', expected a finite number"),
        (('effort="20"', 'effort="nan"'), "joint 'slide': effort of <limit> is 'nan', expected a finite number"),
        (('effort="20"', 'effort="-20"'), "joint 'slide': effort of <limit> is '-20', which cannot be negative"),
        (('<mass value="0.5"/>', ""), "link 'tool': its <inertial> lacks value of <mass>"),
        (('<mass value="0.5"/>', '<mass value="1e999"/>'), "link 'tool': value of <mass> is '1e999'"),
        (('<robot name="arm">', '<sdf version="1.6"><robot name="arm">'), "no XML|another kind of XML"),
        (('<robot name="arm">', '<robot name="${name}">'), "is a xacro, not a URDF"),
        (('<origin xyz="1 0 0"/>', '<origin xyz="${length} 0 0"/>'), "is a xacro, not a URDF"),
        (('<link name="world"/>', '<xacro:include filename="a"/><link name="world"/>'), "is a xacro, not a URDF"),
    ],
)  # fmt: skip
def test_what_cannot_be_meant_is_named(tmp_path: Path, replace: tuple[str, str], reason: str) -> None:
    found = refusal(tmp_path, replace)
    assert found and any(words in found for words in reason.split("|")), found
    assert len(found) < 700


@pytest.mark.parametrize("kind", ["sdf", "mujoco", "html"])
def test_another_kind_of_xml_is_called_so(tmp_path: Path, kind: str) -> None:
    path = write_arm(tmp_path)
    (tmp_path / "arm.urdf").write_text(f"<{kind}><model/></{kind}>")
    with pytest.raises(RobotFileError, match=f"another kind of XML, whose root is <{kind}>; expected <robot>"):
        RobotModel.from_file(path)


def test_a_urdf_that_is_not_there_is_named_with_its_folder(tmp_path: Path) -> None:
    reason = refusal(tmp_path, changes={"urdf": "arm.urdf.xacro"})
    assert f"no URDF 'arm.urdf.xacro' in {tmp_path}; expected a file in this folder or below it" in reason
    assert "expand a xacro first" in reason and "example-robot-data" not in reason


def test_all_limits_that_an_exporter_left_at_zero_are_named_at_once(tmp_path: Path) -> None:
    limits = '<limit lower="0" upper="0" effort="0" velocity="0"/>'
    replace = (('<limit lower="-2" upper="2" effort="10" velocity="2"/>', limits),)
    reason = refusal(tmp_path, *replace, ('<limit lower="0" upper="0.5" effort="20" velocity="1"/>', limits))
    assert "effort limit 0 of 'turn' is not credible (expected above 0, up to 1000 N m)" in reason
    assert reason.endswith("The same is true for the effort limits of slide")


def test_names_that_yaml_reads_as_numbers_are_to_be_quoted(tmp_path: Path) -> None:
    urdf = ('name="slide"', 'name="1"')
    groups, home = {"all": ["turn", 1]}, {"turn": 0.0, 1: 0.2}
    assert "in quotes, if YAML could read them as something else" in refusal(
        tmp_path, urdf, changes={"joint_groups": groups}
    )
    quoted = {"joint_groups": {"all": ["turn", "1"]}, "friction": None}
    assert "'home' has the key 1, expected a word (put on, off" in refusal(
        tmp_path, urdf, changes={**quoted, "home": home}
    )
    assert refusal(tmp_path, urdf, changes={**quoted, "home": {"turn": 0.0, "1": 0.2}}) == ""


# -- joints that mimic others

FINGER = (
    '<link name="{name}"><inertial><mass value="0.1"/><origin xyz="0.02 0 0"/>'
    '<inertia ixx="1e-4" iyy="1e-4" izz="1e-4" ixy="0" ixz="0" iyz="0"/></inertial></link>'
    '<joint name="{name}_joint" type="{type}"><parent link="tool"/><child link="{name}"/><axis xyz="0 1 0"/>'
    "{limit}{mimic}</joint>"
)
A_MIMIC = '<mimic joint="a_joint"/>'
LIMIT = '<limit lower="0" upper="0.8" effort="50" velocity="0.5"/>'


def gripper(*fingers: tuple[str, str, str, str]) -> tuple[str, str]:
    """Fingers (name, type, limit, mimic) on the arm's tool."""
    parts = [FINGER.format(name=name, type=kind, limit=limit, mimic=mimic) for name, kind, limit, mimic in fingers]
    return "</robot>", "".join(parts) + "</robot>"


TWO = gripper(
    ("knuckle", "revolute", LIMIT, ""),
    ("left", "continuous", "", '<mimic joint="knuckle_joint" multiplier="-1" offset="0.1"/>'),
    ("right", "continuous", "", '<mimic joint="left_joint" multiplier="2"/>'),
)
HOME = {"turn": 0.0, "slide": 0.25}


@pytest.mark.parametrize(
    ("changes", "joints"),
    [
        ({"home": {**HOME, "knuckle_joint": 0.3}}, ["turn", "slide", "knuckle_joint"]),
        ({"home": HOME, "locked": {"knuckle_joint": 0.3}}, ["turn", "slide"]),
    ],
)
def test_joints_that_mimic_others_stand_where_these_put_them(
    tmp_path: Path, changes: dict[str, Any], joints: list[str]
) -> None:
    assert refusal(tmp_path, TWO, changes=changes) == ""
    robot = RobotModel.from_file(tmp_path / "arm.yaml")
    assert sorted(robot.joint_names) == sorted(joints)
    data = robot.create_data()
    data.update(robot.home)
    # about y: knuckle 0.3, left -0.3 + 0.1, right twice that
    for link, angle in (("knuckle", 0.3), ("left", -0.2), ("right", -0.4)):
        turned = data.frame_pose(robot.frame_id(link))[3:]
        np.testing.assert_allclose(turned, [0.0, np.sin(angle / 2), 0.0, np.cos(angle / 2)], atol=1e-9)


@pytest.mark.parametrize(
    ("replace", "changes", "reason"),
    [
        (TWO, {}, "home lacks the joints knuckle_joint; give their positions, or lock those that"),
        (
            TWO,
            {"home": {**HOME, "knuckle_joint": 0.3, "left_joint": 0.0}},
            "effort limit 0 of 'left_joint' is not credible.* It mimics knuckle_joint: leave it out of home,",
        ),
        (
            TWO,
            {"joint_groups": {"all": ["turn", "slide"], "grip": ["left_joint"]}},
            "joint_groups names left_joint, which has no motor but mimics 'knuckle_joint'",
        ),
        (gripper(("a", "revolute", LIMIT, '<mimic joint="nobody"/>')), {}, "'a_joint' mimics 'nobody', which does not"),
        (gripper(("a", "revolute", LIMIT, "<mimic/>")), {}, "'a_joint' mimics '', which does not exist"),
        (gripper(("a", "revolute", LIMIT, '<mimic joint="a_joint"/>')), {}, "'a_joint' mimics itself"),
        (
            gripper(("a", "revolute", LIMIT, '<mimic joint="b_joint"/>'), ("b", "revolute", "", A_MIMIC)),
            {},
            "'a_joint' mimics itself, through a_joint, b_joint",
        ),
        (
            gripper(("a", "revolute", LIMIT, '<mimic joint="turn" multiplier="x"/>')),
            {},
            "joint 'a_joint': multiplier of <mimic> is 'x', expected a finite number",
        ),
        (
            gripper(("a", "revolute", LIMIT, '<mimic joint="turn" multiplier="-1"/>')),
            {"endpoints": {"tool": {"frame": "a", "joints": "all"}}},
            "'tool' is moved by 'a_joint', which has no motor but mimics 'turn'",
        ),
    ],
)  # fmt: skip
def test_what_is_wrong_with_a_mechanism_is_said(
    tmp_path: Path, replace: tuple[str, str], changes: dict[str, Any], reason: str
) -> None:
    import re

    found = refusal(tmp_path, replace, changes={"home": HOME, **changes})
    assert re.search(reason, found), found


def test_an_end_point_on_a_finger_may_stand_on_a_mechanism_that_is_locked(tmp_path: Path) -> None:
    changes = {"home": HOME, "locked": {"knuckle_joint": 0.3}, "endpoints": {"tip": {"frame": "left", "joints": "all"}}}
    assert refusal(tmp_path, TWO, changes=changes) == ""


def test_a_mechanism_that_the_arm_moves_is_suspicious(tmp_path: Path) -> None:
    assert (
        refusal(tmp_path, gripper(("strut", "continuous", "", '<mimic joint="turn"/>')), changes={"home": HOME}) == ""
    )
    found = suspicions(RobotModel.from_file(tmp_path / "arm.yaml"))
    assert "strut_joint mimics turn, but is not simulated: it stays at its home position" in found


def test_the_arm_of_these_tests_is_sound(tmp_path: Path) -> None:
    assert refusal(tmp_path) == "" and TOOL_INERTIA in ARM_URDF and SLIDE in ARM_URDF
