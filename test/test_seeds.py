# SPDX-License-Identifier: Apache-2.0
"""The demo for many seeds: which ones are meant, and that one that fails has a cause."""

from __future__ import annotations

import argparse
import json
import sys
from pathlib import Path
from typing import Any

import pytest

from benchmarks import seeds as program
from benchmarks.seeds import run, seeds_of, table
from tpgmm_ros.runtime.entry import INTERRUPTED


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


@pytest.mark.parametrize(("ended", "expected"), [(1, 1), (INTERRUPTED, INTERRUPTED)])
def test_what_keeps_all_seeds_from_running_is_in_the_report_too(
    ended: int, expected: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "report.json").write_text('{"passed": true}')  # of an earlier run
    monkeypatch.setattr(program.train, "main", lambda arguments: ended)
    monkeypatch.setattr(sys, "argv", ["seeds", "--output", str(tmp_path)])
    assert program.main() == expected
    report = json.loads((tmp_path / "report.json").read_text())
    assert report["passed"] is False and report["error"] and report["seeds"] == []


def test_who_interrupts_keeps_the_seeds_that_are_done(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def run_or_stop(seed: int, *others: Any) -> dict[str, Any]:
        if seed == 2:
            raise KeyboardInterrupt
        return run(seed, *others)

    monkeypatch.setattr(program, "run", run_or_stop)
    missing = str(tmp_path / "missing.tpgmm")
    monkeypatch.setattr(sys, "argv", ["seeds", "--seeds", "1-3", "--model", missing, "--output", str(tmp_path)])
    assert program.main() == INTERRUPTED
    report = json.loads((tmp_path / "report.json").read_text())
    assert (report["passed"], report["error"], report["failed"]) == (False, "interrupted", [1])
    assert "missing.tpgmm" in capsys.readouterr().out
