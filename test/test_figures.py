# SPDX-License-Identifier: Apache-2.0
"""Figures 1 and 3 of the paper: their situations are right, and the programs run with and without the data."""

from __future__ import annotations

import json
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest

from examples import figure1, figure3, planar
from tpgmm_core import Frame

DATA = Path(__file__).resolve().parents[2] / "shared" / "data" / "pbdlib"
needs_data = pytest.mark.skipif(
    not (DATA / "Data02.mat").is_file(), reason="pbdlib's data are not beside the repository"
)


def reflected(angle: float, scale: float, b: list[float]) -> Frame:
    c, s = scale * np.cos(angle), scale * np.sin(angle)
    return Frame(np.array([[c, s], [s, -c]]), np.array(b)).with_time()


@pytest.mark.parametrize("fraction", [-1.0, 0.0, 0.3, 1.0, 4.0])
def test_frames_turn_by_their_angle_and_keep_their_lengths(fraction: float) -> None:
    start, end = reflected(0.2, 0.3, [0.0, 1.0]), reflected(0.7, 0.3, [1.0, 1.0])
    found = planar.between(start, end, fraction)
    expected = reflected(0.2 + 0.5 * fraction, 0.3, [fraction, 1.0])
    np.testing.assert_allclose(found.A, expected.A, atol=1e-12)
    np.testing.assert_allclose(found.b, expected.b, atol=1e-12)


def test_no_turn_leads_from_a_rotation_to_a_reflection() -> None:
    with pytest.raises(ValueError, match="reflection"):
        planar.between(Frame(np.eye(2), np.zeros(2)).with_time(), reflected(0.0, 1.0, [0.0, 0.0]), 0.5)


@needs_data
@pytest.mark.parametrize(("program", "name"), [(figure1, "figure1"), (figure3, "figure3")])
def test_the_figures_are_made(program: ModuleType, name: str, tmp_path: Path) -> None:
    assert program.main(["--data", str(DATA), "--output", str(tmp_path)]) == 0
    rows = json.loads((tmp_path / f"{name}.json").read_text())
    assert rows and all(row["passed"] for row in rows)
    assert (tmp_path / f"{name}.png").stat().st_size > 20000


@pytest.mark.parametrize("program", [figure1, figure3])
def test_without_the_data_the_figures_are_left_out_with_the_reason(
    program: ModuleType, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert program.main(["--data", str(tmp_path), "--output", str(tmp_path / "out")]) == 0
    assert "Data02.mat is missing" in capsys.readouterr().out and not (tmp_path / "out").exists()
