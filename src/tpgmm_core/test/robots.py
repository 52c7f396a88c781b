# SPDX-License-Identifier: Apache-2.0
"""Robots for the tests: the project's, one with endless joints, and an arm small enough to know every answer."""

import copy
from pathlib import Path
from typing import Any

import yaml

CONFIG = Path(__file__).resolve().parents[3] / "config"
BAXTER = CONFIG / "baxter.yaml"

# Three of its six joints turn for ever
KINOVA: dict[str, Any] = {
    "urdf": "package://example-robot-data/robots/kinova_description/robots/kinova.urdf",
    "base_frame": "j2s6s200_link_base",
    "joint_groups": {"arm": [f"j2s6s200_joint_{i}" for i in range(1, 7)]},
    "endpoints": {"hand": {"frame": "j2s6s200_end_effector", "joints": "arm"}},
    "home": {f"j2s6s200_joint_{i}": q for i, q in enumerate([3.0, 2.8, 1.4, -3.5, 1.4, 6.2], start=1)},
}

# A turned base on a pedestal, two joints, and a tool: small enough to know every answer
ARM_URDF = """<robot name="arm"><link name="world"/><link name="base"/>
<joint name="mount" type="fixed"><parent link="world"/><child link="base"/>
  <origin xyz="0 0 1" rpy="0 0 1.5707963267948966"/></joint>
<link name="upper"><inertial><mass value="1"/><origin xyz="0.5 0 0"/>
  <inertia ixx="0.01" iyy="0.01" izz="0.01" ixy="0" ixz="0" iyz="0"/></inertial></link>
<joint name="turn" type="{turn}"><parent link="base"/><child link="upper"/><axis xyz="0 0 1"/>
  <limit lower="-2" upper="2" effort="{effort}" velocity="2"/><dynamics damping="0.3"/></joint>
<link name="tool"><inertial><mass value="0.5"/><origin xyz="0.1 0 0"/>
  <inertia ixx="0.01" iyy="0.01" izz="0.01" ixy="0" ixz="0" iyz="0"/></inertial></link>
<joint name="slide" type="prismatic"><parent link="upper"/><child link="tool"/><axis xyz="1 0 0"/>
  <origin xyz="1 0 0"/><limit lower="0" upper="0.5" effort="20" velocity="1"/></joint></robot>"""
# A gripper for the arm: its second finger follows the first
GRIPPER_URDF = """<link name="finger"><inertial><mass value="0.1"/>
  <inertia ixx="1e-4" iyy="1e-4" izz="1e-4" ixy="0" ixz="0" iyz="0"/></inertial></link>
<joint name="grip" type="prismatic"><parent link="tool"/><child link="finger"/><axis xyz="0 1 0"/>
  <origin xyz="0.2 0 0"/><limit lower="0" upper="0.04" effort="40" velocity="0.2"/></joint>
<link name="thumb"><inertial><mass value="0.1"/>
  <inertia ixx="1e-4" iyy="1e-4" izz="1e-4" ixy="0" ixz="0" iyz="0"/></inertial></link>
<joint name="grip_too" type="prismatic"><parent link="tool"/><child link="thumb"/><axis xyz="0 -1 0"/>
  <origin xyz="0.2 0 0"/><limit lower="0" upper="0.04" effort="40" velocity="0.2"/><mimic joint="grip"/></joint>
</robot>"""
ARM: dict[str, Any] = {
    "urdf": "arm.urdf",
    "base_frame": "base",
    "joint_groups": {"all": ["turn", "slide"]},
    "endpoints": {"tool": {"frame": "tool", "joints": "all"}},
    "friction": {"all": {"coulomb": 0.2}, "slide": {"coulomb": 1.0, "viscous": 0.1}},
    "home": {"slide": 0.25, "turn": 0.0},
}


def write_arm(
    folder: Path,
    changes: dict[str, Any] | None = None,
    effort: float = 10,
    turn: str = "revolute",
    replace: tuple[str, str] = ("", ""),
) -> Path:
    """The arm's robot file with other keys (None: without it), beside its URDF with a text in it replaced."""
    (folder / "arm.urdf").write_text(ARM_URDF.format(effort=effort, turn=turn).replace(*replace))
    content = {**copy.deepcopy(ARM), **(changes or {})}
    path = folder / "arm.yaml"
    path.write_text(yaml.safe_dump({key: value for key, value in content.items() if value is not None}))
    return path
