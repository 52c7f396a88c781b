# SPDX-License-Identifier: Apache-2.0
"""Text of others in our own sentences: short, on one line, and nothing that a terminal obeys."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tpgmm_core.common.text import LINE_LIMIT, NAME_LIMIT, counted, listed, one_line, shown


@given(st.text(st.characters()) | st.binary() | st.lists(st.text(st.characters())))
def test_whatever_comes_is_printable_short_and_on_one_line(value: Any) -> None:
    for text, limit in ((shown(value), NAME_LIMIT), (one_line(value), LINE_LIMIT), (one_line(value, 20), 20)):
        assert text.isprintable() and len(text) <= limit + 1
        text.encode("utf-8")  # a lone surrogate would end the one who prints it


def test_a_megabyte_is_shown_by_its_beginning() -> None:
    assert shown("map" * 10**6) == "'" + ("map" * 20)[:59] + "…"
    assert one_line("x\n" * 10**6, 7) == "x x x x…"
    assert len(listed(str(i) * 1000 for i in range(10**5))) < 1000
    assert listed(map(str, range(100)), 3) == "0, 1, 2, … and 97 more"


def test_names_are_listed_plainly_and_others_in_quotes() -> None:
    assert listed(["left_s0", "/object/pose", "my-robot.urdf"]) == "left_s0, /object/pose, my-robot.urdf"
    assert listed(["a, b", "c\n", 1, ""]) == "'a, b', 'c\\n', 1, ''"
    assert listed([]) == "nothing"


@pytest.mark.parametrize(
    ("value", "text"),
    [
        ("base\n[ERROR] all is lost", "'base\\n[ERROR] all is lost'"),
        ("\x1b[2J", "'\\x1b[2J'"),
        ([10**10000], "list too large to show"),
        (np.zeros(3), "array([0., 0., 0.])"),
    ],
)
def test_line_breaks_and_codes_are_written_out(value: Any, text: str) -> None:
    assert shown(value) == text


def test_a_count_of_one_has_no_plural() -> None:
    assert [counted(count, "bag") for count in (0, 1, 2, "?")] == ["0 bags", "1 bag", "2 bags", "? bags"]


def test_a_message_of_several_lines_becomes_one() -> None:
    assert one_line("while parsing\n  in line 1\n\ta\x07\u202e") == "while parsing in line 1 a\\x07\\u202e"


def test_an_error_of_the_system_is_its_file_and_its_reason() -> None:
    try:
        open("/proc/nothing/here")
    except OSError as error:
        assert one_line(error) == "/proc/nothing/here: No such file or directory"
    assert one_line(OSError("the disk is full")) == "the disk is full"
