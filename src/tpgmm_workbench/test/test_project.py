# SPDX-License-Identifier: Apache-2.0
"""A project's folder: what is finished stays, what is not never counts, and nothing is deleted."""

from __future__ import annotations

import os
import random
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from tpgmm_ros.recordings.bags import find_bags
from tpgmm_workbench.project.errors import ProjectError
from tpgmm_workbench.project.project import Project

ROOT = Path(__file__).resolve().parents[3]
BAGS = sorted((ROOT / "bags" / "pick_place").glob("demo_*"))
TASK, ROBOT = ROOT / "config" / "pick_place.yaml", ROOT / "config" / "baxter.yaml"


@pytest.fixture
def project(tmp_path: Path) -> Project:
    return Project.create(tmp_path / "project", TASK, ROBOT)


def test_a_demonstration_is_there_again_with_its_notes_when_the_project_is_opened_again(project: Project) -> None:
    project.add_bag(BAGS[0], comment="slowly")
    project.note(1, trim=(0.5, 4.0))
    again = Project.open(project.folder).demonstration(1)
    assert again.notes.comment == "slowly" and again.is_used
    assert again.recording.duration == pytest.approx(3.5, abs=0.05)
    assert again.whole is not None and again.whole.duration > 4.0
    assert set(again.situation) == {"object", "target", "robot"}
    assert find_bags([project.folder / "demonstrations"]) == [again.path]  # an ordinary bag, for all programs


def test_undo_marks_and_redo_brings_back(project: Project) -> None:
    project.add_bag(BAGS[0])
    project.add_bag(BAGS[1])
    assert "demonstration 2" in project.undo() and "demonstration 1" in project.undo() and project.undo() == ""
    assert project.used() == () and len(project.demonstrations()) == 2
    assert "demonstration 1" in project.redo()
    assert [shown.number for shown in project.used()] == [1]
    assert project.add_bag(BAGS[2]).number == 3, "a number is never given again"


def test_a_bag_that_cannot_be_read_is_there_with_its_problem_and_not_used(project: Project) -> None:
    path = project.new_demonstration()
    path.mkdir()
    (path / "metadata.yaml").write_text("nothing: here\n")
    assert project.recorded(path).problem
    assert project.used() == ()


def test_what_is_trimmed_to_nothing_is_refused_and_the_notes_stay(project: Project) -> None:
    project.add_bag(BAGS[0])
    with pytest.raises(ProjectError, match="trim less"):
        project.note(1, trim=(1.0, 1.01))
    assert project.demonstration(1).notes.trim is None


def test_a_folder_that_holds_something_else_is_neither_made_nor_opened(tmp_path: Path) -> None:
    (tmp_path / "mine.txt").write_text("mine")
    with pytest.raises(ProjectError, match="not empty"):
        Project.create(tmp_path, TASK, ROBOT)
    with pytest.raises(ProjectError, match="is no project"):
        Project.open(tmp_path)
    assert [path.name for path in tmp_path.iterdir()] == ["mine.txt"]


WRITER = """
import sys
from tpgmm_workbench.project.project import Project
project, bags = Project.open(sys.argv[1]), sys.argv[2:]
print("begin", flush=True)
while True:
    for bag in bags:
        shown = project.add_bag(bag, comment="whole")
        project.note(shown.number, comment="whole " * 50)
        print(shown.number, flush=True)
"""


def test_a_process_killed_at_any_moment_leaves_every_finished_demonstration(project: Project) -> None:
    rng = random.Random(0)
    told = 0
    for _ in range(20):
        process = subprocess.Popen(
            [sys.executable, "-c", WRITER, str(project.folder), *map(str, BAGS[:2])],
            stdout=subprocess.PIPE,
            text=True,
            env=os.environ | {"PYTHONPATH": os.pathsep.join(sys.path)},
        )
        assert process.stdout is not None
        assert process.stdout.readline() == "begin\n"
        time.sleep(rng.uniform(0.0, 0.1))  # the moment
        process.send_signal(signal.SIGKILL)
        lines = process.stdout.read().split()
        process.wait()
        told = max([told, *map(int, lines)])
    again = Project.open(project.folder)
    shown = again.demonstrations()
    assert told > 0
    assert {one.number for one in shown} >= {one.number for one in shown if one.number <= told}
    assert all(not one.problem and one.notes.comment.startswith("whole") for one in shown)
