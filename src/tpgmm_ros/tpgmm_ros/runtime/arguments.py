# SPDX-License-Identifier: Apache-2.0
"""Numbers among the arguments of programs: what is none, or out of range, is refused in words."""

from __future__ import annotations

import argparse
import math
from collections.abc import Callable

from tpgmm_core.common.text import shown

SEED = 2**32 - 1
"""The largest seed of random numbers."""
DOMAIN = 232
"""The largest ROS domain."""


def whole_number(least: int, most: int | None = None) -> Callable[[str], int]:
    """A reader of whole numbers from `least` on, or to `most`; it raises ArgumentTypeError for anything else."""
    expected = f"of at least {least}" if most is None else f"from {least} to {most}"

    def read(text: str) -> int:
        try:
            number = int(text)
        except ValueError:
            number = least - 1
        if number < least or (most is not None and number > most):
            raise argparse.ArgumentTypeError(f"{shown(text)} is not a whole number {expected}")
        return number

    return read


def number_above_0(what: str) -> Callable[[str], float]:
    """A reader of finite numbers above 0; `what` they are, in words, stands in the ArgumentTypeError for others."""

    def read(text: str) -> float:
        try:
            number = float(text)
        except ValueError:
            number = math.nan
        if not 0.0 < number < math.inf:
            raise argparse.ArgumentTypeError(f"{shown(text)} is not {what}, a number above 0")
        return number

    return read
