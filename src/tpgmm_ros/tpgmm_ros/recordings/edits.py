# SPDX-License-Identifier: Apache-2.0
"""Edits of a bag, in a small file beside it: what of it counts as the demonstration. The bag itself is left as it is.

# demo_03.edits.yaml, beside the bag demo_03
from: 0.8          # s from the first sample of the movement; what is before is left out
to: 7.5            # s; what is after is left out
leave_out: true    # the whole bag is not read where its folder is
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from tpgmm_core.common.safe_yaml import YamlError
from tpgmm_core.common.yaml_sections import Section
from tpgmm_core.common.yaml_values import a_number
from tpgmm_ros.recordings.storage.bag_error import BagError

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
    """

    begin_s: float = 0.0
    end_s: float = math.inf
    leave_out: bool = False

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
            section.refuse_others("from", "to", "leave_out")
            begin = section.required("from", a_number(0.0)) if "from" in section.values else 0.0
            end = section.required("to", a_number(0.0)) if "to" in section.values else math.inf
            leave_out = section.required("leave_out", _truth) if "leave_out" in section.values else False
        except YamlError as error:
            raise BagError(bag, f"its edits cannot be read: {error}") from None
        if end <= begin:
            raise BagError(bag, f"its edits go from {begin:g} s to {end:g} s: name an end after the beginning")
        return cls(begin, end, leave_out)


def _truth(value: Any) -> bool:
    if not isinstance(value, bool):
        raise ValueError("true or false")
    return value
