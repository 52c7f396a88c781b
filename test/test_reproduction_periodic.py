# SPDX-License-Identifier: Apache-2.0
"""reproduction of a movement that repeats: a goal asks for a duration, and gets whole cycles from rest to rest."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from action_msgs.msg import GoalStatus

from reproduction_player import PLACES, TICK_NS, Player, means
from tpgmm_core.geometry import quaternion
from tpgmm_core.learning.periodic import PeriodicTPGMM
from tpgmm_core.retrieval.recipe import Recipe
from tpgmm_ros.task.state_space import DIMENSIONS
from wiping import wiping_demonstrations


def test_a_goal_gets_as_many_cycles_as_its_duration_holds_and_ends_at_rest(
    player: Player, model_file: Path, tmp_path: Path
) -> None:
    model = Recipe.of({"retrieval": "periodic"}).learn(wiping_demonstrations(), "R1 x R3 x S3", DIMENSIONS)
    assert isinstance(model, PeriodicTPGMM)
    model.save(tmp_path / "wipe.tpgmm")
    duration = 2.5 * model.period_
    handle = player.start(str(tmp_path / "wipe.tpgmm"), duration=duration)
    status, result = player.result(handle)
    assert status == GoalStatus.STATUS_SUCCEEDED and result.success, result.reason
    assert player.references[-1].phase == 1.0 and all(0.0 <= item.phase <= 1.0 for item in player.feedback)

    path = means(player.references)[:, :3]
    x, y, _ = ((path - PLACES["object"][:3]) @ quaternion.rotation_matrix(PLACES["object"][3:]) - [0.2, 0.0, 0.0]).T
    assert np.ptp(np.unwrap(np.arctan2(y, x))) / (2.0 * np.pi) > 1.99, "two cycles, before the object"
    assert np.hypot(x, y).max() < 0.13
    steps = np.linalg.norm(np.diff(path, axis=0), axis=1)
    assert steps[-1] < 1e-6 and steps.max() < 2.0 * 0.1 * 2.0 * np.pi / model.period_ * 1e-9 * TICK_NS
    np.testing.assert_allclose(path[-1], path[0], atol=0.02)
