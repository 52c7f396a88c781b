# SPDX-License-Identifier: Apache-2.0
"""A tick is answered once, when all inputs have answered it, also with what is older than the tick."""

from __future__ import annotations

import itertools

import pytest

from tpgmm_ros.messages.lockstep import LateBarrier


class Node:
    """What was answered: (tick, items); and what was said once more."""

    def __init__(self) -> None:
        self.answers: list[tuple[int, dict[str, str | None]]] = []
        self.again: list[int] = []
        self.barrier = LateBarrier[str](
            ("a", "b"), lambda tick, items: self.answers.append((tick, dict(items))), self.again.append
        )


def test_a_tick_waits_for_all_inputs_whatever_comes_first() -> None:
    calls = {
        "tick": lambda node: node.barrier.tick(100),
        "a": lambda node: node.barrier.came("a", 70, "seen"),
        "b": lambda node: node.barrier.came("b", 100, None),
    }
    for order in itertools.permutations(calls):
        node = Node()
        for name in order[:-1]:
            calls[name](node)
            assert not node.answers, order
        calls[order[-1]](node)
        assert node.answers == [(100, {"a": "seen", "b": None})], order


@pytest.mark.parametrize("repeats", [0, 1, 3])
def test_what_comes_again_answers_no_other_tick(repeats: int) -> None:
    node = Node()
    node.barrier.tick(100)
    for _ in range(1 + repeats):
        node.barrier.came("a", 70, "old")
        node.barrier.came("b", 100, None)
    assert node.answers == [(100, {"a": "old", "b": None})]
    node.barrier.tick(110)
    for _ in range(1 + repeats):  # what is still on its way from the tick before
        node.barrier.came("a", 70, "old")
        node.barrier.came("b", 100, None)
    assert len(node.answers) == 1
    node.barrier.came("a", 110, None)
    node.barrier.came("b", 80, "old too")
    assert node.answers[1:] == [(110, {"a": None, "b": "old too"})]


def test_a_tick_that_comes_again_is_answered_as_before_and_takes_nothing_in() -> None:
    node = Node()
    node.barrier.tick(100)
    node.barrier.came("a", 100, "now")
    node.barrier.came("b", 100, "now")
    node.barrier.tick(100)
    assert len(node.answers) == 1 and node.again == [100]


def test_an_observation_with_the_stamp_of_the_tick_before_is_not_taken_for_its_silence() -> None:
    node = Node()
    node.barrier.tick(100)
    node.barrier.came("a", 100, None)
    node.barrier.came("b", 100, None)
    node.barrier.tick(110)
    node.barrier.came("a", 100, "one tick late")
    node.barrier.came("b", 110, None)
    assert node.answers[-1] == (110, {"a": "one tick late", "b": None})


def test_when_time_begins_again_nothing_from_before_counts() -> None:
    node = Node()
    node.barrier.tick(500)
    node.barrier.came("a", 470, "before")
    node.barrier.tick(100)
    node.barrier.came("b", 100, None)
    assert not node.answers
    node.barrier.came("a", 100, "after")
    assert node.answers == [(100, {"a": "after", "b": None})]


def test_the_silence_of_another_tick_answers_nothing() -> None:
    node = Node()
    node.barrier.tick(100)
    node.barrier.came("a", 90, None)
    node.barrier.came("b", 100, None)
    assert not node.answers
