# SPDX-License-Identifier: Apache-2.0
"""The demo for many seeds: which ones are meant, and that one that fails has a cause."""

from __future__ import annotations

import argparse
from pathlib import Path

import pytest

from benchmarks.seeds import run, seeds_of, table


@pytest.mark.parametrize(
    ("text", "seeds"),
    [
        ("7", [7]),
        ("1001-1003", [1001, 1002, 1003]),
        ("3, 1-2,5-5", [3, 1, 2, 5]),
        ("1-3,2", [1, 2, 3]),
    ],
)
def test_numbers_and_ranges_name_seeds_in_their_order_and_each_once(text: str, seeds: list[int]) -> None:
    assert seeds_of(text) == seeds


@pytest.mark.parametrize("text", ["", "a", "3-1", "-1", "1..3", "1,,2", "1.5"])
def test_what_names_no_seeds_is_refused_in_words(text: str) -> None:
    with pytest.raises(argparse.ArgumentTypeError, match="numbers and ranges|before it begins"):
        seeds_of(text)


def test_a_seed_whose_demo_could_not_begin_has_not_passed_and_says_why(tmp_path: Path) -> None:
    (tmp_path / "9").mkdir()
    (tmp_path / "9" / "report.json").write_text('{"passed": true}')  # of an earlier run
    row = run(9, tmp_path / "missing.tpgmm", "camera", tmp_path / "9")
    assert row["seed"] == 9 and row["passed"] is False
    assert "missing.tpgmm" in row["cause"]
    assert "NO" in table([row]) and row["cause"] in table([row])
