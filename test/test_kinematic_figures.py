# SPDX-License-Identifier: Apache-2.0
"""What the program of figure 6 judges by, and the picture of Eqs. (7) to (12) in one model."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from examples import figure6, kinematic_relevance, two_hands
from long_tests import mostly_long
from tpgmm_core.kinematics.chains import planar_bimanual
from tpgmm_core.kinematics.frames import SecondaryTaskSpace, TaskSpace


@pytest.mark.parametrize(
    ("case", "variant"),
    mostly_long(
        [("left first", figure6.PAPER), ("right first", figure6.PAPER), ("compromise", figure6.ALL)],
        ("left first", figure6.PAPER),
    ),
)
def test_priorities_are_learned_as_figure_6_shows(case: str, variant: str) -> None:
    """In small: one new path of the objects, fewer demonstrations of priorities."""
    robot, rng = planar_bimanual(), np.random.default_rng(1)
    weights, order = figure6.CASES[case]
    new = two_hands.object_paths(robot, rng)
    contested = two_hands.out_of_reach(robot, new)
    count = 3 if case == "compromise" else 2
    shown = [two_hands.demonstration(robot, weights, rng) for _ in range(count)]
    product = figure6.learned(robot, figure6.VARIANTS[variant], shown)
    found = figure6.measured(robot, [figure6.reproduced(product, new)], contested)
    told = figure6.measured(robot, [two_hands.by_hand(robot, order, new)], contested)
    rows = figure6.claims(case, variant, found, told)
    assert rows[1]["passed"], rows
    if case == "compromise":
        assert rows[0]["passed"], rows
    else:  # the other order is not what was shown
        other = {"left first": "right first", "right first": "left first"}[case]
        assert not figure6.claims(other, variant, found, told)[1]["passed"]


def test_the_paper_has_the_frames_of_eqs_9_and_12_and_nothing_else() -> None:
    frames = figure6.candidate_frames(figure6.VARIANTS[figure6.PAPER])
    assert list(frames) == ["left", "right below left", "right", "left below right"]
    for name, frame in frames.items():
        if " below " in name:
            assert isinstance(frame, SecondaryTaskSpace) and not frame.least_error and frame.objects
        else:
            assert isinstance(frame, TaskSpace) and frame.objects == {f"{name} object"}


def test_the_best_compromise_has_no_better_neighbour_and_follows_its_weights() -> None:
    robot, rng = planar_bimanual(), np.random.default_rng(1)
    targets = {"left": np.array([-2.6, 0.8]), "right": np.array([2.6, 0.8])}

    def cost(q: np.ndarray, weights: tuple[float, float]) -> float:
        robot.update(q)
        return sum(
            w * float(np.sum((targets[hand] - robot.place(hand)) ** 2))
            for w, hand in zip(weights, two_hands.HANDS, strict=True)
        )

    for weights in ((1.0, 1.0), (1.0, 1e-4)):
        q = two_hands.START
        for _ in range(20):
            q = two_hands.best_compromise(robot, q, targets, weights)
        assert all(cost(q + 1e-3 * rng.normal(size=5), weights) > cost(q, weights) - 1e-9 for _ in range(50))
    robot.update(q)
    assert np.linalg.norm(targets["left"] - robot.place("left")) < 1e-3


def test_what_counted_when_is_found_on_the_arm(tmp_path: Path) -> None:
    assert kinematic_relevance.main(["--output", str(tmp_path)]) == 0
    rows = json.loads((tmp_path / "report.json").read_text())
    assert len(rows) == 4 and (tmp_path / "kinematic_relevance.png").stat().st_size > 20000
