# SPDX-License-Identifier: Apache-2.0
"""`convert`: what cannot be converted, and what is doubted of what was, with the reason."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from conversions_made import COLUMNS, TIMES, csv_of, holds, run, shown
from tpgmm_ros.programs import convert, train
from tpgmm_ros.recordings.conversion.conversion_error import ConversionError
from tpgmm_ros.recordings.conversion.demonstrations import Columns, demonstrations_of


def test_a_frame_that_is_never_seen_is_the_reason(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    lines = csv_of(*shown(0)).splitlines()
    rows = [line.split(",") for line in lines[1:]]
    unseen = "\n".join([lines[0], *(",".join([*row[:8], *[""] * 7, row[15]]) for row in rows)])
    (tmp_path / "shown.csv").write_text(unseen)
    found = run(capsys, "--to", tmp_path / "bags", *COLUMNS, tmp_path / "shown.csv")
    assert "has nothing finite in --frame object=ox,oy,oz,oqx,oqy,oqz,oqw from row 0 on" in found["error"]
    assert not (tmp_path / "bags").exists()


def test_times_in_another_unit_are_said(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    for name, factor in (("ms", 1e3), ("ns", 1e9)):
        (tmp_path / f"{name}.csv").write_text(csv_of(*shown(0), TIMES * factor))
    found = run(capsys, "--to", tmp_path / "ms", *COLUMNS, tmp_path / "ms.csv")
    assert "its samples are 100 s apart: if its times are not in s" in found["bags"][0]["notes"][0]
    found = run(capsys, "--to", tmp_path / "ns", *COLUMNS, tmp_path / "ns.csv")
    assert "would last 4.63e+04 days: its times are not in s" in found["error"]


def test_quaternions_with_w_first_are_suspected_until_it_is_said(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    files = [tmp_path / f"shown_{i}.csv" for i in range(4)]
    for i, file in enumerate(files):
        hand, place = shown(i)
        file.write_text(csv_of(*(np.hstack([p[..., :3], np.roll(p[..., 3:], 1, axis=-1)]) for p in (hand, place))))
    found = run(capsys, "--to", tmp_path / "bags", *COLUMNS, *files)
    assert [doubt["kind"] for doubt in found["doubts"]] == ["order"]
    assert "--orientation wxyz" in found["doubts"][0]["text"]
    task = tmp_path / "bags" / "task.yaml"
    assert train.main(["--task", str(task), "--output", str(tmp_path / "m.tpgmm"), str(tmp_path / "bags")]) == 0
    assert "in the order w, x, y, z" in capsys.readouterr().err
    found = run(capsys, "--to", tmp_path / "right", "--orientation", "wxyz", *COLUMNS, *files)
    assert not found["doubts"]
    holds(tmp_path / "right", 0, *shown(0))


def test_rows_that_repeat_a_time_are_left_out_and_rounded_times_are_refused() -> None:
    hand, _ = shown(0)
    twice = {"t": np.repeat(TIMES, 2)[:, None], "hand": np.repeat(hand, 2, axis=0)}
    (found,) = demonstrations_of(twice, Columns("hand", "t"))
    np.testing.assert_array_equal(found.movement, hand)
    assert found.notes == ("41 of 82 rows repeat the time of the one before: left out",)
    with pytest.raises(ConversionError, match="has 8 rows to each time, which is rounded.* --rate"):
        demonstrations_of({"t": np.floor(TIMES)[:, None], "hand": hand}, Columns("hand", "t"))


def test_angles_in_degrees_are_refused() -> None:
    hand = np.hstack([shown(0)[0][:, :3], np.linspace([180.0, 0.0, 0.0], [180.0, 0.0, 45.0], 41)])
    with pytest.raises(ConversionError, match="angles up to 180, .* are they in degrees"):
        demonstrations_of({"t": TIMES[:, None], "hand": hand}, Columns("hand", "t", orientation="rpy"))


def no_numbers(path: Path) -> None:
    np.save(path, np.array([{"a": 1}], object), allow_pickle=True)


def several_arrays(path: Path) -> None:
    with path.open("wb") as file:
        for _ in range(2):
            np.save(file, np.zeros((12, 3)))


@pytest.mark.parametrize(
    ("name", "content", "movement", "words"),
    [
        ("a.csv", "x,y,z\n1,2,3\n1,b,3\n", "x,y,z", "a.csv: line 3, column 1 .y.: 'b' is no number"),
        ("a.csv", "x,y\n2026-01-01T00:00:00,2\n", "x,y", "looks like a date or a time of day: write seconds"),
        ("a.csv", "x,y\n0,1,0,2\n0,1,0,3\n", "x,y", "are these decimal commas. Then separate the columns by ; or"),
        ("a.csv", "x,y\n1,2\n1\n", "x,y", "line 3 has 1 values, the lines before have 2"),
        ("a.csv", "\0\1\2", "x", "is no text: it begins with"),
        ("a.csv", "1,2\n" * 12, "x,y", "has no column or array 'x'.* by its number"),
        ("a.csv", "", "x", "is empty"),
        ("a.csv", "x,x\n" + "1,2\n" * 12, "x", r"no column or array 'x'; there are .*'x\(1\) .*'x\(2\)"),
        ("a.csv", "x,y\nm,m\n1,2\n", "x,y", "line 2 holds no number below the names; if it holds units"),
        ("a.csv", "made by a recorder\nx,y\n1,2\n", "x,y", "put # before what is above"),
        ("a.csv", "x,y\n" + "1,2\n" * 12, "x,z", "has no column or array 'z'; there are"),
        ("a.csv", "x,y\n" + "1,2\n" * 12, "x", "has 1 columns for a pose"),
        ("a.csv", "x,y\n" + "1,2\n" * 3, "x,y", "has 3 samples from row 0 on, expected at least 10"),
        ("a.csv", "x,y\n" + "1,2\n" * 12, "[0:5]", "has no columns '\\[0:5\\]'; it has 2"),
        ("a.npy", no_numbers, "[0:3]", "holds Python objects .pickle., which are never loaded"),
        ("a.npy", several_arrays, "[0:3]", "goes on for 416 bytes behind its array, as where several"),
        ("a.npy", "no array", "[0:3]", "a.npy: cannot be read"),
        ("a.mat", "no array", "x", "a.mat: cannot be read"),
        ("a.npz", "no array", "x", "a.npz: cannot be read"),
        ("a.xlsx", "", "x", "is of no known kind; expected .csv"),
        ("a.csv.gz", "", "x", "is of no known kind; .*; unpack it first"),
        ("a.csv", lambda path: None, "x", "a.csv: does not exist"),
    ],
)
def test_what_cannot_be_converted_is_said(
    name: str, content: Any, movement: str, words: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    if callable(content):
        content(tmp_path / name)
    else:
        (tmp_path / name).write_text(content)
    found = run(capsys, "--to", tmp_path / "bags", "--rate", "10", "--movement", movement, tmp_path / name)
    with pytest.raises(ValueError, match=words):
        raise ValueError(found["error"])
    assert name in found["error"] and not (tmp_path / "bags").exists()


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["--movement", "x,y", "--name", "my task: x"], "--name 'my task: x' is no name"),
        (["--movement", "x,y", "--frame", "begin=x,y"], "--frame begin: this is where the hand is at the beginning"),
        (["--movement", "x,y", "--frame", "hand=x,y"], "--frame hand: this is the movement, of which --movement tells"),
        (["--movement", "x,y", "--frame", "a=x,y", "--frame", "a=y,x"], "--frame gives 'a' twice"),
        (
            ["--movement", "x,y", "--number", "grip w=x"],
            "--number 'grip w=x' is not TOPIC=COLUMN with a relative topic",
        ),
        (["--movement", "x,y", "--number", "hand/pose=x"], "--number hand/pose: this is the topic of poses"),
        (["--movement", "x,y", "--number", "cup/pose=x", "--frame", "cup=x,y"], "--number cup/pose: this is the topic"),
        (["--movement", "x,y,"], "a comma too many in 'x,y,'"),
        (["--movement", "x,y", "--to", "FILE/bags"], "FILE is a file, so that nothing can be written in it"),
    ],
)
def test_names_that_are_taken_and_places_that_are_none_are_refused_before_anything_is_written(
    arguments: list[str],
    words: str,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.chdir(tmp_path)
    Path("FILE").write_text("")
    Path("a.csv").write_text("x,y\n" + "".join(f"{i},{i}\n" for i in range(20)))
    assert convert.main(["--to", "bags", "--rate", "10", *arguments, "a.csv"]) == 1
    assert words in capsys.readouterr().err and not Path("bags").exists()


def test_a_folder_that_is_no_dataset_is_called_so(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as ended:
        convert.main(["--to", str(tmp_path / "bags"), "--movement", "x,y", str(tmp_path)])
    assert ended.value.code == 2 and f"{tmp_path} is a folder, and none of a LeRobot dataset" in capsys.readouterr().err


def test_what_train_would_refuse_is_no_success(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    for i in range(4):
        np.save(tmp_path / f"{i}.npy", shown(i)[0] * ([1e3] * 3 + [1.0] * 4 if i == 2 else 1.0))
    files = sorted(map(str, tmp_path.glob("*.npy")))
    assert convert.main(["--to", str(tmp_path / "bags"), "--rate", "10", "--movement", "", *files]) == 1
    assert "refused: " in capsys.readouterr().out


def test_doubts_of_what_was_converted_are_said(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    hand, _ = shown(0)
    np.save(tmp_path / "mm.npy", hand[:, :3] * 1e3)
    found = run(capsys, "--to", tmp_path / "bags", "--rate", "10", "--movement", "", tmp_path / "mm.npy")
    assert [doubt["kind"] for doubt in found["doubts"]] == ["units"]
    assert convert.main(["--to", str(tmp_path / "c"), "--rate", "10", "--movement", "", str(tmp_path / "mm.npy")]) == 0
    assert "read back: every bag holds the same numbers" in capsys.readouterr().out
