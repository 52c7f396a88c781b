# SPDX-License-Identifier: Apache-2.0
"""What docs/reference/results.md says of hidden frames holds for some recordings of the pick-and-place."""

from __future__ import annotations

import numpy as np
import pytest

from benchmarks import hidden_frames
from benchmarks.irrelevant_frames import demonstrations_of
from ros_graph import ROOT
from tpgmm_core import Demonstration
from tpgmm_core.retrieval.recipe import Recipe
from tpgmm_ros.recordings.bags import find_bags, read_recordings
from tpgmm_ros.task.task_file import Task

OBSERVED = ("object", "target")


@pytest.fixture(scope="module")
def shown() -> tuple[list[Demonstration], str]:
    task = Task.load(ROOT / "config" / "pick_place.yaml")
    recordings, bad = read_recordings(find_bags([ROOT / "bags" / "pick_place"]), task, every=20)
    assert not bad
    return demonstrations_of(recordings[:6])


def test_a_share_of_what_is_seen_is_hidden_in_blocks(shown: tuple[list[Demonstration], str]) -> None:
    seen = hidden_frames.seen_in_blocks(shown[0][0], OBSERVED, 0.4, np.random.default_rng(1))
    for mask in seen.values():
        assert mask.mean() == pytest.approx(0.6, abs=0.05)
        assert np.count_nonzero(np.diff(mask)) <= hidden_frames.BLOCKS


def test_what_is_not_seen_is_left_out_or_where_it_was(shown: tuple[list[Demonstration], str]) -> None:
    movement, before = shown[0][:2]
    seen = {"object": np.arange(len(movement.times)) % 20 >= 10}  # hidden at first, and later on
    np.testing.assert_array_equal(hidden_frames.left_out(movement, seen).is_visible("object"), seen["object"])
    held = hidden_frames.stays(movement, seen)
    np.testing.assert_array_equal(held.is_visible("object"), np.arange(len(movement.times)) >= 10)
    filled = hidden_frames.imputed(movement, seen, before)
    assert filled.is_visible("object").all() and filled.frames["object"].is_time_varying
    np.testing.assert_array_equal(filled.frames["object"].at(9).b, before.frames["object"].at(-1).b)
    np.testing.assert_array_equal(filled.frames["object"].at(25).b, movement.frames["object"].at(19).b)


def test_frames_that_stay_where_they_were_seen_cost_little(shown: tuple[list[Demonstration], str]) -> None:
    demonstrations, space = shown
    recipe = Recipe.of({"n_components": 8, "reg_covar": 1e-5}, "adapt_regress")
    whole, hidden = (
        hidden_frames.errors(demonstrations, space, recipe, OBSERVED, share, seed=0) for share in (0.0, 0.4)
    )
    assert len(set(whole.values())) == 1  # where nothing is hidden all ways are the same
    assert hidden["stays"] < 0.7 * hidden["left out"]
    assert hidden["stays"] < hidden["dropped"]


def test_the_verdict_can_be_false() -> None:
    rows = [{"share": share, "left out": 0.3, "stays": 0.1, "imputed": 0.1} for share in (0.0, 0.2)]
    assert hidden_frames.is_borne(rows)
    for way, error in (("left out", 0.09), ("imputed", 0.09)):
        assert not hidden_frames.is_borne([*rows, {**rows[1], way: error}])
