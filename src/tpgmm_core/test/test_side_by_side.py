# SPDX-License-Identifier: Apache-2.0
"""Work in several processes: the same as in one, with items that are taken only when they can be worked on."""

from __future__ import annotations

import os
from collections.abc import Iterator

import pytest

from tpgmm_core.common.side_by_side import side_by_side


def squared(number: int) -> tuple[int, int]:
    return number**2, os.getpid()


@pytest.mark.parametrize("in_order", [True, False])
def test_several_processes_find_what_one_does(in_order: bool) -> None:
    alone = list(side_by_side(squared, range(20), 1, in_order=in_order))
    found = list(side_by_side(squared, range(20), 2, in_order=in_order))
    assert {process for _, process in alone} == {os.getpid()} and os.getpid() not in {process for _, process in found}
    squares = [square for square, _ in found]
    assert (squares if in_order else sorted(squares)) == [n**2 for n in range(20)] == [square for square, _ in alone]


def test_no_more_items_are_taken_than_are_worked_on_and_an_early_end_leaves_the_others() -> None:
    taken: list[int] = []

    def items() -> Iterator[int]:
        for number in range(1_000_000):
            taken.append(number)
            yield number

    def refusing(number: int) -> int:
        if number == 5:
            raise ValueError("five")
        return number

    with pytest.raises(ValueError, match="five"):
        list(side_by_side(refusing, items(), 2))
    assert len(taken) < 100
    found = side_by_side(squared, items(), 2)
    next(found)
    found.close()  # type: ignore[attr-defined]
    assert len(taken) < 1000
