# SPDX-License-Identifier: Apache-2.0
"""Corrections of a simulated arm: grabbed by force, led far away and let go of, and what is known of a push."""

from __future__ import annotations

import shutil
from pathlib import Path

import numpy as np
import pytest
from geometry_msgs.msg import WrenchStamped
from rcl_interfaces.msg import ParameterEvent
from rclpy.node import Node
from sensor_msgs.msg import JointState

from ros_graph import ALL, ROBOT_FILE, ROOT, TASK_FILE, Inbox
from ros_testing import spin_until
from tpgmm_core.common.types import Array
from tpgmm_core.robot.model import RobotModel
from tpgmm_ros.messages import conversions
from tpgmm_ros.messages.qos import STREAM
from tpgmm_ros.task.task_file import Task
from tpgmm_workbench.desk.view import DeskView
from tpgmm_workbench.graph.watching import Watcher
from tpgmm_workbench.project.activities import Action, Activity
from tpgmm_workbench.project.project import Project
from tpgmm_workbench.project.training_process import TrainingOptions, train
from workbench_bench import Bench, served

pytestmark = pytest.mark.alone
BAGS = sorted((ROOT / "bags" / "pick_place").glob("demo_*"))[:4]
THRESHOLD, PUSH = 15.0, 30.0
HAND = "left_gripper"
DURATION = 16.0


