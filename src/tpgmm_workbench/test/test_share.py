# SPDX-License-Identifier: Apache-2.0
"""A project goes out as one file and comes back; what others wrote is refused in words, or sound."""

from __future__ import annotations

import stat
import zipfile
from pathlib import Path

import pytest

from tpgmm_workbench.project.errors import ProjectError
from tpgmm_workbench.project.project import Project
from tpgmm_workbench.project.share import export, import_archive

ROOT = Path(__file__).resolve().parents[3]
BAG = ROOT / "bags" / "pick_place" / "demo_01"
TASK, ROBOT = ROOT / "config" / "pick_place.yaml", ROOT / "config" / "baxter.yaml"


def test_what_was_exported_is_imported_alike(tmp_path: Path) -> None:
    project = Project.create(tmp_path / "mine", TASK, ROBOT)
    project.add_bag(BAG, comment="as one does it")
    (project.folder / "secret.txt").write_text("not part of the project")
    archive = export(project, tmp_path / "mine.zip")
    with zipfile.ZipFile(archive) as packed:
        assert "secret.txt" not in packed.namelist()
        assert "as one does it" in packed.read("report.txt").decode()
    again = import_archive(archive, tmp_path / "again")
    assert [one.notes for one in again.demonstrations()] == [one.notes for one in project.demonstrations()]
    mine, its = project.demonstration(1).recording, again.demonstration(1).recording
    assert (mine.movement == its.movement).all() and (mine.times == its.times).all()


def entry(name: str, mode: int = stat.S_IFREG | 0o644) -> zipfile.ZipInfo:
    made = zipfile.ZipInfo(name)
    made.external_attr = mode << 16
    made.compress_type = zipfile.ZIP_DEFLATED
    return made


@pytest.mark.parametrize(
    ("bad", "content", "words"),
    [
        (entry("../task.yaml"), b"x", "a path outside"),
        (entry("/etc/passwd"), b"x", "a path outside"),
        (entry("models\\..\\..\\x.json"), b"x", "a path outside"),
        (entry("demonstrations/0001/0001.mcap", stat.S_IFLNK | 0o777), b"/etc/passwd", "not a regular file"),
        (entry("run.py"), b"import os", "not part of a project"),
        (entry("demonstrations/0001/../../x.mcap"), b"x", "a path outside"),
        (entry("models/0001.tpgmm"), bytes(50_000_000), "not plausible"),
        (entry("TASK.yaml"), b"x", "not part of a project"),
        (entry("models/0001.json"), b'{"learned_from": "nothing"}', "notes in it cannot be read"),
        (entry("demonstrations/0001/notes.json"), b"[" * 100_000, "notes in it cannot be read"),
    ],
)
def test_an_archive_that_is_no_project_is_refused_and_nothing_is_left(
    bad: zipfile.ZipInfo, content: bytes, words: str, tmp_path: Path
) -> None:
    archive = tmp_path / "bad.zip"
    with zipfile.ZipFile(archive, "w") as packed:
        packed.writestr(entry("task.yaml"), TASK.read_bytes())
        packed.writestr(entry("robot.yaml"), ROBOT.read_bytes())
        if bad.filename == "models/0001.json":
            packed.writestr(entry("models/0001.tpgmm"), b"no model")
        packed.writestr(bad, content)
    with pytest.raises(ProjectError, match=words):
        import_archive(archive, tmp_path / "new")
    assert [path.name for path in tmp_path.iterdir()] == ["bad.zip"]


def test_files_that_are_no_archive_and_models_that_are_none_are_refused_in_words(tmp_path: Path) -> None:
    archive = tmp_path / "bad.zip"
    archive.write_bytes(b"PK\x03\x04 nothing more")
    with pytest.raises(ProjectError, match="cannot be unpacked"):
        import_archive(archive, tmp_path / "new")
    with zipfile.ZipFile(archive, "w") as packed:
        packed.writestr("task.yaml", TASK.read_bytes())
    with pytest.raises(ProjectError, match=r"lacks robot\.yaml"):
        import_archive(archive, tmp_path / "new")
