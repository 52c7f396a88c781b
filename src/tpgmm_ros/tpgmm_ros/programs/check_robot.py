# SPDX-License-Identifier: Apache-2.0
"""Reads a robot file and its URDF, and prints them as the nodes use them: joints, limits, end points, workspace.

Usable but suspicious values are listed at the end. The exit status is 1 where the file cannot be used.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence

import numpy as np

from tpgmm_core.common.report import format_table
from tpgmm_core.common.text import one_line
from tpgmm_core.common.types import Array
from tpgmm_core.control.robot_check import suspicions, workspace
from tpgmm_core.geometry.quaternion import roll_pitch_yaw
from tpgmm_core.robot.description import RobotFileError
from tpgmm_core.robot.model import RobotModel
from tpgmm_ros.runtime.entry import a_path

JOINT_HEADER = ("joint", "groups", "lower", "upper", "home", "velocity", "effort", "carries", "viscous", "coulomb")
UNITS = """\
lower, upper, home: rad, m; velocity: rad/s, m/s; effort and `carries`, the torque that holds the robot at home: N m, N;
viscous: N m s/rad, N s/m; coulomb: N m, N
"""
ENDPOINT_HEADER = ("end point", "frame", "joints", "reaches x (m)", "y (m)", "z (m)")
POSE_HEADER = ("at home", "x y z (m)", "qx qy qz qw", "roll pitch yaw (deg)")


def main(arguments: Sequence[str] | None = None) -> int:
    """Check a robot file; returns the exit status, 0 where the nodes can use it."""
    parser = argparse.ArgumentParser(prog="check_robot", description=__doc__)
    parser.add_argument("robot", type=a_path, help="robot file (YAML)")
    options = parser.parse_args(arguments)
    try:
        robot = RobotModel.from_file(options.robot)
    except (RobotFileError, OSError) as error:
        print(f"error: {one_line(error)}", file=sys.stderr)
        return 1
    mass = sum(inertia.mass for inertia in robot.pinocchio.inertias[1:])
    print(f"{robot.nv} joints, base frame {robot.base_frame}, {mass:.1f} kg moved")
    print(UNITS)
    print(format_table(JOINT_HEADER, _joint_rows(robot)))
    print()
    print(format_table(ENDPOINT_HEADER, _endpoint_rows(robot)))
    print(f"\nend points in the frame {robot.base_frame}, with the robot at home")
    print(format_table(POSE_HEADER, _pose_rows(robot)))
    found = suspicions(robot)
    print("\nnothing suspicious" if not found else "\nsuspicious:")
    for text in found:
        print(f"- {text}")
    return 0


def _joint_rows(robot: RobotModel) -> list[tuple[str | float, ...]]:
    carried = robot.create_data().gravity(robot.home)
    return [
        (
            joint,
            " ".join(group for group, members in robot.joint_groups.items() if joint in members) or "-",
            *(
                float(values[i])
                for values in (
                    robot.lower_limits,
                    robot.upper_limits,
                    robot.home,
                    robot.velocity_limits,
                    robot.effort_limits,
                    np.round(carried, 3) + 0.0,
                    robot.viscous_friction,
                    robot.coulomb_friction,
                )
            ),
        )
        for i, joint in enumerate(robot.joint_names)
    ]


def _endpoint_rows(robot: RobotModel) -> list[tuple[str, ...]]:
    rows = []
    for name, end in robot.endpoints.items():
        reach = [f"{lower:.2f} to {upper:.2f}" for lower, upper in workspace(robot, name).T]
        rows.append((name, end.frame, end.joints, *reach))
    return rows


def _pose_rows(robot: RobotModel) -> list[tuple[str, str, str, str]]:
    """How the hands stand and are turned, as a PoseStamped has it."""
    data = robot.create_data()
    data.update(robot.home)
    rows = []
    for name in robot.endpoints:
        pose = data.pose(name)
        pose[3:] *= -1.0 if pose[6] < 0.0 else 1.0
        turned = np.degrees(roll_pitch_yaw(pose[3:]))
        rows.append((name, _numbers(pose[:3], 3), _numbers(pose[3:], 4), _numbers(turned, 1)))
    return rows


def _numbers(values: Array, digits: int) -> str:
    return " ".join(f"{value:.{digits}f}" for value in values.round(digits) + 0.0)  # no -0.0


if __name__ == "__main__":
    sys.exit(main())
