# SPDX-License-Identifier: Apache-2.0
"""reproduction on its topics and its action: task parameters and joint states in, references out."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path

import numpy as np
import pytest
from action_msgs.msg import GoalStatus
from geometry_msgs.msg import PoseStamped
from rclpy.action import ActionClient
from rclpy.node import Node
from sensor_msgs.msg import JointState
from visualization_msgs.msg import Marker, MarkerArray

from ros_graph import (
    ACTIVATE,
    ALL,
    CONFIGURE,
    DEACTIVATE,
    ROOT,
    SECOND,
    TASK_FILE,
    change_state,
    result_of,
    ros_arguments,
    set_parameters,
)
from ros_testing import STARTUP_TIMEOUT, RunningProcess, StartProcess, spin_until
from tpgmm_core import TPGMM, Frame
from tpgmm_core.geometry import quaternion
from tpgmm_core.geometry.manifold import Manifold
from tpgmm_core.observation.tracking import FrameStatus, TrackedFrame
from tpgmm_core.retrieval.methods import METHODS
from tpgmm_core.retrieval.phase import PHASES
from tpgmm_msgs.action import Reproduce
from tpgmm_msgs.msg import ControllerState, Reference, TaskParameters
from tpgmm_msgs.srv import LoadModel
from tpgmm_ros.messages import conversions
from tpgmm_ros.messages.qos import LATCHED, STREAM
from tpgmm_ros.programs import train

NODE = "reproduction"
TICK_NS = 5_000_000
DURATION = 1.0
#: Of the robot's time, while a model is loaded.
TICKS_OF_LOADING = 30
POSE = Manifold.parse("R3 x S3")
PLACES = {
    "object": np.array([0.65, 0.40, 0.0, *quaternion.exp([0.0, 0.0, 0.3])]),
    "target": np.array([0.62, 0.10, 0.03, *quaternion.exp([0.0, 0.0, -0.4])]),
    "robot": np.array([0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0]),
}


def trained(path: Path, *options: str, task: Path = TASK_FILE) -> Path:
    """A small model of the recorded demonstrations."""
    few = ["--components", "5", "--every", "20", *options]
    assert train.main(["--task", str(task), "--output", str(path), *few, str(ROOT / "bags" / "pick_place")]) == 0
    return path


@pytest.fixture(scope="module")
def models(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A directory with a model for each retrieval method."""
    directory = tmp_path_factory.mktemp("models")
    for method in METHODS:
        trained(directory / f"{method}.tpgmm", "--retrieval", method)
    return directory


@pytest.fixture(scope="module")
def model_file(models: Path) -> Path:
    return models / "adapt_regress.tpgmm"


