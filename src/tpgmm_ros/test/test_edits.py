# SPDX-License-Identifier: Apache-2.0
"""Edits beside a bag: it is cut or left out, and stays as it is."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from synthetic_bags import REACH_TASK, reach, write_bag
from tpgmm_ros.recordings.bags import BagError, find_bags, read_recording
from tpgmm_ros.task.task_file import Task

TASK = Task.from_text(REACH_TASK)


def edit(bag: Path, text: str) -> None:
    bag.with_name(f"{bag.name}.edits.yaml").write_text(text)


def test_a_bag_is_cut_to_what_its_edits_say_and_stays_as_it_is(tmp_path: Path) -> None:
    bag = write_bag(tmp_path / "demo", reach(0, samples=101))
    before = {file.name: file.read_bytes() for file in bag.iterdir()}
    whole = read_recording(bag, TASK)
    edit(bag, "from: 1.0\nto: 4.0\n")
    cut = read_recording(bag, TASK)
    np.testing.assert_allclose(cut.times, np.linspace(0.0, 3.0, 61), atol=1e-6)
    np.testing.assert_array_equal(cut.movement, whole.movement[20:81])
    np.testing.assert_array_equal(cut.frames["object"], whole.frames["object"][20:81])
    assert cut.visible["object"].shape == (61,) and "cut to 1.00 to 4.00 s of 5.00 s" in cut.notes[-1]
    assert len(read_recording(bag, TASK, every=20).times) == 4
    assert {file.name: file.read_bytes() for file in bag.iterdir()} == before
    edit(bag, "from: 4.8\n")
    with pytest.raises(BagError, match="movement has 5 samples, expected at least 10"):
        read_recording(bag, TASK)
    edit(bag, "from: 6\n")
    with pytest.raises(BagError, match="edits begin at 6 s, and its movement ends after 5.00 s"):
        read_recording(bag, TASK)


def test_a_bag_that_is_left_out_is_not_found_in_its_folder(tmp_path: Path) -> None:
    bags = [write_bag(tmp_path / f"demo_{i}", reach(i)) for i in range(3)]
    edit(bags[1], "leave_out: true\n")
    assert find_bags([tmp_path]) == [bags[0], bags[2]]
    for bag in bags:
        edit(bag, "leave_out: true\n")
    with pytest.raises(BagError, match="all of its bags are left out by their edits"):
        find_bags([tmp_path])


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("from: 3\nto: 2\n", "name an end after"),
        ("until: 3\n", "until"),
        ("leave_out: 7\n", "true or false"),
        ("[", "edits"),
    ],
)
def test_edits_that_make_no_sense_are_refused_with_the_reason(text: str, words: str, tmp_path: Path) -> None:
    bag = write_bag(tmp_path / "demo", reach(0, samples=20))
    edit(bag, text)
    with pytest.raises(BagError, match=words):
        read_recording(bag, TASK)
