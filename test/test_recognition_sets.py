# SPDX-License-Identifier: Apache-2.0
"""Recorded movements that no model has seen are recognised, and what is said about them is as sure as it should be."""

from __future__ import annotations

import numpy as np
import pytest

from benchmarks.recognition import calibration, data_sets, measure
from ros_graph import ROOT

DATA = ROOT.parent / "shared" / "data"


@pytest.mark.skipif(not DATA.is_dir(), reason=f"{DATA} is not there: it is no part of the project")
def test_phases_of_a_valve_that_is_opened_are_recognised_in_demonstrations_left_out() -> None:
    row, _ = measure("valve", data_sets(DATA)["valve"]())
    assert row["movements"] == 18
    whole, half = row["right_after_100"], row["right_after_50"]
    assert isinstance(whole, float) and whole >= 17 / 18 - 1e-3, row
    assert isinstance(half, float) and half >= 16 / 18 - 1e-3, row
    assert row["passed"] is True


def test_of_what_is_said_with_a_probability_the_share_that_is_so_is_counted() -> None:
    p = np.array([0.4, 0.9, 0.9, 0.99])
    rows = calibration("data", p, np.array([False, True, False, True]))
    assert [(row["moments"], row["right"]) for row in rows] == [(1, 0.0), (2, 0.5), (1, 1.0)]