class Player:
    """The other side of the node: frames, and a robot that is at once where the reference was."""

    def __init__(self, node: Node, process: RunningProcess) -> None:
        self.node, self.process = node, process
        self.stamp_ns = 10 * SECOND
        self.references: list[Reference] = []
        self.feedback: list[Reproduce.Feedback] = []
        self.client = ActionClient(node, Reproduce, "reproduce")
        self._states = node.create_publisher(JointState, "joint_states", STREAM)
        self._poses = node.create_publisher(PoseStamped, "endpoint/left/pose", STREAM)
        self._frames = node.create_publisher(TaskParameters, "task_parameters", LATCHED)
        node.create_subscription(Reference, "reference", self.references.append, ALL)

    def wait_until_heard(self) -> None:
        publishers = (self._states, self._poses, self._frames)
        spin_until(
            self.node,
            lambda: self.client.server_is_ready() and all(p.get_subscription_count() for p in publishers),
            message="the node to listen",
            processes=(self.process,),
        )

    def show(self, places: Mapping[str, np.ndarray | None]) -> None:
        """Publish task parameters: a pose for each frame that is seen, None for one that is missing."""
        frames = [
            TrackedFrame(name, FrameStatus.MISSING, 0.0, 0, None)
            if pose is None
            else TrackedFrame(name, FrameStatus.VISIBLE, 1.0, self.stamp_ns, pose)
            for name, pose in places.items()
        ]
        self._frames.publish(conversions.task_parameters_message(frames, self.stamp_ns, "base"))

    def show_wrong(self) -> None:
        """Publish task parameters of a planar task."""
        message = conversions.task_parameters_message([], self.stamp_ns, "base")
        for name, pose in PLACES.items():
            tracked = TrackedFrame(name, FrameStatus.VISIBLE, 1.0, self.stamp_ns, pose)
            (item,) = conversions.task_parameters_message([tracked], self.stamp_ns, "base").frames
            item.rows, item.cols, item.a, item.b = 2, 2, [1.0, 0.0, 0.0, 1.0], [0.0, 0.0]
            message.frames.append(item)
        self._frames.publish(message)

    def put(self, pose: np.ndarray) -> None:
        """Publish where the hand is."""
        self._poses.publish(conversions.pose_stamped(pose, self.stamp_ns, "base"))

    def send(self, model: str = "", duration: float = DURATION) -> object:
        self.references.clear()
        self.feedback.clear()
        goal = Reproduce.Goal(model=model, duration=duration)
        sent = self.client.send_goal_async(
            goal, feedback_callback=lambda message: self.feedback.append(message.feedback)
        )
        handle = result_of(self.node, sent, "the goal to be accepted")
        assert handle.accepted
        return handle

    def tick(
        self,
        answered: bool = True,
        unless: Callable[[], bool] = lambda: False,
        names: tuple[str, ...] = (),
        pose: np.ndarray | None = None,
    ) -> Reference | None:
        """One joint state; returns the reference that answers it, if one has to, unless something else happens.

        The robot is at a pose, or else where the reference was.
        """
        self.stamp_ns += TICK_NS
        message = JointState(name=list(names))
        message.header.stamp = conversions.time_from_ns(self.stamp_ns)
        if self.references:
            self.put(np.array(self.references[-1].gaussian.mean) if pose is None else pose)
        due = 0.0

        def is_answered() -> bool:
            nonlocal due
            if time.monotonic() >= due:  # best effort may lose a message
                due = time.monotonic() + 0.2
                self._states.publish(message)
            stamp = self.references[-1].header.stamp if self.references else None
            return unless() or (stamp is not None and conversions.time_to_ns(stamp) == self.stamp_ns)

        if not answered:
            is_answered()
            self.node.executor.spin_once(timeout_sec=0.01)  # type: ignore[union-attr]
            return None
        spin_until(self.node, is_answered, message="a reference", processes=(self.process,))
        return self.references[-1] if self.references else None

    def start(self, model: str = "", duration: float = DURATION) -> object:
        """Send a goal and wait until it moves."""
        handle = self.send(model, duration)

        def moving() -> bool:
            self.show(PLACES)
            self.tick(answered=False)
            return bool(self.references)

        spin_until(self.node, moving, message="the first reference", processes=(self.process,))
        return handle

    def result(self, handle: object, ticks: bool = True) -> tuple[int, Reproduce.Result]:
        """The status and the result of a goal."""
        future = handle.get_result_async()  # type: ignore[attr-defined]
        deadline = time.monotonic() + STARTUP_TIMEOUT
        while ticks and not future.done():
            self.tick(answered=bool(self.references), unless=future.done)
            assert time.monotonic() < deadline, "no result"
        spin_until(self.node, future.done, message="the result", processes=(self.process,))
        return future.result().status, future.result().result


@pytest.fixture(scope="module")
def process(start_module_process: StartProcess, model_file: Path) -> RunningProcess:
    return start_module_process(
        NODE, *ros_arguments(task_file=TASK_FILE, model_file=model_file, start_timeout=STARTUP_TIMEOUT, settle_time=0.1)
    )


