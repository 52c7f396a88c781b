# SPDX-License-Identifier: Apache-2.0
"""The example that hands learned costs to solvers of others: they keep limits; it says what to install without them."""

from __future__ import annotations

import numpy as np
import pytest

from examples import optimal_control
from examples.solvers import SOLVERS, Problem, installed


def costs(times: np.ndarray) -> dict[str, object]:
    """Of two frames over poses: one says where the beginning is, the other one where the end is."""
    sure, unsure = np.diag([1e4] * 3 + [1.0] * 3), 1e-2 * np.eye(6)
    middle = len(times) // 2
    target = [0.0, 0.1, 0.0, 0.0, 0.0, 0.0, 1.0]
    first = [sure if t < middle else unsure for t in range(len(times))]
    second = [unsure if t < middle else sure for t in range(len(times))]
    return {
        "times": times.tolist(),
        "frames": {
            name: {"targets": [target] * len(times), "precisions": [W.tolist() for W in weights]}
            for name, weights in (("first", first), ("second", second))
        },
    }


def each_solver() -> list[pytest.ParameterSet]:
    there = installed()
    return [
        pytest.param(name, marks=pytest.mark.skipif(name not in there, reason=f"{name} is optional"))
        for name in SOLVERS
    ]


def problem(limits: tuple[float, float] | None = None) -> Problem:
    """From (0, 0.1, 0) to (0.9, 0, 0), as each frame sees it from where it is."""
    quarter = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
    places = {"first": (np.eye(3), np.zeros(3)), "second": (quarter, np.array([1.0, 0.0, 0.0]))}
    return Problem.of(costs(np.linspace(0.0, 2.0, 21)), places, limits)


def test_the_costs_of_all_frames_are_one_cost_where_the_frames_are() -> None:
    shown = problem()
    surely, hardly = np.array([0.0, 0.1, 0.0]), np.array([0.9, 0.0, 0.0])
    for t, (sure, unsure) in ((0, (surely, hardly)), (20, (hardly, surely))):
        p = np.array([0.3, -0.2, 0.5])
        gradient = shown.precisions[t] @ (p - shown.targets[t])
        np.testing.assert_allclose(gradient, 1e4 * (p - sure) + 1e-2 * (p - unsure), rtol=1e-9)


@pytest.mark.parametrize("solver", each_solver())
def test_the_movement_goes_where_the_frames_say_and_keeps_limits(solver: str) -> None:
    planned = SOLVERS[solver][1]
    path, velocities, _ = planned(problem())
    np.testing.assert_allclose(path[[0, -1]], [[0.0, 0.1, 0.0], [0.9, 0.0, 0.0]], atol=1e-3)
    fastest = np.abs(velocities).max()
    _, slow, accelerations = planned(problem((0.5 * fastest, 20.0)))
    assert np.abs(slow).max() == pytest.approx(0.5 * fastest, rel=1e-3)
    assert np.abs(accelerations).max() == pytest.approx(20.0, rel=1e-4)


@pytest.mark.skipif(len(installed()) < 2, reason="CasADi and Crocoddyl are optional")
def test_both_solvers_find_the_same_movement() -> None:
    first, second = (SOLVERS[name][1](problem()) for name in SOLVERS)
    for one, other in zip(first, second, strict=True):
        np.testing.assert_allclose(one, other, atol=1e-8)


def test_without_a_solver_the_program_says_what_to_install(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(optimal_control, "installed", list)
    assert optimal_control.main(["--solver", "Crocoddyl"]) == 1
    assert "Crocoddyl is not installed: .venv/bin/python -m pip install crocoddyl" in capsys.readouterr().err
