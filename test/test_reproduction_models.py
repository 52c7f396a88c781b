# SPDX-License-Identifier: Apache-2.0
"""reproduction with each retrieval method: models that are loaded during a movement, phases and speeds."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from action_msgs.msg import GoalStatus

from reproduction_player import NODE, PLACES, Player, means
from ros_graph import (
    result_of,
    set_parameters,
)
from ros_testing import spin_until
from tpgmm_core.retrieval.methods import METHODS
from tpgmm_core.retrieval.phase import PHASES
from tpgmm_msgs.msg import Reference
from tpgmm_msgs.srv import LoadModel
from tpgmm_ros.messages import conversions

#: Of the robot's time, while a model is loaded.
TICKS_OF_LOADING = 30


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


def velocities_of(references: list[Reference]) -> np.ndarray:
    """Of the hand from each reference to the next one, (T - 1, 3), m/s."""
    times = 1e-9 * np.array([conversions.time_to_ns(reference.header.stamp) for reference in references])
    return np.diff(means(references)[:, :3], axis=0) / np.diff(times)[:, None]


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
    # As fast as elsewhere, and no jump of the velocity. Where a busy machine took more ticks to load the model, the
    # movement has come further, to where it is faster by itself; and of two states that wait, the newest is answered
    velocities = velocities_of(player.references[1:])
    usual, around = velocities[: before - 2], velocities[before - 5 : before + 60]
    assert np.abs(around).max() < 2.0 * np.abs(usual).max()
    assert np.abs(np.diff(around, axis=0)).max() < 3.0 * np.abs(np.diff(usual, axis=0)).max()
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
    assert not refused.success and "dmp needs a model of" in refused.reason
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