@pytest.fixture(scope="module")
def inactive(module_node: Node, process: RunningProcess) -> Player:
    assert change_state(module_node, NODE, CONFIGURE), process.output
    player = Player(module_node, process)
    player.wait_until_heard()
    return player


@pytest.fixture
def player(module_node: Node, inactive: Player) -> Iterator[Player]:
    assert change_state(module_node, NODE, ACTIVATE)
    yield inactive
    assert change_state(module_node, NODE, DEACTIVATE)


def means(references: list[Reference]) -> np.ndarray:
    return np.array([reference.gaussian.mean for reference in references])


def test_a_goal_to_a_node_that_is_not_active_is_aborted_with_the_reason(inactive: Player) -> None:
    status, result = inactive.result(inactive.send(), ticks=False)
    assert status == GoalStatus.STATUS_ABORTED
    assert not result.success and "not active" in result.reason
    assert not inactive.references


def test_a_movement_is_reproduced_with_one_reference_per_joint_state_and_ends_where_the_model_says(
    player: Player, model_file: Path
) -> None:
    handle = player.start()
    first = len(player.references) - 1
    while player.references[-1].phase < 1.0:
        player.tick()
    seconds = 1e-9 * np.array([conversions.time_to_ns(item.header.stamp) for item in player.references[first:]])
    phases = np.array([reference.phase for reference in player.references[first:]])
    assert phases[0] < 0.1
    np.testing.assert_allclose(np.diff(phases)[:-1], np.diff(seconds)[:-1] / DURATION, atol=1e-6)
    status, result = player.result(handle)
    assert status == GoalStatus.STATUS_SUCCEEDED and result.success
    assert result.final_position_error < 1e-3 and result.final_orientation_error < 1e-2
    assert player.feedback and set(player.feedback[-1].frames) == set(PLACES)
    assert 0.0 < player.feedback[-1].phase <= 1.0
    last = player.references[-1]
    assert last.header.frame_id == "base" and set(last.frames) == set(PLACES)
    assert last.gaussian.manifold == "R3 x S3" and sum(last.activations) == pytest.approx(1.0)

    model = TPGMM.load(model_file)
    frames = {name: Frame.from_pose(pose[:3], pose[3:]).with_time() for name, pose in PLACES.items()}
    expected = model.adapt(frames).condition([0], [model.metadata_["duration_s"]])
    np.testing.assert_allclose(POSE.log(expected.mean, np.array(last.gaussian.mean)), 0.0, atol=1e-4)


def test_a_model_may_have_frames_that_are_derived_from_where_the_hand_starts(player: Player, tmp_path: Path) -> None:
    """The node is given the observed frames alone: what the others are made of stands in the model."""
    more = "  begin: {hand: start, turned: false}\n  place: {frame: target, turned: false}\n"
    text = TASK_FILE.read_text()
    (tmp_path / "task.yaml").write_text(text.replace("  robot: {", more + "  robot: {"))
    path = trained(tmp_path / "derived.tpgmm", task=tmp_path / "task.yaml")
    start = np.array([0.6, 0.25, 0.3, *PLACES["object"][3:]])
    player.references.clear()  # a robot that follows them would be elsewhere
    for _ in range(20):
        player.show(PLACES)
        player.put(start)
        player.tick(answered=False)
    handle = player.start(str(path))
    assert set(player.tick().frames) == {*PLACES, "begin", "place"}  # type: ignore[union-attr]
    while player.references[-1].phase < 1.0:
        player.tick()
    player.result(handle)

    model = TPGMM.load(path)
    frames = {name: Frame.from_pose(pose[:3], pose[3:]).with_time() for name, pose in PLACES.items()}
    for name, place in (("begin", start), ("place", PLACES["target"])):
        frames[name] = Frame.from_pose(place[:3], quaternion.IDENTITY).with_time()
    expected = model.adapt(frames).condition([0], [model.metadata_["duration_s"]])
    mean = np.array(player.references[-1].gaussian.mean)
    np.testing.assert_allclose(POSE.log(expected.mean, mean), 0.0, atol=1e-4)


