# SPDX-License-Identifier: Apache-2.0
"""Figures 1 to 4 of the paper: the programs show what the captions say, in numbers, and fail where they do not."""

from __future__ import annotations

import json
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest

from examples import figure1, figure2, figure3, figure4, pbdlib, planar
from examples.claims import at_least, at_most, canvas, finish
from tpgmm_core import Frame, Gaussian


@pytest.mark.parametrize("program", [figure1, figure2, figure3, figure4], ids=lambda program: program.__name__)
def test_the_figures_are_made(program: ModuleType, tmp_path: Path) -> None:
    name = program.__name__.rpartition(".")[2]
    assert program.main(["--output", str(tmp_path)]) == 0
    rows = json.loads((tmp_path / f"{name}.json").read_text())
    assert len(rows) > 2 and all(row["passed"] for row in rows)
    assert (tmp_path / f"{name}.png").stat().st_size > 20000


def test_a_claim_that_does_not_hold_is_exit_status_1(tmp_path: Path) -> None:
    good, bad = at_most("small", 1.0, 1.0), at_least("large", 0.9, 1.0)
    assert good["passed"] and not bad["passed"]
    assert not at_most("nothing", float("nan"), 1.0)["passed"] and not at_least("", float("nan"), 1.0)["passed"]
    assert finish("good", canvas(1.0, 1.0), [good], tmp_path) == 0
    assert finish("bad", canvas(1.0, 1.0), [good, bad], tmp_path) == 1
    assert (tmp_path / "bad.png").is_file() and len(json.loads((tmp_path / "bad.json").read_text())) == 2


def test_a_model_that_does_not_regard_the_second_box_fails_figure_3() -> None:
    shown = planar.demonstrations()
    good, blind = planar.learned(shown), planar.learned(shown)
    blind.covariances_["second"] = 1e6 * blind.covariances_["second"]
    few = planar.learned(shown, figure3.FEW)
    assert all(row["passed"] for row in figure3.claims(shown, good, few))
    failed = [row["claim"] for row in figure3.claims(shown, blind, few) if not row["passed"]]
    assert sum("from the second box" in str(claim) for claim in failed) == len(figure3.situations())


def test_the_objective_of_figure_2_is_eq_3() -> None:
    one = [Gaussian([1.0, 2.0], [[4.0, 0.0], [0.0, 0.25]])]
    np.testing.assert_allclose(figure2.objective([[1.0, 2.0], [3.0, 2.0], [1.0, 3.0]], one), [0.0, 1.0, 4.0])
    np.testing.assert_allclose(figure2.curvature(np.zeros(2), one), np.diag([0.5, 8.0]), atol=1e-9)


def test_a_push_moves_the_hand_by_its_share_of_the_stiffness() -> None:
    """At rest, after some seconds: K x = push."""
    times = np.linspace(0.0, 5.0, 501)
    gains = figure1.double_integrator_gains(np.tile(np.diag([1.0, 4.0]), (501, 1, 1)), 1e-4)
    path = figure1.pushed(np.zeros((501, 2)), gains, times)
    np.testing.assert_allclose(path[-1], np.linalg.solve(gains.stiffness[0], figure1.PUSH), atol=1e-6)


def test_diagonal_covariances_everywhere_fail_figure_4() -> None:
    rng = np.random.default_rng(1)
    points, piece = figure4.bent_path(rng)
    angles, phase = figure4.joints(rng)
    good = {title: figure4.learned(points, piece, structure) for title, structure in figure4.IN_SPACE.items()}
    some = {title: figure4.learned(angles[:240], phase[:240], s) for title, s in figure4.IN_JOINTS.items()}
    assert all(row["passed"] for row in figure4.claims(good, some, angles[240:]))
    diagonal = {title: good["diagonal"] for title in good}, {title: some["diagonal"] for title in some}
    assert sum(not row["passed"] for row in figure4.claims(*diagonal, angles[240:])) == 5


def reflected(angle: float, scale: float, b: list[float]) -> Frame:
    c, s = scale * np.cos(angle), scale * np.sin(angle)
    return Frame(np.array([[c, s], [s, -c]]), np.array(b)).with_time()


@pytest.mark.parametrize("fraction", [-1.0, 0.0, 0.3, 1.0, 4.0])
def test_frames_turn_by_their_angle_and_keep_their_lengths(fraction: float) -> None:
    start, end = reflected(0.2, 0.3, [0.0, 1.0]), reflected(0.7, 0.3, [1.0, 1.0])
    found = pbdlib.between(start, end, fraction)
    expected = reflected(0.2 + 0.5 * fraction, 0.3, [fraction, 1.0])
    np.testing.assert_allclose(found.A, expected.A, atol=1e-12)
    np.testing.assert_allclose(found.b, expected.b, atol=1e-12)


def test_no_turn_leads_from_a_rotation_to_a_reflection() -> None:
    with pytest.raises(ValueError, match="reflection"):
        pbdlib.between(Frame(np.eye(2), np.zeros(2)).with_time(), reflected(0.0, 1.0, [0.0, 0.0]), 0.5)


def test_without_the_data_of_pbdlib_the_reason_says_where_to_give_them(tmp_path: Path) -> None:
    with pytest.raises(FileNotFoundError, match="Data02.mat is missing: give the directory .* by --data"):
        pbdlib.demonstrations(tmp_path)
