# SPDX-License-Identifier: Apache-2.0
"""The example that hands learned costs to CasADi: its solver keeps limits, and says what to install where it is not."""

from __future__ import annotations

from importlib.util import find_spec

import numpy as np
import pytest

from examples import optimal_control

IS_INSTALLED = find_spec("casadi") is not None


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


@pytest.mark.skipif(not IS_INSTALLED, reason="CasADi is optional")
def test_the_movement_goes_where_the_frames_say_and_keeps_limits() -> None:
    quarter = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
    places = {"first": (np.eye(3), np.zeros(3)), "second": (quarter, np.array([1.0, 0.0, 0.0]))}
    path, velocities, _ = optimal_control.planned(costs(np.linspace(0.0, 2.0, 21)), places)
    np.testing.assert_allclose(path[[0, -1]], [[0.0, 0.1, 0.0], [0.9, 0.0, 0.0]], atol=1e-3)
    fastest = np.abs(velocities).max()
    _, slow, accelerations = optimal_control.planned(costs(np.linspace(0.0, 2.0, 21)), places, (0.5 * fastest, 20.0))
    assert np.abs(slow).max() == pytest.approx(0.5 * fastest, rel=1e-4)
    assert np.abs(accelerations).max() <= 20.0 + 1e-4


@pytest.mark.skipif(IS_INSTALLED, reason="CasADi is there")
def test_without_casadi_the_program_says_what_to_install(capsys: pytest.CaptureFixture[str]) -> None:
    assert optimal_control.main([]) == 1
    assert "pip install casadi" in capsys.readouterr().err