def test_a_situation_that_is_too_new_is_refused_where_a_limit_is_set(player: Player, tmp_path: Path) -> None:
    told = trained(tmp_path / "told.tpgmm", "--leave-one-out")
    far = {**PLACES, "object": PLACES["object"] + [1.2, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0]}
    assert set_parameters(player.node, NODE, max_novelty=2.0).successful
    try:
        for places, path, reason in ((far, told, "too new to the model: novelty"), (PLACES, "", "--leave-one-out")):
            for _ in range(20):
                player.show(places)
                player.tick(answered=False)
            status, result = player.result(player.send(str(path)))
            assert status == GoalStatus.STATUS_ABORTED and not result.success and reason in result.reason
            assert not player.references
        handle = player.start(str(told))
        while player.references[-1].phase < 1.0:
            player.tick()
        assert player.result(handle)[1].success
    finally:
        assert set_parameters(player.node, NODE, max_novelty=0.0).successful


def test_a_frame_that_is_never_seen_is_named_and_nothing_moves(player: Player) -> None:
    assert set_parameters(player.node, NODE, start_timeout=0.5).successful
    player.show({**PLACES, "target": None})
    status, result = player.result(player.send())
    assert status == GoalStatus.STATUS_ABORTED and not result.success
    assert "target" in result.reason and "object" not in result.reason
    assert not player.references
    assert set_parameters(player.node, NODE, start_timeout=STARTUP_TIMEOUT).successful


def test_a_model_file_that_is_none_aborts_the_goal_with_the_reason(player: Player, tmp_path: Path) -> None:
    foreign = tmp_path / "foreign.tpgmm"
    foreign.write_bytes(b"no model at all")
    for path in (foreign, tmp_path / "nowhere.tpgmm"):
        status, result = player.result(player.send(str(path)))
        assert status == GoalStatus.STATUS_ABORTED and not result.success
        assert path.name in result.reason


def test_a_canceled_movement_stops_where_it_is(player: Player) -> None:
    handle = player.start()
    for _ in range(40):
        player.tick()
    result_of(player.node, handle.cancel_goal_async(), "the cancel request")  # type: ignore[attr-defined]
    status, result = player.result(handle)
    assert status == GoalStatus.STATUS_CANCELED and "cancel" in result.reason
    stopped = len(player.references)
    for _ in range(20):
        player.tick()
    np.testing.assert_allclose(np.ptp(means(player.references[stopped:]), axis=0), 0.0, atol=1e-9)
    assert player.references[-1].phase < 1.0


def test_a_frame_that_disappears_and_comes_back_makes_no_jump_and_the_references_say_who_took_part(
    player: Player,
) -> None:
    player.start(duration=10.0)
    for visible in (PLACES, {**PLACES, "object": None}, PLACES):
        player.show(visible)
        for _ in range(60):
            player.tick()
    used = [set(reference.frames) for reference in player.references]
    assert {"target", "robot"} in used and used[0] == used[-1] == set(PLACES)
    # Neither the position nor its velocity jumps, in m per tick of 5 ms
    path = means(player.references[2:])[:, :3]
    assert np.abs(np.diff(path, axis=0)).max() < 2e-3
    assert np.abs(np.diff(path, n=2, axis=0)).max() < 3e-4


def test_task_parameters_of_another_size_are_refused_and_those_before_stay_in_use(player: Player) -> None:
    player.start()

    def refused() -> bool:
        player.show_wrong()
        player.tick()
        return "task parameters refused" in player.process.output

    spin_until(player.node, refused, message="the refusal in the log")
    assert set(player.tick().frames) == set(PLACES)  # type: ignore[union-attr]
    player.show(PLACES)


