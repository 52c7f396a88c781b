# SPDX-License-Identifier: Apache-2.0
"""From demonstrations to a model in a process of its own, with what it means in words; then preview and suggestion."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from tpgmm_workbench.project.errors import ProjectError
from tpgmm_workbench.project.preview import preview
from tpgmm_workbench.project.project import Project
from tpgmm_workbench.project.quality import quality_of
from tpgmm_workbench.project.self_collision import SelfCollision
from tpgmm_workbench.project.situations import Newness, how_new
from tpgmm_workbench.project.suggestion import FrameRegion, suggest
from tpgmm_workbench.project.training import Training, TrainingOptions
from tpgmm_workbench.project.training_process import train

ROOT = Path(__file__).resolve().parents[3]
BAGS = sorted((ROOT / "bags" / "pick_place").glob("demo_*"))
TASK, ROBOT = ROOT / "config" / "pick_place.yaml", ROOT / "config" / "baxter.yaml"
PLAIN = TrainingOptions(is_automatic=False)


@pytest.fixture(scope="module")
def taught(tmp_path_factory: pytest.TempPathFactory) -> Project:
    """Four demonstrations and a model of them; tests of this module leave it as it is."""
    project = Project.create(tmp_path_factory.mktemp("taught") / "project", TASK, ROBOT)
    for bag in BAGS[:4]:
        project.add_bag(bag)
    train(project, PLAIN, lambda share, words: None)
    return project


def test_a_training_goes_on_beside_the_page_and_its_model_is_there_when_the_project_is_opened_again(
    tmp_path: Path,
) -> None:
    project = Project.create(tmp_path / "project", TASK, ROBOT)
    with pytest.raises(ProjectError, match="show 2 more"):
        Training.start(project)
    for bag in BAGS[:3]:
        project.add_bag(bag)
    training = Training.start(project, TrainingOptions(budget_s=1.0))
    assert not training.progress().is_over
    with pytest.raises(ProjectError, match="goes on"):
        training.result()
    assert training.wait(200.0)
    assert training.progress().share == 1.0
    model = Project.open(project.folder).model
    assert model is not None and model.notes == training.result().notes
    assert model.notes.learned_from == {1: None, 2: None, 3: None}
    assert set(model.notes.errors) == {1, 2, 3}
    assert model.notes.words[0].startswith("reproduces what it has not seen to ")
    assert "at the object" in model.notes.words[0] and "ways that were tried" in model.notes.words[-1]

    another = Training.start(project, PLAIN)
    another.cancel()
    with pytest.raises(ProjectError, match="cancelled"):
        another.result()
    assert len(Project.open(project.folder).models()) == 1


def test_two_demonstrations_give_a_model_already(tmp_path: Path) -> None:
    project = Project.create(tmp_path / "project", TASK, ROBOT)
    for bag in BAGS[:2]:
        project.add_bag(bag)
    (project.folder / "models" / "0001.tpgmm").touch()  # of a process that died: no model, and its number is taken
    assert project.model is None
    model = train(project, TrainingOptions(), lambda share, words: None)
    assert any("third" in word or "one more" in word for word in model.notes.words)
    assert project.model == model and model.number == 2
    project.take_back(model.number)
    assert project.model is None and len(project.models()) == 1


def test_a_demonstration_that_shows_something_else_is_marked(taught: Project, tmp_path: Path) -> None:
    project = Project.create(tmp_path / "project", TASK, ROBOT)
    for bag in BAGS[:4]:
        project.add_bag(bag)
    length = project.demonstration(4).recording.duration
    project.note(4, trim=(0.0, 0.45 * length))  # it ends in the middle
    assert quality_of(project, 4).difference_m > 3.0 * quality_of(project, 3).difference_m  # type: ignore[operator]
    assert list(train(project, PLAIN, lambda share, words: None).notes.misfits) == [4]
    assert taught.model is not None and not taught.model.notes.misfits


def test_the_quality_of_a_demonstration_is_known_at_once(taught: Project) -> None:
    found = quality_of(taught, 4)
    assert found.level == "good" and not found.doubts and not found.missing
    assert found.duration_s == pytest.approx(taught.demonstration(4).recording.duration)
    assert {stream.topic.strip("/") for stream in found.streams} == {
        "endpoint/left/pose",
        "object/pose",
        "target/pose",
    }
    assert found.difference_m is not None and 0.0 < found.difference_m < 0.1
    assert found.novelty is not None and 0.0 < found.novelty < 5.0


def test_the_same_demonstration_again_is_doubted(taught: Project, tmp_path: Path) -> None:
    project = Project.create(tmp_path / "project", TASK, ROBOT)
    for bag in (BAGS[0], BAGS[1], BAGS[0]):
        project.add_bag(bag)
    found = quality_of(project, 3)
    assert (
        found.level == "look" and "exactly the same movement" in found.words[0] and "demonstration 1" in found.words[0]
    )


def test_what_is_suggested_is_newer_than_what_was_shown_and_within_the_region(taught: Project) -> None:
    found = suggest(taught)
    assert set(found.frames) == {"object", "target"}
    seen = [one.situation for one in taught.shown()]
    for name, pose in found.frames.items():
        places = np.array([situation[name][:3] for situation in seen])
        assert (pose[:3] >= places.min(axis=0) - 1e-9).all() and (pose[:3] <= places.max(axis=0) + 1e-9).all()
    region = FrameRegion((0.6, 0.3, 0.0), (0.7, 0.4, 0.0))
    narrow = suggest(taught, {"object": region})
    assert (narrow.frames["object"][:3] >= region.low).all() and (narrow.frames["object"][:3] <= region.high).all()
    newness = Newness.of(taught, taught.shown())
    for one in taught.shown():
        assert found.novelty > (newness.of_situation(one.situation, one.recording.movement[0]) or 0.0)


def test_a_preview_shows_the_whole_robot_and_its_verdict_before_anything_moves(taught: Project) -> None:
    robot, model = taught.robot(), taught.load(taught.models()[0])
    shapes = SelfCollision(robot, taught.robot_file)
    assert not shapes.problem
    situation = taught.demonstration(1).situation
    found = preview(model, situation, robot.home, robot, "left", duration=60.0, shapes=shapes)
    assert found.path.shape == (100, 7) and found.covariances.shape == (100, 6, 6) and found.q.shape == (100, robot.nv)
    assert (np.linalg.eigvalsh(found.covariances) > 0.0).all()
    assert found.may_run and found.words == "it can be done as shown"
    data, right = robot.create_data(), robot.indices("right_arm")
    for q, pose in zip(found.q, found.path, strict=True):
        data.update(q)
        assert np.linalg.norm(data.pose("left")[:3] - pose[:3]) < 0.002
    assert ((found.q >= robot.lower_limits) & (found.q <= robot.upper_limits)).all()
    assert (found.q[:, right] == robot.home[right]).all()


def test_a_preview_refuses_in_words_what_the_robot_cannot_do(taught: Project) -> None:
    robot, model = taught.robot(), taught.load(taught.models()[0])
    situation = taught.demonstration(1).situation
    fast = preview(model, situation, robot.home, robot, "left", duration=0.5)
    verdict = {check.name: check for check in fast.checks}
    assert verdict["speed limits"].is_good is False and f"give it {fast.advised} s" in verdict["speed limits"].words
    slower = preview(model, situation, robot.home, robot, "left", duration=fast.advised)
    assert {c.name: c.is_good for c in slower.checks}["speed limits"], "what is advised must be enough"
    assert slower.advised is None
    assert verdict["self-collision"].is_good is None
    away = {**situation, "target": situation["target"] + np.array([1.5, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0])}
    far = preview(model, away, robot.home, robot, "left")
    verdict = {check.name: check for check in far.checks}
    assert verdict["reachable"].is_good is False and verdict["novelty"].is_good is False and not far.may_run
    with pytest.raises(ProjectError, match="needs target"):
        preview(model, {"object": situation["object"], "robot": situation["robot"]}, robot.home, robot, "left")


def test_an_arm_within_the_other_one_is_seen(taught: Project) -> None:
    robot = taught.robot()
    shapes = SelfCollision(robot, taught.robot_file)
    assert shapes.first(robot.home[None]) is None
    crossed = robot.home.copy()
    for side, sign in (("left", -1.0), ("right", 1.0)):
        joints = robot.indices([f"{side}_s0", f"{side}_s1", f"{side}_e0", f"{side}_e1"])
        crossed[joints] = [sign * 1.5, 0.0, 0.0, 0.05]  # both stretched to the front and to the other side
    meeting = shapes.first(np.array([robot.home, crossed]))
    assert meeting is not None and meeting.at == 1
    assert {link.split("_")[0] for link in meeting.links} == {"left", "right"}


@pytest.mark.parametrize(
    ("score", "judged_by", "words"),
    [
        (0.0, 20, "like the demonstrations"),
        (0.0, 3, "like the demonstrations, as far as 3 of them can tell"),
        (0.9, 20, "at the edge of what was demonstrated: expect it to be less exact"),
        (1.2, 20, "new: a little farther from the demonstrations than any of them from the others"),
        (3.4, 20, "new: 3 times as far from the demonstrations as any of them from the others"),
        (float("inf"), 20, "new: much farther from the demonstrations than any of them from the others"),
    ],
)
def test_how_new_a_situation_is_is_said_in_words(score: float, judged_by: int, words: str) -> None:
    assert how_new(score, judged_by) == words
