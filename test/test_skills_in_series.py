# SPDX-License-Identifier: Apache-2.0
"""reproduction with several skills: one after another, each learned from its part of the recordings, or together."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from action_msgs.msg import GoalStatus

from reproduction_player import PLACES, POSE, TICK_NS, Player, means
from ros_graph import ROOT, TASK_FILE
from tpgmm_core import Demonstration, Frame
from tpgmm_core.retrieval.recipe import Recipe
from tpgmm_ros.recordings.bags import find_bags, read_recordings
from tpgmm_ros.recordings.recording import Recording
from tpgmm_ros.task.task_file import Task

#: Each skill: its part of the recordings, in shares of their time, and whether it is shown backwards. The hand rests at
#: the object and at the target; nobody was shown to retreat, so that this is the way down to the target, backwards.
PARTS = {"reach": (0.0, 0.39, False), "place": (0.39, 0.95, False), "retreat": (0.76, 0.95, True)}
SECONDS = 1.0
HEIGHT = 0.3  # m above the base


def part_of(recording: Recording, first: float, last: float, backwards: bool) -> Demonstration:
    """A part of a recording as a demonstration of SECONDS."""
    whole = recording.to_demonstration()
    shares = whole.times / whole.times[-1]
    part = whole.at(np.flatnonzero((shares >= first) & (shares <= last)))
    times = (part.times - part.times[0]) / (part.times[-1] - part.times[0]) * SECONDS
    data = np.column_stack([times, part.data[::-1, 1:] if backwards else part.data[:, 1:]])
    return Demonstration(times, data, part.frames, part.visible)


@pytest.fixture(scope="module")
def skills(tmp_path_factory: pytest.TempPathFactory) -> dict[str, str]:
    """Model files by the name of the skill."""
    task, directory = Task.load(TASK_FILE), tmp_path_factory.mktemp("skills")
    recordings, bad = read_recordings(find_bags([ROOT / "bags" / "pick_place"])[:8], task, every=10)
    assert not bad
    files = {}
    for name, (first, last, backwards) in PARTS.items():
        shown = [part_of(recording, first, last, backwards) for recording in recordings]
        space = task.space
        model = Recipe.of({"n_components": 4, "reg_covar": 1e-5}).learn(shown, space.manifold(), space.dimensions())
        model.metadata_ = {**model.metadata_, "duration_s": SECONDS}
        files[name] = str(directory / f"{name}.tpgmm")
        model.save(files[name])
    return files


def test_reach_place_and_retreat_follow_each_other_without_a_jump(player: Player, skills: dict[str, str]) -> None:
    handle = player.start(duration=0.0, models=list(skills.values()), durations=[0.0, 1.5, 0.0], holds=[0.2, 0.0])
    status, result = player.result(handle)
    assert status == GoalStatus.STATUS_SUCCEEDED and result.success, result.reason
    assert result.reason.startswith("skill 3 of 3 (retreat): ")
    said = [(item.skill, item.skills, item.skill_name) for item in player.feedback]
    assert list(dict.fromkeys(said)) == [(1, 3, "reach"), (2, 3, "place"), (3, 3, "retreat")]
    path = means(player.references)[:, :3]
    near = {name: np.linalg.norm(path - PLACES[name][:3], axis=1) for name in ("object", "target")}
    assert near["object"].min() < 0.04 and near["target"].min() < 0.05
    assert np.argmin(near["object"]) < np.argmin(near["target"])
    assert path[-1, 2] > PLACES["target"][2] + 0.06, "up from the target"
    steps = np.linalg.norm(np.diff(path, axis=0), axis=1)
    phases = np.array([reference.phase for reference in player.references])
    changes = np.flatnonzero(np.diff(phases) < -0.5)  # from the end of a skill to the beginning of the next one
    assert len(changes) == 2 and steps[changes].max() < 2e-3 and steps[changes + 1].max() < 2e-3


@pytest.fixture(scope="module")
def at_once(tmp_path_factory: pytest.TempPathFactory) -> dict[str, str]:
    """Two movements that leave each other free: over the object, at any height, and to a height, wherever it is."""
    task, directory, files = Task.load(TASK_FILE), tmp_path_factory.mktemp("at_once"), {}
    space, random = task.space, np.random.default_rng(0)
    for name, frame, held, seconds in (("over", "object", [0, 1], 1.0), ("height", "robot", [2], 0.5)):
        times, shown = np.linspace(0.0, seconds, 30), []
        for _ in range(6):
            place = PLACES[frame].copy()
            place[held] += random.uniform(-0.1, 0.1, len(held))
            data = np.tile(PLACES["robot"], (30, 1))
            data[:, 3:] = POSE.exp(data[0], np.concatenate([np.zeros(3), random.normal(0.0, 0.05, 3)]))[3:]
            data[:, :3] = place[:3] + random.uniform(-0.3, 0.3, 3)
            goal = place[held] + ([HEIGHT] if name == "height" else [0.0, 0.0])
            data[:, held] = goal - 0.2 * (1.0 - times / seconds)[:, None]
            data[:, :3] += random.normal(0.0, 0.002, (30, 3))
            frames = {frame: Frame(np.eye(7), np.array([*place[:3], 0.0, 0.0, 0.0, 0.0])).with_time()}
            shown.append(Demonstration(times, np.column_stack([times, data]), frames))
        model = Recipe.of({"n_components": 3, "reg_covar": 1e-5}).learn(shown, space.manifold(), space.dimensions())
        model.metadata_ = {**model.metadata_, "duration_s": seconds}
        files[name] = str(directory / f"{name}.tpgmm")
        model.save(files[name])
    return files


def test_two_skills_at_the_same_time_each_do_their_part(player: Player, at_once: dict[str, str]) -> None:
    goal = [PLACES["object"][0], PLACES["object"][1], PLACES["robot"][2] + HEIGHT]
    ends = {}
    for models in ([at_once["over"]], [at_once["height"]], [" + ".join(at_once.values())]):
        handle = player.start(duration=0.0, models=models)
        status, result = player.result(handle)
        assert status == GoalStatus.STATUS_SUCCEEDED and result.success, result.reason
        ends[player.feedback[-1].skill_name] = means(player.references)[-1, :3]
        seconds = TICK_NS * 1e-9 * sum(reference.phase < 1.0 for reference in player.references)
        assert seconds == pytest.approx(0.5 if models == [at_once["height"]] else 1.0, abs=0.05)
    np.testing.assert_allclose(ends["over + height"], goal, atol=0.02)
    assert abs(ends["over"][2] - goal[2]) > 0.1 and np.linalg.norm((ends["height"] - goal)[:2]) > 0.1


def test_a_skill_that_cannot_be_read_is_named_before_anything_moves(player: Player, skills: dict[str, str]) -> None:
    models = [skills["reach"], str(Path(skills["reach"]).with_name("none.tpgmm"))]
    status, result = player.result(player.send(duration=0.0, models=models), ticks=False)
    assert status == GoalStatus.STATUS_ABORTED and result.reason.startswith("skill 2 of 2: ")
    assert "none.tpgmm" in result.reason and not player.references


@pytest.mark.parametrize(
    ("fields", "complaint"),
    [
        ({"models": ["a", "b"], "model": "c"}, "both 'model' and 'models'"),
        ({"models": ["a", "b"], "durations": [1.0]}, "1 durations for 2 models"),
        ({"models": ["a", "b"], "holds": [1.0, 1.0]}, "2 holds for 2 models: give 1"),
        ({"holds": [1.0]}, "'models', which is empty"),
    ],
)
def test_goals_whose_fields_do_not_go_together_are_refused_with_the_reason(
    player: Player, fields: dict[str, Any], complaint: str
) -> None:
    status, result = player.result(player.send(**{"duration": 0.0, **fields}), ticks=False)
    assert status == GoalStatus.STATUS_ABORTED and complaint in result.reason
