# SPDX-License-Identifier: Apache-2.0
"""Edits beside a bag: it is cut or left out, and stays as it is."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from synthetic_bags import REACH_TASK, Topic, reach, write_bag
from tpgmm_ros.recordings.bags import BagError, find_bags, join_parts, read_recording, read_recordings, read_takes
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
    with pytest.raises(BagError, match="movement has 5 samples, expected at least 10; leave more of it"):
        read_recording(bag, TASK)
    edit(bag, "from: 6\n")
    with pytest.raises(BagError, match="edits begin at 6 s, and its movement ends after 5.00 s"):
        read_recording(bag, TASK)
    edit(bag, "from: 1.01\nto: 1.02\n")
    with pytest.raises(BagError, match="its edits keep 1.01 to 1.02 s, and its movement has no sample there"):
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
        ("takes: [[0, 0.5], [1, 2]]\nfrom: 0.6\n", "a take from 0 to 0.5 s, outside of what they keep by from and to"),
        ("[", "edits"),
    ],
)
def test_edits_that_make_no_sense_are_refused_with_the_reason(text: str, words: str, tmp_path: Path) -> None:
    bag = write_bag(tmp_path / "demo", reach(0, samples=40))
    edit(bag, text)
    with pytest.raises(BagError, match=words):
        read_recording(bag, TASK)


def test_edits_count_by_whatever_path_their_bag_is_given(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    bag = write_bag(tmp_path / "demo", reach(0, samples=101))
    edit(bag, "from: 1.0\nto: 4.0\n")
    (tmp_path / "elsewhere").mkdir()
    link = tmp_path / "elsewhere" / "link"
    link.symlink_to(bag)
    monkeypatch.chdir(bag)
    for path in (Path(), Path("../demo"), Path("demo.mcap"), bag / "demo.mcap", link, bag):
        (found,) = find_bags([path])
        assert found.name in ("demo", "demo.mcap", "link") and len(read_recording(found, TASK).times) == 61, path
    bare = tmp_path / "elsewhere" / "bare.mcap"
    bare.write_bytes((bag / "demo.mcap").read_bytes())
    for name in ("bare.edits.yaml", "bare.mcap.edits.yaml"):
        file = bare.with_name(name)
        file.write_text("to: 2.0\n")
        assert find_bags([tmp_path / "elsewhere"]) and len(read_recording(bare, TASK).times) == 41
        file.unlink()
    (tmp_path / "elsewhere" / "link.edits.yaml").write_text("to: 2.0\n")
    with pytest.raises(BagError, match="has edits in 2 files, .*: keep one of them"):
        read_recording(link, TASK)


@pytest.mark.parametrize("name", ["demo_01.edits.yaml", "demo_1.edits.yml", "demo_1.edit.yaml", "demo_1/edits.yaml"])
def test_edits_that_are_those_of_no_bag_are_named(name: str, tmp_path: Path) -> None:
    for i in range(2):
        write_bag(tmp_path / f"demo_{i}", reach(i))
    (tmp_path / "demo_1.edits.yaml").write_text("from: 1\n")
    (tmp_path / "more.yaml").write_text("a: 1\n")
    assert len(find_bags([tmp_path])) == 2
    (tmp_path / name).write_text("leave_out: true\n")
    with pytest.raises(BagError, match=f"holds {name}, which looks like edits and belongs to none of its bags"):
        find_bags([tmp_path])


def test_edits_that_go_on_after_the_end_are_said(tmp_path: Path) -> None:
    bag = write_bag(tmp_path / "demo", reach(0, samples=101))
    for text, end in (("to: 4000\n", 4000), ("takes: [[0, 1], [2, 3000]]\n", 3000)):
        edit(bag, text)
        (take, *_), bad = read_takes(bag, TASK)
        assert not bad and f"they name {end} s as an end, and the movement ends after 5.00 s" in take.notes[-1]
    edit(bag, "to: 5.5\n")
    assert not read_recording(bag, TASK).notes


def test_edits_of_a_later_part_of_a_recording_are_not_passed_over(tmp_path: Path) -> None:
    topics = reach(0)
    halves = [
        write_bag(
            tmp_path / f"demo_{i}",
            {name: Topic(topic.poses[part], topic.recorded[part]) for name, topic in topics.items()},
        )
        for i, part in enumerate((slice(50), slice(50, None)))
    ]
    edit(halves[1], "to: 1\n")
    (joined,) = join_parts(halves)
    with pytest.raises(BagError, match="goes on in demo_1, which has edits of its own: .* into demo_0.edits.yaml"):
        read_takes(joined, TASK)


def test_edits_that_cannot_be_read_leave_the_other_bags_as_they_are(tmp_path: Path) -> None:
    bags = [write_bag(tmp_path / f"demo_{i}", reach(i)) for i in range(3)]
    edit(bags[1], "to: 3 s\n")
    assert find_bags([tmp_path]) == bags
    good, bad = read_recordings(bags, TASK)
    assert len(good) == 2 and len(bad) == 1 and "demo_1.edits.yaml: 'to' is '3 s'" in str(bad[0])