@pytest.fixture(scope="module")
def taught(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder of a project with four demonstrations and a model."""
    project = Project.create(tmp_path_factory.mktemp("taught") / "project", TASK_FILE, ROBOT_FILE)
    for bag in BAGS:
        project.add_bag(bag)
    train(project, TrainingOptions(is_automatic=False), lambda share, words: None)
    return project.folder


def opened(taught: Path, folder: Path) -> Project:
    """A copy of that project, of which a test may do what it likes."""
    return Project.open(shutil.copytree(taught, folder / "project"))


class Hand:
    """Somebody beside the robot who pushes its hand."""

    def __init__(self, node: Node) -> None:
        self._node, self._wrenches = node, node.create_publisher(WrenchStamped, "external_wrench", STREAM)

    def push(self, *force: float) -> None:
        message = WrenchStamped()
        message.header.frame_id = HAND
        message.header.stamp = self._node.get_clock().now().to_msg()
        force_message = message.wrench.force
        force_message.x, force_message.y, force_message.z = force
        self._wrenches.publish(message)


def begin(bench: Bench) -> DeskView:
    """Run the skill, with the objects where they were in a demonstration, until the arm is on its way."""
    desk = bench.desk
    bench.until(lambda view: not view.reasons[Action.RUN], "a model, the robot and all frames")
    situation = desk.project.demonstration(1).situation
    desk.table.lay({name: situation[name] for name in desk.table.places})
    bench.lead("home")
    view = bench.look_ahead(DURATION)
    if view.preview is not None and view.preview.advised is not None:
        view = bench.look_ahead(float(view.preview.advised))
    assert view.preview is not None and view.preview.may_run, view.preview
    desk.run()
    return bench.until(lambda view: view.run.stage == "running" and view.run.phase > 0.1, "the movement")


@pytest.mark.long
def test_a_push_that_lasts_begins_a_correction_by_itself_and_asks_nothing_of_the_robot(
    ros_node: Node, taught: Path, tmp_path: Path
) -> None:
    forces: list[float] = []
    with served(ros_node, opened(taught, tmp_path), tmp_path / "nodes", THRESHOLD) as bench:
        desk, hand = bench.desk, Hand(ros_node)
        events = Inbox(ros_node, ParameterEvent, "/parameter_events", ALL)

        def is_free(view: DeskView) -> bool:
            assert view.activity is Activity.RUNNING, (view.words, view.run)
            assert view.graph.force is not None and view.graph.force.newtons is not None, view.graph.force
            forces.append(view.graph.force.newtons)
            return view.run.phase > 0.3

        begin(bench)
        asked = len(events.messages)
        view = bench.until(is_free, "a third of the movement")
        assert max(forces) < 0.5 * THRESHOLD, "nobody pushes"
        view = bench.until(lambda view: view.novelty and view.graph.horizon and view.graph.reference, "what comes next")
        assert view.novelty is not None and view.novelty.score is not None and view.novelty.score < view.novelty.limit
        horizon, reference = view.graph.horizon, view.graph.reference
        assert horizon is not None and reference is not None and horizon.path.shape == (13, 3)
        assert float(np.linalg.norm(horizon.path[0] - reference.pose[:3])) < 0.1, "the path begins at the reference"

        def is_grabbed(view: DeskView) -> bool:
            hand.push(0.0, 0.0, PUSH)
            return view.activity is Activity.COACHING

        view = bench.until(is_grabbed, "a correction that begins by itself")
        assert "the hand is held (more than 15 N)" in view.coached and any("is held (" in words for words in view.words)
        since = view.run.phase

        def is_led(view: DeskView) -> bool:
            hand.push(0.0, 0.0, PUSH)
            assert view.activity is Activity.COACHING
            return view.run.phase > since + 0.15

        bench.until(is_led, "the hand to be held for a while")
        view = bench.until(lambda view: view.activity is not Activity.COACHING, "the hand to be let go of")
        assert view.activity is Activity.RUNNING and "learned when the movement is over" in view.coached
        assert len(events.messages) == asked, "nothing is set anywhere because of a push"
        bench.until(lambda view: not view.run.goes_on, "the end of the movement")
        view = bench.until(lambda view: view.model is not None and view.model.number == 2, "the corrected model", 60.0)
        correction = desk.project.demonstrations()[-1].notes.correction
        assert correction is not None and abs(correction.begin - since) < 0.1 < correction.end - correction.begin
        print(f"\nfree: at most {max(forces):.1f} N of {THRESHOLD:.0f} N")


@pytest.mark.long
def test_an_arm_that_was_led_far_away_for_long_comes_back_and_ends_where_the_model_ends(
    ros_node: Node, taught: Path, tmp_path: Path
) -> None:
    shares: list[float] = []
    phases: list[float] = []
    with served(ros_node, opened(taught, tmp_path), tmp_path / "nodes") as bench:
        desk = bench.desk

        def watched(view: DeskView) -> DeskView:
            shares.extend(one.share for one in view.graph.torques)
            return view

        view = begin(bench)
        assert view.graph.hand is not None
        far = view.graph.hand + np.array([0.0, 0.1, 0.25, 0.0, 0.0, 0.0, 0.0])
        desk.coach()
        desk.table.lead_hand(far, is_held=True)
        bench.until(lambda view: watched(view).run.phase > 0.7, "the arm to be held while time goes on")
        desk.end_coaching()

        def is_back(view: DeskView) -> bool:
            if "waits until the hand is back" in watched(view).waits:
                phases.append(view.run.phase)
            return bool(phases) and not view.waits

        view = bench.until(is_back, "the arm to come back while time stands still")
        assert np.ptp(phases[1:]) < 0.03 and view.run.goes_on, phases
        view = bench.until(lambda view: not watched(view).run.goes_on, "the end of the movement")
        assert view.run.stage == "done" or "from the model's end" in view.run.words, view.run
        reference, hand = view.graph.reference, view.graph.hand
        assert reference is not None and hand is not None
        assert float(np.linalg.norm(hand[:3] - reference.pose[:3])) < 0.02, view.run
        assert view.graph.controller is not None and view.graph.controller.state == "ACTIVE", view.graph.controller
        assert 0.1 < max(shares) <= 1.0
        bench.until(lambda view: view.model is not None and view.model.number == 2, "the corrected model", 60.0)


@pytest.mark.long
def test_an_arm_that_is_held_to_the_end_ends_with_the_true_reason_and_comes_back_slowly(
    ros_node: Node, taught: Path, tmp_path: Path
) -> None:
    with served(ros_node, opened(taught, tmp_path), tmp_path / "nodes") as bench:
        desk = bench.desk
        view = begin(bench)
        assert view.graph.hand is not None
        far = view.graph.hand + np.array([0.0, 0.1, 0.25, 0.0, 0.0, 0.0, 0.0])
        desk.coach()
        desk.table.lead_hand(far, is_held=True)
        view = bench.until(lambda view: not view.run.goes_on, "the end of the movement")
        assert view.run.stage == "failed" and "the robot has stopped there: blocked" in view.run.words, view.run
        assert "'HOLD: not following" in view.run.words, view.run
        assert view.activity is Activity.IDLE and view.aim is not None
        desk.table.let_go()
        hands: list[tuple[float, Array]] = []

        def is_back(view: DeskView) -> bool:
            reference, hand = view.graph.reference, view.graph.hand
            assert reference is not None and hand is not None
            assert all(one.share <= 1.0 for one in view.graph.torques), view.graph.torques
            hands.append((1e-9 * ros_node.get_clock().now().nanoseconds, hand[:3]))
            return float(np.linalg.norm(hand[:3] - reference.pose[:3])) < 0.02

        bench.until(is_back, "the arm at the end of the movement")
        begun = next(i for i, (when, _) in enumerate(hands) if when > hands[0][0] + 1.0)  # what was bent springs back
        speeds = [
            float(np.linalg.norm(now - then)) / (at - before)
            for (before, then), (at, now) in zip(hands[begun:-10], hands[begun + 10 :], strict=True)
            if at > before
        ]
        assert speeds and max(speeds) < 0.25, "an arm that could not follow comes back at a quarter of its speed"


class Robot:
    """A robot that says something of its joints."""

    def __init__(self, node: Node, robot: RobotModel) -> None:
        self._node, self.robot = node, robot
        self._states = node.create_publisher(JointState, "joint_states", STREAM)
        self._wrenches = node.create_publisher(WrenchStamped, "external_wrench", STREAM)
        self._steps = 0

    def say(self, effort: Array | None) -> None:
        self._steps += 1
        robot, stamp_ns = self.robot, 1_000_000_000 + self._steps * 10_000_000
        still = np.zeros(robot.nv)
        names = list(robot.joint_names)
        self._states.publish(conversions.joint_state_message(names, stamp_ns, robot.home, still, effort))

    def feel(self, link: str, force: float) -> None:
        message = WrenchStamped()
        message.header.frame_id, message.wrench.force.x = link, force
        self._wrenches.publish(message)


def test_a_robot_that_does_not_measure_says_so_and_a_wrench_is_believed_at_this_arm_alone(ros_node: Node) -> None:
    model = RobotModel.from_file(ROBOT_FILE)
    watcher, robot = Watcher(ros_node, Task.load(TASK_FILE), model, feels=True), Robot(ros_node, model)
    gravity = model.create_data().gravity(model.home).copy()
    push = np.zeros(model.nv)
    data = model.create_data()
    data.update(model.home)
    push[:] = data.jacobian("left").T @ [0.0, 0.0, 20.0, 0.0, 0.0, 0.0]

    def until_why(word: str, effort: Array | None, link: str = "") -> None:
        def is_said() -> bool:
            robot.say(effort)
            if link:
                robot.feel(link, 20.0)
            force = watcher.look().force
            return force is not None and force.newtons is None and word in force.why

        spin_until(ros_node, is_said, message=f"'{word}'")

    def until_force(least: float, most: float, effort: Array | None, source: str, link: str = "") -> None:
        def is_felt() -> bool:
            robot.say(effort)
            if link:
                robot.feel(link, 20.0)
            force = watcher.look().force
            assert force is not None
            return force.newtons is not None and least <= force.newtons <= most and force.source == source

        spin_until(ros_node, is_felt, message=f"{least} to {most} N by {source}")

    try:
        until_why("effort is empty", None)
        until_why("are 0", np.zeros(model.nv))
        unknown = gravity.copy()
        unknown[model.indices("left_arm")[0]] = np.nan
        until_why("not finite", unknown)
        until_force(0.0, 0.5, gravity, "joint torques")
        until_force(15.0, 21.0, gravity - push, "joint torques")
        until_force(0.0, 0.5, gravity, "joint torques")
        until_force(20.0, 20.0, gravity, "external_wrench", HAND)
        until_force(0.0, 0.5, gravity, "joint torques", "right_gripper")
        until_why("this arm does not move", None, "right_gripper")
        until_why("the robot file does not know", None, "no_link")
        until_force(20.0, 20.0, None, "external_wrench", "left_wrist")
    finally:
        watcher.close()
