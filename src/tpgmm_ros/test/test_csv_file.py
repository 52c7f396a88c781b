# SPDX-License-Identifier: Apache-2.0
"""Columns of numbers in text files, as programs write them."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tpgmm_ros.recordings.conversion.conversion_error import ConversionError
from tpgmm_ros.recordings.conversion.csv_file import read_csv


@pytest.mark.parametrize(
    "write",
    [
        pytest.param(lambda rows: "sep=;\n" + rows.replace(",", ";").replace(".", ","), id="separator of Excel"),
        pytest.param(lambda rows: rows.replace("\n", ",\n"), id="separators at the end of all lines"),
        pytest.param(lambda rows: rows.replace("\n", ",,\n").replace(",,\n", "\n", 1), id="and not of the names"),
        pytest.param(lambda rows: rows.replace("\n", ",\n", 1), id="and of the names alone"),
        pytest.param(lambda rows: "% by a recorder\n// of ours\n" + rows, id="comments of other programs"),
        pytest.param(lambda rows: rows.replace("\n", ",9,9\n").replace("9,9", "n,n", 1), id="other names given twice"),
    ],
)
def test_what_programs_add_around_a_table_changes_nothing(write: Any, tmp_path: Path) -> None:
    rows = "t,x,y\n" + "".join(f"{0.1 * i:.1f},{0.5 * i:.2f},-1.5\n" for i in range(12))
    (tmp_path / "plain.csv").write_text(rows)
    (tmp_path / "other.csv").write_text(write(rows))
    plain, other = (read_csv(tmp_path / name) for name in ("plain.csv", "other.csv"))
    assert {"t", "x", "y"} <= other.keys()
    for name in ("t", "x", "y"):
        np.testing.assert_array_equal(other[name], plain[name])


def test_numbers_with_thousands_and_names_in_the_middle_are_called_so(tmp_path: Path) -> None:
    for cell, words in (
        ("1.234,5", "'1.234,5' is no number; write numbers with decimal points, and without"),
        ("x", "'x' .* were files joined"),
    ):
        (tmp_path / "a.csv").write_text(f"x;y\n1;2\n{cell};2\n")
        with pytest.raises(ConversionError, match=f"line 3, column 0 .x.: {words}"):
            read_csv(tmp_path / "a.csv")


@pytest.mark.parametrize(
    "write",
    [
        pytest.param(lambda text: text.replace("e+00", "D+00"), id="exponents of Fortran"),
        pytest.param(lambda text: text.replace("-", "\u2212"), id="a minus sign of typesetters"),
        pytest.param(
            lambda text: re.sub(r"-?\d\.\d+e\+00", lambda x: f'"{x[0].replace(".", ",")}"', text), id="quotes"
        ),
    ],
)
def test_numbers_are_read_as_other_programs_write_them(write: Any, tmp_path: Path) -> None:
    text = "t,x\n" + "".join(f"{0.5 * i:.6e},{-0.25 * i:.6e}\n" for i in range(3))
    (tmp_path / "a.csv").write_text(write(text))
    np.testing.assert_array_equal(read_csv(tmp_path / "a.csv")[""], [[0.0, 0.0], [0.5, -0.25], [1.0, -0.5]])


ROWS = [f"{0.1 * i:.1f},{i},base,{i + 0.5}" for i in range(12)]


@pytest.mark.parametrize(
    ("text", "x"),
    [
        ("t,n,frame_id,x\n" + "\n".join(ROWS), "x"),
        (
            "%time,field.header.seq,field.header.frame_id,field.pose.position.x\n" + "\n".join(ROWS),
            "field.pose.position.x",
        ),
        ("t,n,grasped,x[0]\n" + "\n".join(ROWS).replace("base", "yes"), "x[0]"),
    ],
    ids=["pandas", "rostopic echo -p", "names with numbers in brackets"],
)
def test_texts_in_columns_that_are_not_wanted_do_no_harm(text: str, x: str, tmp_path: Path) -> None:
    (tmp_path / "a.csv").write_text(text)
    found = read_csv(tmp_path / "a.csv", {x.partition("[")[0]})
    np.testing.assert_array_equal(found[x], np.arange(12) + 0.5)
    name = next(name for name in found if name and np.isnan(found[name]).all())
    with pytest.raises(ConversionError, match=rf"line 2, column 2 .{name}.: '(base|yes)' is no number"):
        read_csv(tmp_path / "a.csv", {name})


def test_a_first_line_with_texts_where_the_next_has_them_too_is_no_line_of_names(tmp_path: Path) -> None:
    (tmp_path / "a.csv").write_text("\n".join(ROWS))
    found = read_csv(tmp_path / "a.csv", {""})
    assert set(found) == {""} and found[""].shape == (12, 4) and np.isnan(found[""][:, 2]).all()
    (tmp_path / "a.csv").write_text("\n".join([*ROWS[:5], "0.5,5,base,5.5m", *ROWS[6:]]))
    with pytest.raises(ConversionError, match="line 6, column 3: '5.5m' is no number"):
        read_csv(tmp_path / "a.csv", {""})


def test_numbers_of_columns_are_names_too(tmp_path: Path) -> None:
    """As pandas calls columns that have no names, beside one that has."""
    (tmp_path / "a.csv").write_text("label,0,1\n" + "".join(f"a,{i},{i + 0.5}\n" for i in range(3)))
    found = read_csv(tmp_path / "a.csv", {"0", "1"})
    np.testing.assert_array_equal(found["1"], [0.5, 1.5, 2.5])
