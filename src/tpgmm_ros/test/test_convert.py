# SPDX-License-Identifier: Apache-2.0
"""`convert`: arrays of other programs become bags that hold the same numbers, and a task file that fits them."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import scipy.io
import scipy.sparse

from conversions_made import COLUMNS, TIMES, csv_of, holds, run, shown
from tpgmm_core.geometry import quaternion
from tpgmm_ros.programs import train
from tpgmm_ros.recordings.bags import find_bags, read_recording
from tpgmm_ros.recordings.conversion.conversion_error import ConversionError
from tpgmm_ros.recordings.conversion.demonstrations import Columns, demonstrations_of
from tpgmm_ros.recordings.conversion.tables import read_tables
from tpgmm_ros.recordings.numeric_fields import read_numbers
from tpgmm_ros.task.task_file import Task


def test_csv_becomes_bags_that_train(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    files = [tmp_path / f"shown_{i}.csv" for i in range(4)]
    for i, file in enumerate(files):
        file.write_text(csv_of(*shown(i)))
    bags = tmp_path / "bags"
    found = run(capsys, "--to", bags, *COLUMNS, "--number", "gripper/width=width", *files)
    assert [Path(bag["bag"]).name for bag in found["bags"]] == ["shown_0", "shown_1", "shown_2", "shown_3"]
    assert found["bags"][0]["messages"] == {"hand/pose": 41, "object/pose": 41, "gripper/width": 41}
    assert found["bags"][0]["rate_hz"] == pytest.approx(10.0) and found["bags"][0]["duration_s"] == 4.0
    assert not found["doubts"] and not found["bad_bags"]
    for i in range(4):
        holds(bags, i, *shown(i))
    np.testing.assert_array_equal(read_numbers(bags / "shown_0", "gripper/width", "data")[1], 0.04 - 0.01 * (TIMES > 2))
    status = train.main(["--task", str(bags / "task.yaml"), "--output", str(tmp_path / "m.tpgmm"), str(bags)])
    said = capsys.readouterr()
    assert status == 0, said.err
    again = run(capsys, "--to", bags, *COLUMNS, *files)
    assert "exists, and is not overwritten" in again["error"]


@pytest.mark.parametrize(
    ("change", "encoding"),
    [
        (lambda text: text.replace(",", ";"), "utf-8"),
        (lambda text: text.replace(",", ";").replace(".", ","), "utf-8"),
        (lambda text: text.replace(",", "\t").replace(".", ","), "utf-8"),
        (lambda text: text.replace("\n", "\r\n"), "utf-8-sig"),
        (lambda text: text, "utf-16"),
        (lambda text: "# hand of robot 1, in \u00b0 and m\n\n" + text + "\n\n", "latin-1"),
        (lambda text: "# " + text, "utf-8"),
        (lambda text: "\n".join(",".join(f'"{c}"' for c in line.split(",")) for line in text.splitlines()), "utf-8"),
        (lambda text: text.replace(",", " "), "utf-8"),
    ],
    ids=["semicolons", "decimal commas", "tabs", "BOM CRLF", "UTF-16", "comments", "names in #", "quotes", "blanks"],
)
def test_csv_of_any_country_is_read_alike(
    change: Callable[[str], str], encoding: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "shown.csv").write_bytes(change(csv_of(*shown(0))).encode(encoding))
    assert run(capsys, "--to", tmp_path / "bags", *COLUMNS, tmp_path / "shown.csv")["passed"]
    holds(tmp_path / "bags", 0, *shown(0))


def test_units_in_brackets_are_part_of_a_name(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    hand = shown(0)[0]
    rows = [f"{t},{x},{y},{z}" for t, (x, y, z) in zip(TIMES.tolist(), hand[:, :3].tolist(), strict=True)]
    (tmp_path / "shown.csv").write_text("\n".join(["t [s],x [m],y [m],z [m]", *rows]))
    columns = ["--time", "t [s]", "--movement", "x [m],y [m],z [m]"]
    assert run(capsys, "--to", tmp_path / "bags", *columns, tmp_path / "shown.csv")["passed"]
    np.testing.assert_array_equal(
        read_recording(find_bags([tmp_path / "bags"])[0], Task.load(tmp_path / "bags" / "task.yaml")).movement[:, :3],
        hand[:, :3],
    )


def test_what_was_not_measured_is_left_out(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    lines = csv_of(*shown(0)).splitlines()
    lines[9] = ",".join([lines[9].split(",")[0], "n/a", "", *lines[9].split(",")[3:]])
    (tmp_path / "shown.csv").write_text("\n".join(lines))
    found = run(capsys, "--to", tmp_path / "bags", *COLUMNS, tmp_path / "shown.csv")
    assert found["bags"][0]["samples"] == 40 and "1 of 41 rows are not finite" in found["bags"][0]["notes"][0]


def test_times_of_two_columns_are_those_of_a_stamp(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """As `ros2 topic echo --csv` writes a PoseStamped: without names, with the frame_id between numbers."""
    hand, start = shown(0)[0], 1_764_000_000_900_000_000
    with (tmp_path / "echo.csv").open("w") as file:
        for t, pose in zip(TIMES, hand.tolist(), strict=True):
            seconds, ns = divmod(start + round(1e9 * t), 10**9)
            file.write(",".join([str(seconds), str(ns), "base", *map(repr, pose)]) + "\n")
    columns = ["--time", "[0:2]", "--movement", "[3:10]"]
    found = run(capsys, "--to", tmp_path / "bags", *columns, tmp_path / "echo.csv")
    assert found["passed"] and found["bags"][0]["samples"] == 41
    holds(tmp_path / "bags", 0, hand, None)


def test_numpy_arrays_and_units(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Of an array with three axes each element of the first is a demonstration; a frame that is given once stays."""
    (hand, place), (other, _) = shown(0), shown(1)
    hands, once = (
        (values * ([1e3] * 3 + [1.0] * 4))[..., [0, 1, 2, 6, 3, 4, 5]] for values in (np.array([hand, other]), place)
    )
    np.savez(tmp_path / "all.npz", hand=hands, t=TIMES * 1e3, place=once)
    options = ["--time", "t", "--time-unit", "ms", "--movement", "hand", "--frame", "object=place", "--unit", "mm"]
    found = run(capsys, "--to", tmp_path / "bags", *options, "--orientation", "wxyz", tmp_path / "all.npz")
    assert len(found["bags"]) == 2 and found["bags"][0]["extent_m"] < 1.5
    holds(tmp_path / "bags", 0, hand, place)
    holds(tmp_path / "bags", 1, other, place)
    np.save(tmp_path / "plain.npy", hand[:, :3])
    found = run(capsys, "--to", tmp_path / "plain", "--rate", "10", "--movement", "[0:3]", tmp_path / "plain.npy")
    assert found["passed"] and "no orientation of the hand is given" in found["bags"][0]["notes"][0]
    holds(tmp_path / "plain", 0, np.hstack([hand[:, :3], np.tile(quaternion.IDENTITY, (41, 1))]), None)


