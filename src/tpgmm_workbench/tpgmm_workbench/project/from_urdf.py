# SPDX-License-Identifier: Apache-2.0
"""A new project for a robot of which there is a URDF and nothing else: its robot file and its task are proposed."""

from __future__ import annotations

import shutil
from pathlib import Path
from tempfile import TemporaryDirectory

import yaml

from tpgmm_core.common.text import one_line
from tpgmm_core.robot.description import PACKAGE_SCHEME
from tpgmm_core.robot.model import RobotModel
from tpgmm_ros.runtime.resources import config_file
from tpgmm_workbench.project import folder as files
from tpgmm_workbench.project.errors import ProjectError
from tpgmm_workbench.project.project import Project
from tpgmm_workbench.project.wizard import Proposal, propose_robot_file

TASK = """\
# Proposed for a simulated robot: its hand goes from an object to a target, wherever they lie.
name: {name}
base_frame: {base}
movement: endpoint/{endpoint}/pose
endpoint: {endpoint}
frames:
  object: {{topic: object/pose}}
  target: {{topic: target/pose}}
  robot: {{pose: [0, 0, 0, 0, 0, 0, 1]}}
model: {model}
"""
NAME = "object_to_target"
#: Whose retrieval method and settings a new task has.
LIKE = "pick_place.yaml"


def create_from_urdf(folder: str | Path, urdf: str) -> tuple[Project, Proposal]:
    """Make a project for a robot that has no robot file yet; its first arm is the one that moves.

    Parameters
    ----------
    folder
        must not exist, or be empty
    urdf
        package://NAME/path, or the path of a URDF, which is copied

    Returns
    -------
    tuple[Project, Proposal]
        the project; and what was chosen and why, and what is suspicious, for the user to look at

    Raises
    ------
    RobotFileError
        for a URDF that cannot be read, and a robot without arms
    ProjectError
        for a robot of which no file that can be used is found, and for a folder that is not empty
    OSError
        where the folder cannot be written
    """
    path = Path(urdf)
    is_package = urdf.startswith(PACKAGE_SCHEME)
    found = propose_robot_file(urdf if is_package else path.name, path.parent)
    if found.problem:
        raise ProjectError(f"write a robot file for {one_line(urdf)} by hand: what is proposed has {found.problem}")
    with TemporaryDirectory() as made:
        robot, task = Path(made) / files.ROBOT, Path(made) / files.TASK
        if not is_package:
            shutil.copyfile(path, robot.with_name(path.name))
        robot.write_text(found.text)
        base = RobotModel.from_file(robot).base_frame
        task.write_text(TASK.format(name=NAME, base=base, endpoint=found.endpoints[0], model=_settings()))
        return Project.create(folder, task, robot), found


def _settings() -> str:
    settings = yaml.safe_load(config_file(LIKE).read_text(encoding="utf-8"))["model"]
    return str(yaml.safe_dump(settings, default_flow_style=True, sort_keys=False, width=200)).strip()
