# SPDX-License-Identifier: Apache-2.0
"""Figure 5 over the topics, in short: the real controller, simulator and joint_reference, in lockstep; one push."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from ros_graph import ROOT
from tpgmm_core import TPGMM, Demonstration, Frame
from tpgmm_core.geometry.manifold import POSE
from tpgmm_core.kinematics.hand_tasks import HandTask
from tpgmm_core.robot.model import RobotModel
from tpgmm_demos.figure5.graph import open_session, start_controller, start_joint_reference
from tpgmm_demos.figure5.lessons import HANDS, LESSON_TIME, LESSONS, START, Poses
from tpgmm_demos.figure5.measures import measure
from tpgmm_demos.figure5.report import EnergyAfter, energy_after, judged_frames
from tpgmm_demos.figure5.sequences import AFTER, CUP, HELD, MOVE, SEQUENCES, SUGAR, Push, random_pushes, run_sequence
from tpgmm_ros.nodes.joint_reference import hand_task
from tpgmm_ros.runtime.processes import GraphError
from tpgmm_ros.task.task_file import Task

TASKS = {name: Task.load(ROOT / "config" / f"{name}.yaml") for name in (CUP, SUGAR)}
BAXTER = ROOT / "config" / "baxter.yaml"


def lesson(name: str, seed: int = 0) -> Poses:
    """Poses (T, 7) of both hands in a lesson, led by a teacher whom no arm resists."""
    at, hands, rows = LESSONS[name](np.random.default_rng(seed)), dict(START), []
    for time in np.arange(0.0, LESSON_TIME, 0.05):
        hands = {**hands, **at(time, hands)}
        # who looks where the other hand is sees where it is now
        hands = at(time, hands)
        rows.append(hands)
    return {hand: np.stack([row[hand] for row in rows]) for hand in HANDS}


@pytest.fixture(scope="module")
def models() -> dict[str, TPGMM]:
    learned = {}
    for name, task in TASKS.items():
        hands = lesson(name)
        frames = {}
        for frame, spec in task.frames.items():
            poses = np.array(spec.pose)[None] if spec.pose is not None else hands[frame.removesuffix("_hand")]
            poses = np.broadcast_to(poses, (len(hands["left"]), 7))
            frames[frame] = Frame.from_pose(poses[:, :3], poses[:, 3:])
        movement = hands[task.endpoint]
        demonstration = Demonstration(0.05 * np.arange(len(movement), dtype=np.float64), movement, frames)
        model = TPGMM(n_components=1, manifold=str(POSE), init="kmeans", reg_covar=1e-6)
        learned[name] = model.fit([demonstration])
    return learned


def test_relevant_frames_and_directions_come_out_of_single_demonstrations(models: dict[str, TPGMM]) -> None:
    cup, sugar = judged_frames(CUP, models[CUP]), judged_frames(SUGAR, models[SUGAR])
    assert cup["relevant"] == ["world", "torso"] and sugar["relevant"] == ["left_hand"]
    for found in (cup, sugar):
        assert found["relevant_frame_stands_out"] and found["precision_ratio"] > 100.0


def test_a_task_seen_from_somewhere_else_than_the_robot_is_refused(models: dict[str, TPGMM]) -> None:
    task = Task.from_text(
        "{name: t, base_frame: base, movement: endpoint/left/pose, endpoint: left, "
        "frames: {table: {topic: table/pose}}}"
    )
    with pytest.raises(ValueError, match="frame 'table' is on 'table/pose'; expected one of"):
        hand_task(task, models[CUP], ["left", "right"])


def test_random_pushes_are_the_same_for_the_same_seed_and_within_what_was_said() -> None:
    pushes, again = (random_pushes(20, np.random.default_rng(3)) for _ in range(2))
    assert all(np.array_equal(a.way, b.way) and a.hand == b.hand for a, b in zip(pushes, again, strict=True))
    ways = [np.linalg.norm(push.way) for push in pushes if push.kind == "hand"]
    assert len(ways) == 20 and 0.1 < min(ways) and max(ways) < 0.3


@pytest.mark.parametrize(
    ("kind", "rise", "left", "kinetic", "falls"),
    [
        *(("hand", 0.0, 0.11, 0.1, True), ("elbow", 0.0, 0.51, 0.1, True), ("hand", 0.0, 0.51, 0.1, False)),
        *(("hand", 0.05, 0.1, 0.1, False), ("elbow", 0.0, 0.95, 0.1, False), ("hand", 0.0, 0.09, 0.35, False)),
    ],
)
def test_energy_that_rises_stays_or_swings_does_not_pass(
    kind: str, rise: float, left: float, kinetic: float, falls: bool
) -> None:
    assert EnergyAfter(rise, left, kinetic).falls(kind) == falls


@pytest.mark.long
@pytest.mark.timeout(300)
def test_a_pushed_left_hand_keeps_the_cup_level_and_the_right_one_follows(
    ros_domain: int, tmp_path: Path, models: dict[str, TPGMM]
) -> None:
    robot = RobotModel.from_file(BAXTER)
    for name, model in models.items():
        model.save(tmp_path / f"{name}.tpgmm")
    both = SEQUENCES[-1]
    quick = type(both)(both.name, both.title, both.tasks, ("hand",))
    with open_session(robot, tmp_path / "log", lockstep=True) as session:
        start_controller(session, BAXTER)
        choose = start_joint_reference(session, BAXTER, list(TASKS), tmp_path)
        session.start_simulator(BAXTER)
        with pytest.raises(GraphError, match="no tasks .'tea'."):
            choose(("tea",))
        result = run_sequence(
            session, quick, [Push("hand", "left", np.array([0.05, 0.14, 0.04]))], {}, choose, lambda: None
        )
    (pushed,) = result.pushes
    segment = pushed.segment
    assert segment.time[-1] == pytest.approx(MOVE + HELD + AFTER, abs=0.03)
    measured = measure(robot, segment, pushed.link)
    assert 0.10 < measured.moved.max() < 0.16
    assert measured.tilt.max() < 5.0
    assert measured.offset.max() < 0.04 and measured.offset[-20:].mean() < 0.02
    assert 0.0 < segment.torque_share <= 1.0
    hands: dict[str, HandTask] = {name: hand_task(task, models[name], list(HANDS)) for name, task in TASKS.items()}
    fallen = energy_after(robot, hands, pushed, result.rest)
    assert fallen.falls("hand"), fallen
