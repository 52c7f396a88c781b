# SPDX-License-Identifier: Apache-2.0
"""Corrections: a target that has changed by 5 cm is met to 1 cm, and what was not corrected stays within 2 mm."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from long_tests import mostly_long
from tpgmm_core import LearnedMixture
from tpgmm_core.choice.reproducing import reproduce
from tpgmm_core.common.types import Array
from tpgmm_core.geometry.manifold import Manifold
from tpgmm_core.geometry.pose import compose, inverse
from tpgmm_core.learning.incremental.online import OnlineTPGMM
from tpgmm_ros.recordings.bags import align, read_recording
from tpgmm_ros.recordings.recording import Recording
from tpgmm_workbench.project.coach import Run, correct
from tpgmm_workbench.project.errors import ProjectError
from tpgmm_workbench.project.held_out import thin
from tpgmm_workbench.project.project import Project
from tpgmm_workbench.project.training_process import TrainingOptions, train

ROOT = Path(__file__).resolve().parents[3]
BAGS = sorted((ROOT / "bags" / "pick_place").glob("demo_*"))
TASK, ROBOT = ROOT / "config" / "pick_place.yaml", ROOT / "config" / "baxter.yaml"
CHANGED = np.array([0.03, 0.04, 0.0])
"""By how much the target is elsewhere now, 5 cm, in its own axes."""
LED_FROM, LED_AFTER = 0.55, 0.75
REACHES = 0.1
"""Share of the movement by which one of twelve Gaussians reaches out of the corrected part."""


def made(folder: Path, method: str) -> Project:
    project = Project.create(folder / "project", TASK, ROBOT)
    for bag in BAGS[:5]:
        project.add_bag(bag)
    train(project, TrainingOptions(is_automatic=False, method=method), lambda share, words: None)
    return project


@pytest.fixture(scope="module")
def situations(tmp_path_factory: pytest.TempPathFactory) -> list[Recording]:
    """Six that no model has seen: three to be corrected in, three to judge by."""
    task = Project.create(tmp_path_factory.mktemp("task") / "project", TASK, ROBOT).task
    return [thin(read_recording(bag, task)) for bag in BAGS[5:11]]


def reference(model: LearnedMixture, situation: Recording) -> Array:
    return reproduce(model, situation.to_demonstration(float(model.metadata_["duration_s"])))


def wanted(first: LearnedMixture, situation: Recording) -> Array:
    """What the first model did, but as the changed target wants it."""
    blend = np.clip((situation.times / situation.duration - LED_FROM) / (LED_AFTER - LED_FROM), 0.0, 1.0)
    seen = compose(inverse(situation.frames["target"]), reference(first, situation))
    seen[:, :3] += (blend**2 * (3.0 - 2.0 * blend))[:, None] * CHANGED
    return np.asarray(compose(situation.frames["target"], seen))


def run_in(model: LearnedMixture, first: LearnedMixture, situation: Recording, rng: np.random.Generator) -> Run:
    """A hand that follows to 1 mm, and where it is led is 2 mm beside what is wanted, as hands are."""
    hand, goal = reference(model, situation), wanted(first, situation)
    led = situation.times / situation.duration > LED_FROM
    hand[led] = goal[led]
    hand[:, :3] += rng.normal(0.0, 0.001, (len(hand), 3)) + led[:, None] * rng.normal(0.0, 0.001, 3)
    frames = {name: situation.frames[name] for name in ("object", "target")}
    return Run(3.0 + situation.times, hand, frames, is_led=led)


def errors(model: LearnedMixture, first: LearnedMixture, situations: list[Recording]) -> tuple[float, float]:
    """Largest distance from what is wanted at the end, and from what the first model did before the change, m."""
    ends, before = [], []
    for situation in situations:
        path, is_before = reference(model, situation), situation.times / situation.duration < LED_FROM - REACHES
        ends.append(np.linalg.norm(path[-1, :3] - wanted(first, situation)[-1, :3]))
        before.append(np.linalg.norm(path[is_before, :3] - reference(first, situation)[is_before, :3], axis=1).max())
    return float(max(ends)), float(max(before))


@pytest.mark.parametrize("method", mostly_long(["time_steps", "adapt_regress"], "adapt_regress"))
def test_after_three_corrections_a_target_changed_by_5_cm_is_met_to_1_cm_and_the_rest_stays_within_2_mm(
    method: str, situations: list[Recording], tmp_path: Path
) -> None:
    project, rng = made(tmp_path, method), np.random.default_rng(0)
    first = project.load(project.models()[0])
    assert errors(first, first, situations[3:])[0] == pytest.approx(0.05, abs=1e-6)
    for situation in situations[:3]:
        assert project.model is not None
        begin = time.process_time()
        corrected = correct(project, run_in(project.load(project.model), first, situation, rng))
        assert time.process_time() - begin < 5.0  # on one core, also a slow one
        assert corrected == project.model and "as seen from target" in corrected.notes.words[0]
    end, before = errors(project.load(corrected), first, situations[3:])
    assert end < 0.01 and before < 0.002

    again = Project.open(project.folder)
    assert [one.number for one in again.used()] == [1, 2, 3, 4, 5, 6, 7, 8]
    for _ in range(3):
        assert "correction" in again.undo()
    assert again.model is not None and again.model.number == 1
    assert "correction 6" in again.redo() and again.model.number == 2


def test_learning_from_the_corrections_as_further_demonstrations_is_outvoted(
    situations: list[Recording], tmp_path: Path
) -> None:
    project, rng = made(tmp_path, "adapt_regress"), np.random.default_rng(0)
    first = project.load(project.models()[0])
    manifold = Manifold.parse("R1 x R3 x S3")
    online = OnlineTPGMM(n_components=12, reg_covar=1e-6, manifold=manifold, prior_strength=3.0, max_iter=200)
    duration = float(first.metadata_["duration_s"])
    online.fit(align([thin(one.recording) for one in project.shown()])[0])
    online.metadata_ = dict(first.metadata_)
    for situation in situations[:3]:
        run = run_in(first, first, situation, rng)
        online.partial_fit([replace(situation, movement=run.hand).to_demonstration(duration)])
    assert errors(online, first, situations[3:])[0] > 0.02


@pytest.fixture
def untouched(situations: list[Recording], tmp_path: Path) -> Callable[[], tuple[Project, Run]]:
    def build() -> tuple[Project, Run]:
        project = made(tmp_path, "time_steps")
        model = project.load(project.models()[0])
        hand = reference(model, situations[0])
        return project, Run(situations[0].times, hand, {n: situations[0].frames[n] for n in ("object", "target")})

    return build


def test_a_run_in_which_nobody_led_the_arm_is_no_correction(untouched: Callable[[], tuple[Project, Run]]) -> None:
    project, run = untouched()
    with pytest.raises(ProjectError, match="not led anywhere"):
        correct(project, run)
    with pytest.raises(ProjectError, match="let the movement come to its end"):
        correct(project, replace(run, phases=np.linspace(0.0, 0.6, len(run.times))))
    assert len(project.demonstrations()) == 5 and len(project.models()) == 1
    # where nobody says it, it is seen from where the hand left the reference
    led = run.hand.copy()
    led[60:80, 2] += 0.05
    found = correct(project, replace(run, hand=led)).notes
    correction = project.demonstrations()[-1].notes.correction
    assert correction is not None and found.corrects == 1
    assert correction.begin == pytest.approx(0.6, abs=0.03) and correction.end == pytest.approx(0.8, abs=0.03)


def test_a_movement_that_slowed_down_to_wait_is_corrected_as_one_that_did_not(
    untouched: Callable[[], tuple[Project, Run]],
) -> None:
    project, run = untouched()
    hand = run.hand.copy()
    hand[60:80, 2] += 0.05
    T, waits = len(hand), 40
    at = np.concatenate([np.arange(45), np.full(waits, 45), np.arange(45, T)])
    phases = np.linspace(0.013, 0.991, T)[at]
    for i in range(46, 46 + waits):  # by rounding errors alone
        phases[i] = np.nextafter(phases[i - 1], 1.0)
    times = run.times[0] + np.arange(len(at)) * 0.05
    hand = hand[at]
    hand[45 : 45 + waits, 0] += np.linspace(0.0, 0.001, waits)  # the hand comes nearer meanwhile
    found = correct(project, Run(times, hand, {n: x[at] for n, x in run.frames.items()}, phases))
    correction = project.demonstrations()[-1].notes.correction
    assert correction is not None and found.notes.corrects == 1
    assert correction.begin == pytest.approx(0.6, abs=0.03) and correction.end == pytest.approx(0.8, abs=0.03)
