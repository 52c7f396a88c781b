# SPDX-License-Identifier: Apache-2.0
"""The folder of a project: what lies where, and how things come there as a whole and stay when the machine dies."""

from __future__ import annotations

import contextlib
import errno
import os
import re
import secrets
import shutil
from collections.abc import Callable
from pathlib import Path

from tpgmm_core.common.text import one_line
from tpgmm_core.common.yaml_sections import Section
from tpgmm_core.robot.description import PACKAGE_SCHEME, RobotDescription, RobotFileError
from tpgmm_workbench.project.errors import ProjectError

TASK, ROBOT = "task.yaml", "robot.yaml"
DEMONSTRATIONS, MODELS = "demonstrations", "models"
PARTIAL = ".partial"
"""Where what is not finished lies, in the folder that it will be in; nothing in it counts."""
DIGITS = 4
_NUMBERED = re.compile(rf"\d{{{DIGITS},9}}")


def named(number: int) -> str:
    """Name of the folder or file of a number."""
    return f"{number:0{DIGITS}d}"


def numbered(folder: Path, suffix: str = "") -> dict[int, Path]:
    """What lies in a folder under a number, in order; nothing of what is not finished."""
    found = {}
    for path in folder.iterdir() if folder.is_dir() else ():
        stem = path.name.removesuffix(suffix)
        if path.name == stem + suffix and _NUMBERED.fullmatch(stem) and not path.is_symlink():
            found[int(stem)] = path
    return dict(sorted(found.items()))


def free_number(folder: Path) -> int:
    """The next number: above all that was ever given, for unfinished things too, since these are kept."""
    taken = [0]
    for place in (folder, folder / PARTIAL):
        for path in place.iterdir() if place.is_dir() else ():
            stem = path.name.split(".")[0]
            if _NUMBERED.fullmatch(stem):
                taken.append(int(stem))
    return max(taken) + 1


def make_folder(folder: Path, fill: Callable[[Path], None]) -> None:
    """Make a folder that is there as a whole, or not at all.

    Parameters
    ----------
    folder
        must not exist, or be empty; the folder that it lies in exists
    fill
        gets an empty folder beside it, which it fills

    Raises
    ------
    ProjectError
        where there is something already
    OSError
        where it cannot be written
    """
    folder = Path(os.path.abspath(folder))
    if folder.exists() and (not folder.is_dir() or any(folder.iterdir())):
        raise ProjectError(f"{one_line(folder)} exists and is not empty; give another folder, or open it")
    folder.parent.mkdir(parents=True, exist_ok=True)
    draft = folder.with_name(f".{secrets.token_hex(8)}.part")
    draft.mkdir()
    try:
        fill(draft)
        place(draft, folder)
    except BaseException:
        shutil.rmtree(draft, ignore_errors=True)
        raise


def place(draft: Path, folder: Path) -> None:
    """Put a folder in its place when all that is in it is on the disk.

    Raises
    ------
    ProjectError
        where something is in that place
    """
    sync_tree(draft)
    try:
        os.rename(draft, folder)  # replaces an empty folder, and nothing else
    except OSError as error:
        if error.errno in (errno.EEXIST, errno.ENOTEMPTY, errno.ENOTDIR):
            raise ProjectError(f"{one_line(folder)} exists already and is not replaced") from None
        raise
    sync(folder.parent)


def sync_tree(folder: Path) -> None:
    """Wait until all that is in a folder is on the disk."""
    for here, _, files in os.walk(folder):
        for name in files:
            sync(Path(here, name))
        sync(Path(here))


def sync(path: Path) -> None:
    """Wait until a file, or the names in a folder, are on the disk."""
    handle = os.open(path, os.O_RDONLY)
    try:
        with contextlib.suppress(OSError):  # some file systems cannot do this for folders
            os.fsync(handle)
    finally:
        os.close(handle)


def copy_robot(robot_file: Path, draft: Path) -> None:
    """Copy a robot file, and its URDF where that lies beside it.

    Raises
    ------
    ProjectError
        for a robot file that cannot be used
    """
    try:
        urdf = RobotDescription.from_file(robot_file).urdf
        reference = str(Section.load(robot_file, "a robot file").values["urdf"])
    except (RobotFileError, ValueError) as error:
        raise ProjectError(str(error)) from error
    shutil.copyfile(robot_file, draft / ROBOT)
    if not reference.startswith(PACKAGE_SCHEME):
        target = draft / reference
        target.parent.mkdir(parents=True, exist_ok=True)
        shutil.copyfile(urdf, target)
