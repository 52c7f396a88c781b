# SPDX-License-Identifier: Apache-2.0
"""Edits of a bag, in a small file beside it: what of it counts as demonstrations. The bag itself is left as it is.

# demo_03.edits.yaml, beside the bag demo_03
from: 0.8          # s from the first sample of the movement; what is before is left out
to: 7.5            # s; what is after is left out
leave_out: true    # the whole bag is not read where its folder is; [2, 5]: takes that are not read
takes:             # it holds several demonstrations: from when to when each lasts, s from the first sample
- [0.8, 7.5]
- [9.0, 15.2]
takes: {still: 1}  # or how it is cut, as in the task file (see `takes_section`)
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NoReturn

from tpgmm_core.common.safe_yaml import YamlError
from tpgmm_core.common.yaml_sections import Section
from tpgmm_core.common.yaml_values import a_number, an_integer, numbers
from tpgmm_core.observation.takes import Take
from tpgmm_ros.recordings.storage.bag_error import BagError
from tpgmm_ros.task.takes_section import TakesRule, read_takes

SUFFIX = ".edits.yaml"


@dataclass(frozen=True, slots=True)
class Edits:
    """What of a bag counts.

    Attributes
    ----------
    begin_s, end_s
        times from the first sample of the movement, s
    leave_out
        nothing of it
    without
        numbers of the takes that do not count, from 1
    takes
        first and last times of its takes, s from the first sample, or how they are found; None: as the task says
    """

    begin_s: float = 0.0
    end_s: float = math.inf
    leave_out: bool = False
    without: tuple[int, ...] = ()
    takes: tuple[Take, ...] | TakesRule | None = None

    @classmethod
    def of(cls, bag: Path) -> Edits:
        """Those of a bag; none where there is no file beside it.

        Parameters
        ----------
        bag
            its path

        Returns
        -------
        Edits
            what the file says

        Raises
        ------
        BagError
            the file says something else.
        """
        file = bag.with_name(f"{bag.name}{SUFFIX}")
        if not file.exists():
            return cls()
        try:
            section = Section.load(file, "the edits of a bag")
            section.refuse_others("from", "to", "leave_out", "takes")
            begin = section.required("from", a_number(0.0)) if "from" in section.values else 0.0
            end = section.required("to", a_number(0.0)) if "to" in section.values else math.inf
            left_out = section.required("leave_out", _left_out) if "leave_out" in section.values else False
            takes: tuple[Take, ...] | TakesRule | None = None
            if isinstance(section.values.get("takes"), Mapping):
                takes = read_takes(section.section("takes"))
            elif "takes" in section.values:
                takes = section.required("takes", _times)
        except YamlError as error:
            raise BagError(bag, f"its edits cannot be read: {error}") from None
        if end <= begin:
            raise BagError(bag, f"its edits go from {begin:g} s to {end:g} s: name an end after the beginning")
        without = () if isinstance(left_out, bool) else left_out
        return cls(begin, end, left_out is True, without, takes)


def _left_out(value: Any) -> bool | tuple[int, ...]:
    if isinstance(value, bool):
        return value
    try:
        return tuple(map(an_integer(1), value)) if isinstance(value, list) and value else _refused()
    except ValueError:
        _refused()


def _refused() -> NoReturn:
    raise ValueError("true or false, or a list of the numbers of takes, from 1")


def _times(value: Any) -> tuple[Take, ...]:
    expected = "a list of takes, each [from, to] in s, one after the other; or how they are found, such as {still: 1.0}"
    if not isinstance(value, list) or not value:
        raise ValueError(expected)
    try:
        found = tuple(numbers(2)(take) for take in value)
    except ValueError:
        raise ValueError(expected) from None
    times = [time for take in found for time in take]
    if times[0] < 0.0 or any(end <= begin for begin, end in found) or sorted(times) != times:
        raise ValueError(expected)
    return tuple((begin, end) for begin, end in found)
