# SPDX-License-Identifier: Apache-2.0
"""The critically damped spring, solved exactly, for times of any length."""

from __future__ import annotations

import math

from tpgmm_core.common.types import Array


def critically_damped(error: Array, velocity: Array, rate: float, time: float) -> tuple[Array, Array]:
    """Error and velocity (n,) after a time, of error'' = -rate² error - 2 rate error'. Both die out as exp(-rate t)."""
    slope = velocity + rate * error
    left = math.exp(-rate * time)
    return left * (error + time * slope), left * (velocity - rate * time * slope)
