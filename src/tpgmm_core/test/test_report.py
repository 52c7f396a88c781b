# SPDX-License-Identifier: Apache-2.0
"""Tables are aligned, and JSON files hold what was given."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from tpgmm_core.common.report import Row, format_rows, format_table, write_json


def test_tables_align_numbers_to_the_right() -> None:
    table = format_table(("name", "value"), [("a", 1.0), ("long name", 22.5)])
    assert table.splitlines() == [
        "name       value",
        "---------  -----",
        "a              1",
        "long name   22.5",
    ]


def test_rows_are_a_table_with_a_dash_for_what_is_missing() -> None:
    rows: list[Row] = [{"K": 3, "rate": 12.34567, "ok": True}, {"K": 12, "rate": None, "ok": False}]
    assert format_rows(rows).splitlines() == [
        " K   rate  ok",
        "--  -----  -----",
        " 3  12.35  True",
        "12      -  False",
    ]


def test_a_json_file_holds_what_was_given_in_a_folder_that_is_made(tmp_path: Path) -> None:
    rows = [{"K": 3, "rate": 0.1, "ok": True, "name": None}]
    write_json(tmp_path / "out" / "rows.json", rows)
    assert json.loads((tmp_path / "out" / "rows.json").read_text()) == rows


def test_a_json_file_holds_no_numbers_that_json_does_not_know(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match="JSON"):
        write_json(tmp_path / "report.json", {"error_m": float("nan")})
    assert not list(tmp_path.iterdir())
