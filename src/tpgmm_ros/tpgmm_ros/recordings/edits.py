# SPDX-License-Identifier: Apache-2.0
"""Edits of a bag, in a small file beside it: what of it counts as demonstrations. The bag itself is left as it is.

# demo_03.edits.yaml, beside the bag demo_03 or demo_03.mcap
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
import os
import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NoReturn

from tpgmm_core.common.safe_yaml import YamlError
from tpgmm_core.common.text import listed
from tpgmm_core.common.yaml_sections import Section
from tpgmm_core.common.yaml_values import a_number, an_integer, numbers
from tpgmm_core.observation.takes import Take
from tpgmm_ros.recordings.storage.bag_error import BagError
from tpgmm_ros.recordings.storage.bag_reader import itself
from tpgmm_ros.recordings.storage.formats import without_suffix
from tpgmm_ros.task.takes_section import TakesRule, read_takes

SUFFIX = ".edits.yaml"
_LIKE_EDITS = re.compile(r"edits?\.ya?ml$", re.IGNORECASE)


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
            the file says something else, or there are several.
        """
        files = edits_files(bag)
        if not files:
            return cls()
        if len(files) > 1:
            raise BagError(bag, f"has edits in {len(files)} files, {listed(map(str, files))}: keep one of them")
        file = files[0]
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


def edits_files(bag: Path) -> list[Path]:
    """Files beside a bag that say what of it counts, by whatever path it is given: one, or none."""
    return list({file.resolve(): file for file in _places(bag) if file.exists()}.values())


def edits_of_none(folder: Path, bags: Iterable[Path]) -> list[str]:
    """Files in a folder of bags that are called as edits are, and are those of none of its bags.

    Parameters
    ----------
    folder
        with bags inside
    bags
        all that are in it

    Returns
    -------
    list[str]
        their paths from the folder
    """
    bags = list(bags)
    known = {place.name for bag in bags for place in _places(bag)}
    folders = (folder, *(bag for bag in bags if bag.is_dir()))
    files = [file for each in folders for file in each.iterdir() if _LIKE_EDITS.search(file.name)]
    lost = (file for file in files if file.parent != folder or file.name not in known)
    return sorted(str(file.relative_to(folder)) for file in lost if not file.name.startswith("."))


def _places(bag: Path) -> list[Path]:
    given, real = Path(os.path.abspath(bag)), itself(bag)
    bags = dict.fromkeys((real if real.is_dir() and not given.is_dir() else given, real))
    names = [(one, name) for one in bags for name in dict.fromkeys((one.name, without_suffix(one.name)))]
    return [one.with_name(f"{name}{SUFFIX}") for one, name in names]


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
