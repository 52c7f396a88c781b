# SPDX-License-Identifier: Apache-2.0
"""reproduction on its topics and its action: task parameters and joint states in, references out."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np
import pytest
from action_msgs.msg import GoalStatus
from sensor_msgs.msg import JointState
from visualization_msgs.msg import Marker, MarkerArray

from reproduction_player import DURATION, NODE, PLACES, POSE, TICK_NS, Player, means, trained
from ros_graph import (
    ACTIVATE,
    ALL,
    DEACTIVATE,
    SECOND,
    TASK_FILE,
    change_state,
    result_of,
    set_parameters,
)
from ros_testing import STARTUP_TIMEOUT, spin_until
from tpgmm_core import TPGMM, Frame
from tpgmm_core.geometry import quaternion
from tpgmm_msgs.msg import ControllerState, Reference
from tpgmm_ros.messages import conversions
from tpgmm_ros.messages.qos import LATCHED


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
        for places, path, reason in ((far, told, "too new for the model: novelty"), (PLACES, "", "--leave-one-out")):
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
    # Neither the position nor its velocity jumps. What the camera changes is answered at once, also between two ticks
    path = means(player.references[2:])[:, :3]
    stamps_ns = np.array([conversions.time_to_ns(reference.header.stamp) for reference in player.references[2:]])
    steps = np.diff(stamps_ns)[:, None] / SECOND
    velocities = np.diff(path, axis=0) / steps
    assert np.abs(velocities).max() < 0.4
    assert np.abs(np.diff(velocities, axis=0) / (0.5 * (steps[1:] + steps[:-1]))).max() < 1.0


def test_a_movement_waits_for_a_frame_that_it_needs_and_is_aborted_where_that_does_not_come(player: Player) -> None:
    def lose_target() -> None:
        while player.references[-1].phase > 0.5:  # the end of the movement before, which is held
            player.tick()
        while player.references[-1].phase < 0.85:
            player.tick()
        player.show({**PLACES, "target": None})

    # a model of few components knows little with all frames, too
    assert set_parameters(player.node, NODE, unknown_ratio=5.0).successful
    handle = player.start(duration=2.0 * DURATION)
    lose_target()
    spin_until(
        player.node,
        lambda: player.tick() is not None and bool(player.feedback) and bool(player.feedback[-1].waits),
        message="the feedback to say why it waits",
    )
    assert player.feedback[-1].waits.startswith("without target the reference is known to ")
    assert set(player.feedback[-1].frames) == {"object", "robot"}
    for _ in range(SECOND // 2 // TICK_NS):  # until it has come to rest
        player.tick()
    stands = player.references[-1].phase
    for _ in range(20):
        player.tick()
    assert player.references[-1].phase == pytest.approx(stands, abs=1e-3) and stands < 1.0
    player.show(PLACES)
    status, result = player.result(handle)
    assert status == GoalStatus.STATUS_SUCCEEDED and result.final_position_error < 1e-3, result.reason
    steps = np.linalg.norm(np.diff(means(player.references)[:, :3], axis=0), axis=1)
    since = next(i for i, reference in enumerate(player.references) if reference.phase >= 0.85)
    assert steps[since:].max() < 0.5 * steps[:since].max()

    assert set_parameters(player.node, NODE, unknown_timeout=0.5).successful
    handle = player.start(duration=2.0 * DURATION)
    lose_target()
    status, result = player.result(handle)
    assert set_parameters(player.node, NODE, unknown_timeout=30.0, unknown_ratio=10.0).successful
    assert status == GoalStatus.STATUS_ABORTED and not result.success
    assert result.reason.startswith("waited for 0.5 s at phase ") and "without target" in result.reason
    player.show(PLACES)


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


def test_those_who_listen_are_told_the_course_ahead_as_it_comes_then(player: Player) -> None:
    told: list[Reference] = []
    subscription = player.node.create_subscription(Reference, "reference_ahead", told.append, ALL)
    player.start(duration=6.0)

    def is_told() -> bool:
        player.tick()
        return len(told) > 1

    spin_until(player.node, is_told, message="the course ahead", processes=(player.process,))
    ahead = told[1]  # the first one may be from before the frames were there
    step_ns = round(1e9 * ahead.horizon_time_step)
    begin_ns = conversions.time_to_ns(ahead.header.stamp)
    assert len(ahead.horizon) == 12 and step_ns == 200_000_000
    player.references.clear()
    while player.stamp_ns < begin_ns + 7 * step_ns:
        player.tick()
    came = {conversions.time_to_ns(one.header.stamp): one.gaussian for one in player.references}
    for number, gaussian in enumerate(ahead.horizon[:6], start=1):
        stamps = np.array(list(came))
        then = came[int(stamps[np.argmin(np.abs(stamps - begin_ns - number * step_ns))])]
        np.testing.assert_allclose(gaussian.mean, then.mean, atol=2e-3)
        np.testing.assert_allclose(gaussian.covariance, then.covariance, rtol=0.2, atol=1e-6)
    moved = np.linalg.norm(np.array(ahead.horizon[5].mean[:3]) - ahead.gaussian.mean[:3])
    assert moved > 0.01
    player.node.destroy_subscription(subscription)


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
    spin_until(player.node, says.get_subscription_count, message="who listens", processes=(player.process,))
    handle = player.start()
    pose = np.array([0.2, -0.6, 0.9, 0.0, 0.0, 0.0, 1.0])
    future = handle.get_result_async()  # type: ignore[attr-defined]
    while not future.done():
        player.tick(unless=future.done, pose=pose)
    player.node.destroy_publisher(says)
    result = future.result().result
    assert not result.success and "the robot has stopped there" in result.reason
    assert "the controller says 'DAMPING: no reference yet'" in result.reason


def test_what_a_controller_said_that_is_gone_is_told_as_such(player: Player) -> None:
    says = player.node.create_publisher(ControllerState, "controller_state", LATCHED)
    says.publish(ControllerState(state=ControllerState.ACTIVE, reason="following the reference"))
    handle = player.start()
    spin_until(player.node, says.get_subscription_count, message="who listens", processes=(player.process,))
    assert says.wait_for_all_acked()
    player.node.destroy_publisher(says)
    pose = np.array([0.2, -0.6, 0.9, 0.0, 0.0, 0.0, 1.0])
    future = handle.get_result_async()  # type: ignore[attr-defined]
    while not future.done():
        player.tick(unless=future.done, pose=pose)
    words = "no controller publishes on controller_state any more; it said last 'ACTIVE: following the reference'"
    assert words in future.result().result.reason
