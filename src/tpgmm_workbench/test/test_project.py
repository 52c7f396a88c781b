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


def test_a_task_over_joints_is_refused_in_words(tmp_path: Path) -> None:
    with pytest.raises(ProjectError, match="over joints"):
        Project.create(tmp_path / "project", ROOT / "config" / "left_first.yaml", ROBOT)
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize(
    ("old", "new", "complaint"),
    [
        (
            "{topic: target/pose}",
            "{topic: m, type: tpgmm_msgs/TaskParameters, name: t}",
            "has the maps target; the work",
        ),
        (
            "movement: endpoint/left/pose\nendpoint: left",
            "movements: {left: {topic: l}, right: {topic: r}}",
            "is meant",
        ),
    ],
)
def test_a_task_with_maps_or_several_movements_is_refused_in_words(
    old: str, new: str, complaint: str, tmp_path: Path
) -> None:
    text = TASK.read_text()
    assert old in text
    (tmp_path / "task.yaml").write_text(text.replace(old, new))
    with pytest.raises(ProjectError, match=complaint):
        Project.create(tmp_path / "project", tmp_path / "task.yaml", ROBOT)
    assert not (tmp_path / "project").exists()


def test_a_folder_that_holds_something_else_is_neither_made_nor_opened(tmp_path: Path) -> None:
    (tmp_path / "mine.txt").write_text("mine")
    with pytest.raises(ProjectError, match="not empty"):
        Project.create(tmp_path, TASK, ROBOT)
    with pytest.raises(ProjectError, match="is not a project"):
        Project.open(tmp_path)
    assert [path.name for path in tmp_path.iterdir()] == ["mine.txt"]


#: One process reads the modules once; for each line a child of it adds demonstrations until it is killed.
WRITER = """
import os, sys
import numpy as np
from tpgmm_workbench.project.bag_writer import write_bag
from tpgmm_workbench.project.project import Project

project, times = Project.open(sys.argv[1]), np.linspace(0.0, 2.0, 40)
hand = np.column_stack([times, times, times, *np.zeros((3, 40)), np.ones(40)])
frames = {name: np.array([1.0, 2.0, 0.0, 0.0, 0.0, 0.0, 1.0]) for name in project.task.sources}
write = lambda path: write_bag(path, project.task, times, hand, frames)
project.add(write, comment="whole")  # reads what it needs
for _ in sys.stdin:
    child = os.fork()
    if not child:
        while True:
            shown = project.add(write, comment="whole")
            os.write(1, f"{shown.number}\\n".encode())
            project.note(shown.number, comment="whole " * 50)
    os.write(1, f"child {child}\\n".encode())
    os.waitpid(child, 0)
    os.write(1, b"dead\\n")
"""


def test_a_process_killed_at_any_moment_leaves_every_finished_demonstration(project: Project) -> None:
    rng, told = random.Random(0), set()
    environment = os.environ | {"PYTHONPATH": os.pathsep.join(sys.path)}
    command = [sys.executable, "-c", WRITER, str(project.folder)]
    with subprocess.Popen(command, stdin=-1, stdout=-1, text=True, env=environment) as process:
        assert process.stdin is not None and process.stdout is not None

        def heard() -> str:
            """What was said next; finished demonstrations are noted."""
            line = process.stdout.readline().strip()  # type: ignore[union-attr]
            if line.isdigit():
                told.add(int(line))
            return line

        takes = 0.01
        for k in range(20):
            process.stdin.write("another\n")
            process.stdin.flush()
            while not (line := heard()).startswith("child "):
                pass
            begin = time.monotonic()
            if k % 2:  # while it makes its second one, else its first
                assert heard().isdigit()
                takes = time.monotonic() - begin
            time.sleep(rng.uniform(0.0, takes))  # the moment
            os.kill(int(line.removeprefix("child ")), signal.SIGKILL)
            while heard() != "dead":
                pass
        process.stdin.close()
    found = {one.number: one for one in Project.open(project.folder).demonstrations()}
    assert len(told) >= 10 and told <= set(found)
    assert all(not one.problem and one.notes.comment.startswith("whole") for one in found.values())
