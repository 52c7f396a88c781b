# SPDX-License-Identifier: Apache-2.0
"""A project as one .zip, and back; files of others are refused in words, or sound."""

from __future__ import annotations

import re
import stat
import zipfile
from collections.abc import Iterator
from pathlib import Path, PurePosixPath

from tpgmm_core.common.atomic_file import write_atomically
from tpgmm_core.common.text import one_line, shown
from tpgmm_core.robot.model import RobotModel
from tpgmm_workbench.project import folder as files
from tpgmm_workbench.project.errors import ProjectError
from tpgmm_workbench.project.notes import ModelNotes, Notes, read_notes
from tpgmm_workbench.project.project import Project
from tpgmm_workbench.project.taught import NOTES

MOST_FILES = 5000
MOST_BYTES = 2_000_000_000
"""Of all files, unpacked."""
MOST_PACKED = 200
"""No file of a project packs this well; one that does unfolds to fill the disk."""
SMALL = 1_000_000
REPORT = "report.txt"
_BAG_FILE = r"[\w.-]{1,100}\.(?:mcap|db3)(?:\.zstd)?"
_ALLOWED = re.compile(
    rf"{files.TASK}|{files.ROBOT}|{REPORT}|(?:[\w-][\w.-]*/){{0,4}}[\w-][\w.-]*\.urdf"
    rf"|{files.DEMONSTRATIONS}/\d{{{files.DIGITS},9}}/(?:metadata\.yaml|{re.escape(NOTES)}|{_BAG_FILE})"
    rf"|{files.MODELS}/\d{{{files.DIGITS},9}}\.(?:tpgmm|json)"
)
"""What a project consists of, and nothing else."""
CHUNK = 1 << 20


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
    target = Path(archive)

    def write(draft: Path) -> None:
        with zipfile.ZipFile(draft, "w", zipfile.ZIP_DEFLATED) as packed:
            for path in _members(project):
                packed.write(path, path.relative_to(project.folder).as_posix())
            packed.writestr(REPORT, report(project))

    write_atomically(target, write)
    return target


def report(project: Project) -> str:
    """What a project holds, for people."""
    lines = [f"project {project.folder.name}, task {project.task.name}", ""]
    for one in project.demonstrations():
        state = "used" if one.is_used else one.problem or "not used"
        length = "" if one.whole is None else f", {one.recording.duration:.1f} s"
        lines.append(f"demonstration {one.number}: {state}{length}; {one.notes.comment}".rstrip("; "))
    for model in project.models():
        undone = ", undone" if model.notes.is_undone else ""
        numbers = ", ".join(map(str, model.notes.learned_from))
        lines += ["", f"model {model.number}{undone}, from the demonstrations {numbers}:", *model.notes.words]
    return "\n".join(lines) + "\n"


def _members(project: Project) -> Iterator[Path]:
    """Files of a project that are finished; nothing that somebody put beside them."""
    for path in sorted(project.folder.rglob("*")):
        name = path.relative_to(project.folder).as_posix()
        if _ALLOWED.fullmatch(name) and name != REPORT and path.is_file() and not path.is_symlink():
            yield path


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
    try:
        with zipfile.ZipFile(archive) as packed:
            members = _checked(packed)
            files.make_folder(Path(folder), lambda draft: _unpack(packed, members, draft))
    except (zipfile.BadZipFile, zipfile.LargeZipFile, NotImplementedError, RuntimeError, EOFError, OSError) as error:
        raise ProjectError(f"{one_line(archive)} cannot be unpacked: {one_line(error)}") from error
    return Project.open(folder)


def _checked(packed: zipfile.ZipFile) -> list[zipfile.ZipInfo]:
    """The files of an archive, if all of them may be part of a project. Nothing was unpacked yet."""
    entries = [entry for entry in packed.infolist() if not entry.is_dir()]
    if len(entries) > MOST_FILES:
        raise ProjectError(f"the archive holds {len(entries)} files; a project has {MOST_FILES} at most")
    total = sum(entry.file_size for entry in entries)
    if total > MOST_BYTES:
        raise ProjectError(f"the archive unpacks to {total / 1e6:.0f} MB; a project has {MOST_BYTES / 1e6:.0f} at most")
    names = set()
    for entry in entries:
        name, path = entry.filename, PurePosixPath(entry.filename)
        if path.is_absolute() or ".." in path.parts or "\\" in name or ":" in name:
            raise ProjectError(f"the archive holds {shown(name)}, a path outside its folder: it is not unpacked")
        if stat.S_IFMT(entry.external_attr >> 16) not in (0, stat.S_IFREG):
            raise ProjectError(f"the archive holds {shown(name)}, which is not a regular file")
        if not _ALLOWED.fullmatch(name):
            raise ProjectError(f"the archive holds {shown(name)}, which is not part of a project")
        if name.lower() in names:
            raise ProjectError(f"the archive holds {shown(name)} twice")
        if entry.file_size > max(SMALL, MOST_PACKED * entry.compress_size):
            raise ProjectError(f"the archive's {shown(name)} unfolds to {entry.file_size / 1e6:.0f} MB: not plausible")
        if entry.flag_bits & 1:
            raise ProjectError(f"the archive's {shown(name)} is encrypted; export it without a password")
        names.add(name.lower())
    if missing := [name for name in (files.TASK, files.ROBOT) if name not in names]:
        raise ProjectError(f"the archive is not a project: it lacks {' and '.join(missing)}")
    return entries


def _unpack(packed: zipfile.ZipFile, members: list[zipfile.ZipInfo], draft: Path) -> None:
    left = MOST_BYTES
    for entry in members:
        target = draft / entry.filename
        target.parent.mkdir(parents=True, exist_ok=True)
        with packed.open(entry) as source, target.open("xb") as file:
            while chunk := source.read(CHUNK):  # sizes in the archive may be lies
                left -= len(chunk)
                if left < 0:
                    raise ProjectError(f"the archive unpacks to more than {MOST_BYTES / 1e6:.0f} MB")
                file.write(chunk)
    for name in (files.DEMONSTRATIONS, files.MODELS):
        (draft / name).mkdir(exist_ok=True)
    _try(draft)


def _try(draft: Path) -> None:
    """Read what was unpacked, by the same safe readers as ever. Raises ProjectError for what cannot be used.

    Bags are read when they are used; one that cannot be is a demonstration with a problem, here as anywhere.
    """
    project = Project.open(draft)
    try:
        RobotModel.from_file(project.robot_file)
    except ValueError as error:
        raise ProjectError(f"the archive's robot cannot be used: {error}") from error
    for path in files.numbered(draft / files.DEMONSTRATIONS).values():
        if (path / NOTES).exists():
            read_notes(path / NOTES, Notes)
    for path in files.numbered(draft / files.MODELS, ".json").values():
        read_notes(path, ModelNotes)
    for model in project.models():
        project.load(model)
