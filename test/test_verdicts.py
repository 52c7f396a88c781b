# SPDX-License-Identifier: Apache-2.0
"""Verdicts of benchmarks can be false, and their exit status says so."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from benchmarks.few_demonstrations import more_is_better
from benchmarks.report import write_report
from benchmarks.retrieval_table import WITHOUT_FRAMES, frames_help
from benchmarks.valve_selection import is_borne_out
from tpgmm_core.common.report import Row
from tpgmm_core.retrieval.methods import METHODS


@pytest.mark.parametrize(("verdicts", "status"), [([True, None], 0), ([None, None], 0), ([True, False, None], 1)])
def test_a_row_that_does_not_pass_makes_the_exit_status_1_and_is_named(
    verdicts: list[bool | None], status: int, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    rows: list[Row] = [{"work": f"work {i}", "passed": verdict} for i, verdict in enumerate(verdicts)]
    assert write_report("name", rows, tmp_path) == status
    assert ("not reached: work work 1" in capsys.readouterr().out) == bool(status)
    assert json.loads((tmp_path / "name.json").read_text()) == rows
    assert write_report("name", [{"work": "without a verdict", "ms": 1.0}], tmp_path) == 0


def test_the_retrieval_table_passes_where_frames_help() -> None:
    means = [{"method": name, "position_rmse_by_share_m": 0.2 + 0.01 * i} for i, name in enumerate(METHODS)]
    assert frames_help([*means, {"method": WITHOUT_FRAMES, "position_rmse_by_share_m": 0.21}])
    assert not frames_help([*means, {"method": WITHOUT_FRAMES, "position_rmse_by_share_m": 0.19}])


def test_a_selection_is_borne_out_by_what_it_reproduces() -> None:
    rows = [
        {"name": name, "error": None, "position_rmse_m": rmse} for name, rmse in (("a", 0.1), ("b", 0.2), ("c", 0.3))
    ]
    assert is_borne_out(rows, "a", "b") and is_borne_out(rows, "b", "b")
    assert not is_borne_out(rows, "b", "a")
    assert not is_borne_out([*rows, {"name": "d", "error": "singular", "position_rmse_m": None}], "a", "b")


def test_more_demonstrations_have_to_be_better() -> None:
    def rows(*errors: float | None) -> list[dict[str, object]]:
        return [{"rmse_m": error, "refused": error is None} for error in errors]

    assert more_is_better(rows(None, 0.2, 0.1)) and more_is_better(rows(0.1))
    assert not more_is_better(rows(0.1, 0.2))
    assert not more_is_better(rows(0.2, None))