def test_a_goal_that_is_being_made_ready_when_the_node_is_deactivated_is_aborted_with_the_reason(
    player: Player,
) -> None:
    for _ in range(5):
        handle = player.send()
        assert change_state(player.node, NODE, DEACTIVATE, ACTIVATE)
        status, result = player.result(handle, ticks=False)
        assert status == GoalStatus.STATUS_ABORTED and "the node was deactivated" in result.reason
    assert not player.references


def test_a_deactivated_node_ends_its_movement_with_the_reason_and_sends_no_more_references(player: Player) -> None:
    handle = player.start()
    assert change_state(player.node, NODE, DEACTIVATE)
    status, result = player.result(handle)
    assert status == GoalStatus.STATUS_ABORTED and "deactivated" in result.reason
    sent = len(player.references)
    for _ in range(20):
        player.tick(answered=False)
    assert len(player.references) == sent
    assert change_state(player.node, NODE, ACTIVATE)


def test_viewers_are_shown_what_is_there_and_forget_it_when_the_node_is_deactivated(player: Player) -> None:
    shown: dict[tuple[str, int], Marker] = {}

    def take(message: MarkerArray) -> None:
        for marker in message.markers:
            if marker.action == Marker.ADD:
                shown[marker.ns, marker.id] = marker
            else:
                assert marker.action == Marker.DELETE
                shown.pop((marker.ns, marker.id), None)

    subscription = player.node.create_subscription(MarkerArray, "markers", take, ALL)
    player.start(duration=20.0)
    for visible in (PLACES, {**PLACES, "object": None}, {**PLACES, "target": None}):
        seen = {f"frames/{name}" for name, pose in visible.items() if pose is not None}

        def is_shown(visible: Mapping[str, np.ndarray | None] = visible, seen: set[str] = seen) -> bool:
            player.show(visible)
            player.tick()
            return {ns for ns, _ in shown if ns.startswith("frames/")} == seen

        spin_until(player.node, is_shown, message=f"markers of {seen} alone", processes=(player.process,))
    assert {number for ns, number in shown if ns == "components"} == set(range(5))
    assert change_state(player.node, NODE, DEACTIVATE)
    spin_until(player.node, lambda: not shown, message="no marker left", processes=(player.process,))
    player.node.destroy_subscription(subscription)
    player.show(PLACES)
    assert change_state(player.node, NODE, ACTIVATE)


@pytest.mark.parametrize("method", METHODS)
def test_every_retrieval_method_moves_to_the_same_end(
    player: Player, models: Path, model_file: Path, method: str
) -> None:
    handle = player.start(str(models / f"{method}.tpgmm"))
    status, result = player.result(handle)
    assert status == GoalStatus.STATUS_SUCCEEDED and result.success, result.reason
    assert distance_from_the_end(player.references[-1]) < 0.03
    assert player.references[-1].phase == 1.0 and len(player.references[-1].horizon) == 1


def distance_from_the_end(reference: Reference) -> float:
    """Of the hand from where all demonstrations end: above the target, by as much as it holds an object, m."""
    return float(np.linalg.norm(np.array(reference.gaussian.mean[:3]) - PLACES["target"][:3] - [0.0, 0.0, 0.02]))


def load(player: Player, path: Path | str) -> LoadModel.Response:
    """Ask for a model, or for that in use, while ticks go on: not so many that the movement ends on a slow machine."""
    client = player.node.create_client(LoadModel, "load_model")
    spin_until(player.node, client.service_is_ready, message="load_model")
    future = client.call_async(LoadModel.Request(path=str(path)))
    for _ in range(TICKS_OF_LOADING):
        if not future.done():
            player.tick(unless=future.done)
    response = result_of(player.node, future, "the model to be loaded")
    player.node.destroy_client(client)
    return response