def test_matlab_structs_cells_and_transforms(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """As MATLAB has them: samples along the second axis, an array of structs, and of transforms along the third."""
    hands = [shown(i)[0] for i in range(3)]
    structs = np.empty((1, 3), [("Data", object), ("p", object)])
    for i, hand in enumerate(hands):
        frame = np.array([[(np.eye(2), hand[-1, :2, None])]], [("A", object), ("b", object)])
        structs[0, i] = (np.vstack([TIMES, hand[:, :2].T]), frame)
    cells = np.empty((1, 3), object)
    cells[0, :] = [hand.T for hand in hands]
    transforms = np.tile(np.eye(4)[..., None], (1, 1, 41))
    transforms[:3, :3] = np.moveaxis(quaternion.rotation_matrix(hands[0][:, 3:]), 0, -1)
    transforms[:3, 3] = hands[0][:, :3].T
    scipy.io.savemat(tmp_path / "s.mat", {"s": structs, "cells": cells, "t": TIMES, "Data": np.ones((2, 2, 9))})
    scipy.io.savemat(tmp_path / "T.mat", {"T": transforms, "t": TIMES})
    options = ["--time", "s.Data[0]", "--movement", "s.Data[1:3]", "--frame", "object=s.p.b"]
    assert len(run(capsys, "--to", tmp_path / "a", *options, tmp_path / "s.mat")["bags"]) == 3
    for i, hand in enumerate(hands):
        flat = np.hstack([hand[:, :2], np.zeros((41, 1)), np.tile(quaternion.IDENTITY, (41, 1))])
        holds(tmp_path / "a", i, flat, flat[-1])
    assert run(capsys, "--to", tmp_path / "b", "--time", "t", "--movement", "cells", tmp_path / "s.mat")["passed"]
    holds(tmp_path / "b", 2, hands[2], None)
    assert run(capsys, "--to", tmp_path / "c", "--time", "t", "--movement", "T", tmp_path / "T.mat")["passed"]
    holds(tmp_path / "c", 0, hands[0], None)
    # the same, each flattened column by column, as drivers log it
    np.save(tmp_path / "flat.npy", np.moveaxis(transforms, -1, 0).swapaxes(1, 2).reshape(41, 16))
    assert run(capsys, "--to", tmp_path / "d", "--rate", "10", "--movement", "", tmp_path / "flat.npy")["passed"]
    holds(tmp_path / "d", 0, hands[0], None)


@pytest.mark.parametrize("orientation", ["rpy", "rotation_vector"])
def test_orientations_of_three_numbers(orientation: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    hand, _ = shown(3)
    angles = quaternion.roll_pitch_yaw if orientation == "rpy" else quaternion.log
    turns = np.array([angles(q) for q in hand[:, 3:]])
    np.save(tmp_path / "a.npy", np.hstack([hand[:, :3], turns]))
    options = ["--rate", "10", "--movement", "[0:6]", "--orientation", orientation]
    assert run(capsys, "--to", tmp_path / "bags", *options, tmp_path / "a.npy")["passed"]
    holds(tmp_path / "bags", 0, hand, None)


def test_rows_one_after_the_other_are_split_and_what_was_not_seen_is_not_written(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (hand, place), (other, there) = shown(0), shown(1)
    places = np.vstack([np.tile(place, (41, 1)), np.tile(there, (41, 1))])
    places[:20] = np.nan
    both = np.column_stack([np.repeat([1, 2], 41), np.tile(TIMES, 2), np.vstack([hand, other]), places])
    both[60, 2] = np.nan
    np.savetxt(tmp_path / "both.csv", both, delimiter=";", fmt="%.17g")
    options = ["--time", "[1]", "--movement", "[2:9]", "--frame", "object=[9:16]"]
    found = run(capsys, "--to", tmp_path / "bags", *options, "--split", "[0]", tmp_path / "both.csv")
    assert [bag["samples"] for bag in found["bags"]] == [41, 40]
    assert found["bags"][0]["messages"]["object/pose"] == 21
    assert "1 of 41 rows are not finite: left out" in found["bags"][1]["notes"]
    first = read_recording(tmp_path / "bags" / "both_01", Task.load(tmp_path / "bags" / "task.yaml"))
    assert not first.visible["object"][:20].any() and first.visible["object"][20:].all()
    found = run(capsys, "--to", tmp_path / "again", *options, tmp_path / "both.csv")
    assert "times that do not increase: 4 s in row 40" in found["error"] and "--split" in found["error"]


def test_a_table_joined_from_topics_of_several_rates_keeps_what_stands_between() -> None:
    """As PlotJuggler and pandas write them: a row for each message of each topic, with holes for the others."""
    hand, place = shown(0)
    movement, frame = np.repeat(hand, 2, axis=0), np.tile(place, (82, 1))
    movement[1::2], frame[0::2] = np.nan, np.nan
    table = {"t": 0.05 * np.arange(82.0)[:, None], "hand": movement, "object": frame}
    (found,) = demonstrations_of(table, Columns("hand", "t", frames={"object": "object"}))
    np.testing.assert_array_equal(found.movement, hand)
    assert np.isnan(found.frames["object"][0]).all()
    np.testing.assert_array_equal(found.frames["object"][1:], np.tile(place, (40, 1)))


def test_structured_arrays_are_columns_by_name(tmp_path: Path) -> None:
    hand, _ = shown(0)
    np.save(tmp_path / "a.npy", np.rec.fromarrays(hand.T, names=["x", "y", "z", "qx", "qy", "qz", "qw"]))
    (table,) = read_tables(tmp_path / "a.npy", {"x"})
    np.testing.assert_array_equal(table["qw"].ravel(), hand[:, 6])


def test_rows_that_fill_an_array_up_are_left_out_and_an_end_at_the_origin_is_not(tmp_path: Path) -> None:
    hand = shown(0)[0]
    table = {"": np.vstack([np.column_stack([TIMES, hand]), np.zeros((5, 8))])}
    for columns in (Columns("[1:8]", "[0]"), Columns("[1:4]", rate=10.0)):
        (found,) = demonstrations_of(table, columns)
        np.testing.assert_array_equal(found.movement[:, :3], hand[:, :3])
        assert found.notes[-1 if columns.time else 0] == (
            "the last 5 of 46 rows of the movement are 0, as where shorter ones are filled up"
        )
    home = {"": np.vstack([np.linspace([0.5, 0.2, 0.1], [0.0, 0.0, 0.0], 30), np.zeros((5, 3))])}
    (found,) = demonstrations_of(home, Columns("", rate=10.0))
    assert len(found.movement) == 35 and not any("filled up" in note for note in found.notes)


def test_what_stands_beside_the_wanted_arrays_does_no_harm(tmp_path: Path) -> None:
    hand = shown(0)[0]
    np.savez(tmp_path / "a.npz", hand=hand, notes=np.array([{"by": "us"}], object))
    (table,) = read_tables(tmp_path / "a.npz", {"hand"})
    np.testing.assert_array_equal(table["hand"], hand)
    with pytest.raises(ConversionError, match="notes holds Python objects .pickle., which are never loaded"):
        read_tables(tmp_path / "a.npz", {"notes"})
    stamps = np.datetime64("2026-01-01") + np.round(1e9 * TIMES).astype("timedelta64[ns]")
    np.savez(tmp_path / "b.npz", hand=hand, stamps=stamps, words=np.array(["a", "b"]))
    (table,) = read_tables(tmp_path / "b.npz", {"hand", "stamps"})
    np.testing.assert_allclose(table["stamps"], TIMES, atol=1e-9)
    with pytest.raises(ConversionError, match=r"words holds no real numbers .* but <U1 of the shape \(2,\)"):
        read_tables(tmp_path / "b.npz", {"words"})
    scipy.io.savemat(tmp_path / "c.mat", {"hand": scipy.sparse.csc_matrix(hand)})
    (table,) = read_tables(tmp_path / "c.mat", {"hand"})
    np.testing.assert_array_equal(table["hand"], hand)
    places = np.tile(np.eye(4), (3, 12, 1, 1))
    np.save(tmp_path / "d.npy", places)
    assert [table[""].shape for table in read_tables(tmp_path / "d.npy", {""})] == [(12, 4, 4)] * 3


def test_names_that_yaml_reads_as_something_else_stay_what_they_are(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "shown.csv").write_text(csv_of(*shown(0)))
    names = ["--base-frame", "1", "--name", "no", "--frame", "on=ox,oy,oz"]
    assert run(capsys, "--to", tmp_path / "bags", *COLUMNS, *names, tmp_path / "shown.csv")["passed"]
    task = Task.load(tmp_path / "bags" / "task.yaml")
    assert (task.name, task.base_frame) == ("no", "1") and "on" in task.frames


def test_texts_tell_demonstrations_apart_and_truths_are_numbers(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    lines = csv_of(*shown(0)).splitlines()
    more = [f"{'first' if i < 20 else 'second'},{i % 20 > 10}" for i in range(41)]
    rows = [f"{line},{words}" for line, words in zip(lines[1:], more, strict=True)]
    (tmp_path / "all.csv").write_text("\n".join([f"{lines[0]},episode,closed", *rows]))
    columns = [*COLUMNS, "--split", "episode", "--number", "gripper/closed=closed"]
    found = run(capsys, "--to", tmp_path / "bags", *columns, tmp_path / "all.csv")
    assert found["passed"] and [bag["samples"] for bag in found["bags"]] == [20, 21]
    np.testing.assert_array_equal(
        read_numbers(tmp_path / "bags/all_01", "gripper/closed", "data")[1][9:13], [0, 0, 1, 1]
    )


@pytest.mark.parametrize("shape", [(41, 3, 4), (41, 12)])
def test_transforms_are_read_without_their_last_row(
    shape: tuple[int, ...], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    hand = shown(0)[0]
    matrices = np.concatenate([quaternion.rotation_matrix(hand[:, 3:]), hand[:, :3, None]], axis=2)
    np.savez(tmp_path / "log.npz", t=TIMES, pose=matrices.reshape(shape))
    arguments = ["--time", "t", "--movement", "pose", tmp_path / "log.npz"]
    assert run(capsys, "--to", tmp_path / "bags", *arguments)["passed"]
    recording = read_recording(find_bags([tmp_path / "bags"])[0], Task.load(tmp_path / "bags" / "task.yaml"))
    np.testing.assert_allclose(recording.movement[:, :3], hand[:, :3], atol=1e-12)
    np.testing.assert_allclose(quaternion.angle_between(recording.movement[:, 3:], hand[:, 3:]), 0.0, atol=1e-6)
