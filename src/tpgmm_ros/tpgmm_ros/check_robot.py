# SPDX-License-Identifier: Apache-2.0
"""Reads a robot file and its URDF and prints what the nodes make of them: joints, limits, end points, workspace.

Ends with 1 where the file cannot be used. What is suspicious, though it can be used, stands at the end.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from tpgmm_core.robot.check import suspicions, workspace
from tpgmm_core.robot.description import RobotFileError
from tpgmm_core.robot.model import RobotModel
from tpgmm_ros.reporting import format_table

JOINT_HEADER = ("joint", "groups", "lower", "upper", "home", "velocity", "effort", "carries", "viscous", "coulomb")
ENDPOINT_HEADER = ("end point", "frame", "joints", "x y z at home", "reaches x", "y", "z")


def main(arguments: Sequence[str] | None = None) -> int:
    parser = argparse.ArgumentParser(prog="check_robot", description=__doc__)
    parser.add_argument("robot", type=Path, help="robot file (YAML)")
    try:
        robot = RobotModel.from_file(parser.parse_args(arguments).robot)
    except RobotFileError as error:
        print(f"error: {error}", file=sys.stderr)
        return 1
    mass = sum(inertia.mass for inertia in robot.pinocchio.inertias[1:])
    print(f"{robot.nv} joints, base frame {robot.base_frame}, {mass:.1f} kg moved")
    print("rad, m; rad/s, m/s; N m, N; `carries` is the torque that holds the robot at home\n")
    print(format_table(JOINT_HEADER, _joint_rows(robot)))
    print()
    print(format_table(ENDPOINT_HEADER, _endpoint_rows(robot)))
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
    data = robot.create_data()
    data.update(robot.home)
    rows = []
    for name, end in robot.endpoints.items():
        reach = [f"{lower:.2f} to {upper:.2f}" for lower, upper in workspace(robot, name).T]
        home = " ".join(f"{value:.3f}" for value in data.pose(name)[:3].round(3) + 0.0)
        rows.append((name, end.frame, end.joints, home, *reach))
    return rows


if __name__ == "__main__":
    sys.exit(main())
