# SPDX-License-Identifier: Apache-2.0
"""What the program of figure 6 judges by, and the picture of Eqs. (7) to (12) in one model."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np

from examples import figure6, kinematic_relevance
from tpgmm_core.kinematics.chains import planar_bimanual


def test_the_mirror_exchanges_the_hands() -> None:
    robot, rng = planar_bimanual(), np.random.default_rng(0)
    movement = figure6.Movement(figure6.object_paths(robot, rng), rng.normal(size=(figure6.STEPS, 5)))
    errors, mirrored = figure6.errors(robot, movement), figure6.errors(robot, figure6.mirrored(movement))
    np.testing.assert_allclose(mirrored, errors[:, ::-1], atol=1e-12)


def test_the_best_compromise_has_no_better_neighbour_and_follows_its_weights() -> None:
    robot, rng = planar_bimanual(), np.random.default_rng(1)
    targets = {"left": np.array([-2.6, 0.8]), "right": np.array([2.6, 0.8])}

    def cost(q: np.ndarray, weights: tuple[float, float]) -> float:
        robot.update(q)
        return sum(
            w * float(np.sum((targets[hand] - robot.place(hand)) ** 2))
            for w, hand in zip(weights, figure6.HANDS, strict=True)
        )

    for weights in ((1.0, 1.0), (1.0, 1e-4)):
        q = figure6.START
        for _ in range(20):
            q = figure6.best_compromise(robot, q, targets, weights)
        assert all(cost(q + 1e-3 * rng.normal(size=5), weights) > cost(q, weights) - 1e-9 for _ in range(50))
    robot.update(q)
    assert np.linalg.norm(targets["left"] - robot.place("left")) < 1e-3


def test_what_counted_when_is_found_on_the_arm(tmp_path: Path) -> None:
    assert kinematic_relevance.main(["--output", str(tmp_path)]) == 0
    rows = json.loads((tmp_path / "report.json").read_text())
    assert len(rows) == 4 and (tmp_path / "kinematic_relevance.png").stat().st_size > 20000
