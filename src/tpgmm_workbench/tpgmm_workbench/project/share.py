# SPDX-License-Identifier: Apache-2.0
"""A project as one .zip, and back; files of others are refused in words, or sound."""

from __future__ import annotations

from pathlib import Path

from tpgmm_workbench.project.project import Project


def export(project: Project, archive: str | Path) -> Path:
    """Write a project as one .zip, which is replaced as a whole.

    Parameters
    ----------
    project
        its finished demonstrations and models, with notes and a report of what they are
    archive
        the file

    Returns
    -------
    Path
        the file
    """
    raise NotImplementedError


def import_archive(archive: str | Path, folder: str | Path) -> Project:
    """Make a project of a .zip that anybody may have written.

    Parameters
    ----------
    archive
        the file
    folder
        of the new project; must not exist, or be empty

    Returns
    -------
    Project
        opened

    Raises
    ------
    ProjectError
        for a file that is no project, with what is wrong: absolute paths, "..", links, too many or too large files,
        task, robot or models that cannot be used
    """
    raise NotImplementedError