@pytest.mark.parametrize("method", METHODS)
def test_a_model_that_is_loaded_during_a_movement_takes_over_without_a_jump_and_reaches_the_goal(
    player: Player, models: Path, model_file: Path, method: str
) -> None:
    handle = player.start(str(model_file), duration=2.0)
    while player.references[-1].phase < 0.4:
        player.tick()
    before = len(player.references)
    loaded = load(player, models / f"{method}.tpgmm")
    assert loaded.success, loaded.reason
    for _ in range(60):
        player.tick()
    phases = [reference.phase for reference in player.references[before:]]
    assert min(phases) > 0.3, "the movement goes on where it was"
    backwards = set_parameters(player.node, NODE, speed=-1.0)
    assert backwards.successful == (METHODS[method].time_parametrized is not None) and (
        backwards.successful or "speed" in backwards.reason
    )
    assert set_parameters(player.node, NODE, speed=1.0).successful
    # In m per tick of 5 ms: as fast as elsewhere, and no jump of the velocity
    path = means(player.references[1:])[:, :3]
    usual, around = path[: before - 1], path[before - 5 :]
    step, change = (np.abs(np.diff(usual, n=n, axis=0)).max() for n in (1, 2))
    assert np.abs(np.diff(around, axis=0)).max() < 2.0 * step
    assert np.abs(np.diff(around, n=2, axis=0)).max() < 3.0 * change
    status, result = player.result(handle)
    assert status == GoalStatus.STATUS_SUCCEEDED and result.success, result.reason
    assert distance_from_the_end(player.references[-1]) < 0.03
    assert load(player, model_file).success


def test_the_way_of_the_model_in_use_is_changed_during_a_movement(player: Player) -> None:
    handle = player.start()
    assert set_parameters(player.node, NODE, retrieval="regress_product", phase="arc_length").successful
    changed = load(player, "")
    assert changed.success, changed.reason
    assert set_parameters(player.node, NODE, retrieval="dynamical_system").successful
    refused = load(player, "")
    assert not refused.success and "'retrieval: dynamical_system'" in refused.reason
    assert set_parameters(player.node, NODE, retrieval="", phase="clock").successful
    status, result = player.result(handle)
    assert status == GoalStatus.STATUS_SUCCEEDED and result.success
    assert distance_from_the_end(player.references[-1]) < 0.03


def test_a_bad_model_is_refused_and_the_movement_goes_on_with_the_old_one(
    player: Player, models: Path, tmp_path: Path
) -> None:
    foreign = tmp_path / "foreign.tpgmm"
    foreign.write_bytes(b"no model at all")
    handle = player.start()
    for path in (foreign, tmp_path / "nowhere.tpgmm"):
        refused = load(player, path)
        assert not refused.success and path.name in refused.reason
    assert set_parameters(player.node, NODE, retrieval="dmp").successful
    refused = load(player, models / "trajectory.tpgmm")
    assert not refused.success and "dmp retrieves from" in refused.reason
    assert set_parameters(player.node, NODE, retrieval="").successful
    status, result = player.result(handle)
    assert status == GoalStatus.STATUS_SUCCEEDED and result.success


def test_a_way_that_the_model_does_not_suit_aborts_the_goal_with_the_reason(player: Player) -> None:
    for values, complaint in (
        ({"retrieval": "dynamical_system"}, "train one with 'retrieval: dynamical_system'"),
        ({"retrieval": "", "speed": -3.0}, None),
    ):
        result = set_parameters(player.node, NODE, **values)
        if complaint is None:
            assert not result.successful and "speed" in result.reason
            continue
        status, outcome = player.result(player.send())
        assert status == GoalStatus.STATUS_ABORTED and complaint in outcome.reason
    assert set_parameters(player.node, NODE, retrieval="").successful
    unknown = set_parameters(player.node, NODE, retrieval="fortune")
    assert not unknown.successful and "adapt_regress" in unknown.reason


