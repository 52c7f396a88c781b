# SPDX-License-Identifier: Apache-2.0
"""`TimeScaling`: how fast the scaled time of a system passes, without jumps of that speed."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import ArrayLike

from tpgmm_core.common.types import Array


class TimeScaling:
    """Scaled time passes at a rate that follows a target by a first-order low-pass, solved exactly.

    Parameters
    ----------
    target
        rate that is approached, scaled time per s; may be set at any time
    time_constant
        of the low-pass, s

    Attributes
    ----------
    rate
        present rate, scaled time per s; may be set when a movement begins
    """

    def __init__(self, target: float, time_constant: float) -> None:
        self.rate = self.target = target
        self.time_constant = time_constant

    def advance(self, seconds: float) -> float:
        """Let the seconds pass; returns the scaled time that passes within them."""
        passed = float(self.ahead(seconds))
        self.rate = self.target + (self.rate - self.target) * math.exp(-seconds / self.time_constant)
        return passed

    def ahead(self, seconds: ArrayLike) -> Array:
        """Scaled time that will have passed after seconds (...,), if the target stays."""
        seconds = np.asarray(seconds, dtype=float)
        settled = -np.expm1(-seconds / self.time_constant) * self.time_constant
        return np.asarray(self.target * seconds + (self.rate - self.target) * settled)