@pytest.mark.parametrize("phase", PHASES)
def test_a_movement_pauses_goes_back_and_on_by_parameter(player: Player, phase: str) -> None:
    assert set_parameters(player.node, NODE, phase=phase).successful
    handle = player.start()
    while player.references[-1].phase < 0.4:
        player.tick()
    for speed, ticks in ((0.0, 120), (-1.0, 80), (1.0, 0)):
        assert set_parameters(player.node, NODE, speed=speed).successful
        for _ in range(ticks):
            player.tick()
    phases = np.array([reference.phase for reference in player.references])
    turned = phases.argmax() if phases[-1] < phases.max() else len(phases)
    assert phases.max() < 0.7 and np.ptp(phases[turned - 20 : turned]) < 1e-3, "paused"
    assert phases[-1] < phases.max() - 0.1, "gone back"
    status, result = player.result(handle)
    assert status == GoalStatus.STATUS_SUCCEEDED and result.success
    assert set_parameters(player.node, NODE, phase="clock").successful


def test_parameters_out_of_range_are_refused_with_the_reason(player: Player) -> None:
    result = set_parameters(player.node, NODE, blend_time=-1.0)
    assert not result.successful and "blend_time" in result.reason
    assert not set_parameters(player.node, NODE, model_file="other.tpgmm").successful


def state_at(stamp_ns: int, names: tuple[str, ...] = ()) -> JointState:
    return conversions.joint_state_message(list(names), stamp_ns, np.zeros(len(names)))


def test_joint_states_out_of_order_or_of_others_beside_are_neither_steps_nor_an_end(player: Player) -> None:
    arm = ("a", "b", "c")
    handle = player.start()
    others: set[int] = set()
    for tick in range(60):
        player.tick(names=arm)
        if tick % 5 == 0:
            overtaken, of_others = player.stamp_ns - 2 * TICK_NS + 1, player.stamp_ns + TICK_NS // 2
            others |= {overtaken, of_others}
            player._states.publish(state_at(overtaken, arm))
            player._states.publish(state_at(of_others, ("finger",)))
    stamps = [conversions.time_to_ns(reference.header.stamp) for reference in player.references]
    assert stamps == sorted(stamps) and not others & set(stamps)
    status, result = player.result(handle)
    assert status == GoalStatus.STATUS_SUCCEEDED and result.success, result.reason
    assert "from the model's end of the movement" in result.reason


def test_time_that_has_jumped_back_for_good_ends_the_movement(player: Player) -> None:
    handle = player.start()
    player.stamp_ns -= 5 * SECOND
    status, result = player.result(handle)
    assert status == GoalStatus.STATUS_ABORTED and "time jumped backwards, by" in result.reason


def test_stamps_that_stand_still_end_the_goal_and_are_named(player: Player) -> None:
    assert set_parameters(player.node, NODE, start_timeout=1.0).successful
    handle = player.send()
    future = handle.get_result_async()  # type: ignore[attr-defined]

    def ended() -> bool:
        player._states.publish(state_at(player.stamp_ns))
        player.show(PLACES)
        return bool(future.done())

    spin_until(player.node, ended, message="the result", processes=(player.process,))
    assert set_parameters(player.node, NODE, start_timeout=STARTUP_TIMEOUT).successful
    reason = future.result().result.reason
    assert f"their stamps stay at {player.stamp_ns / SECOND:.3f} s" in reason, reason


def test_a_robot_that_is_stuck_elsewhere_is_named_with_what_its_controller_says(player: Player) -> None:
    says = player.node.create_publisher(ControllerState, "controller_state", LATCHED)
    says.publish(ControllerState(state=ControllerState.DAMPING, reason="no reference yet"))
    handle = player.start()
    pose = np.array([0.2, -0.6, 0.9, 0.0, 0.0, 0.0, 1.0])
    future = handle.get_result_async()  # type: ignore[attr-defined]
    while not future.done():
        player.tick(unless=future.done, pose=pose)
    player.node.destroy_publisher(says)
    result = future.result().result
    assert not result.success and "the robot has stopped there" in result.reason
    assert "the controller says 'DAMPING: no reference yet'" in result.reason
