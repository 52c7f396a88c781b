# SPDX-License-Identifier: Apache-2.0
"""The last steps before a torque leaves the controller, each one short, in the order in which they are applied.

`all_finite`, then `clamp` to the effort limits, then `limit_rate`. The rate comes last and keeps the limits,
since both its ends lie within them.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


def all_finite(*arrays: Array) -> bool:
    """Whether no array holds NaN or infinity."""
    return all(np.isfinite(array).all() for array in arrays)


def clamp(tau: Array, limits: Array) -> Array:
    """Torques (n,) within +-limits (n,), N m."""
    return np.minimum(np.maximum(tau, -limits), limits)


def fit(wanted: Array, given: Array, limits: Array) -> float:
    """Largest share s in 0..1 with |given + s wanted| <= limits, all torques (n,).

    Shortening a vector of torques keeps the direction in which the hand accelerates; clamping single joints
    turns it, and a hand that is pushed aside by its own controller may swing for ever. Where `given` alone is
    too much, single joints do not count.
    """
    room = np.where(wanted > 0.0, limits - given, limits + given)
    needed = np.abs(wanted)
    tight = (needed > room) & (room > 0.0)
    return float((room[tight] / needed[tight]).min()) if tight.any() else 1.0


def limit_rate(tau: Array, previous: Array, largest_rate: Array, dt: float) -> Array:
    """Torques (n,) that differ from the previous ones by at most largest_rate (n,) in N m/s times dt in s."""
    largest_change = largest_rate * dt
    return np.minimum(np.maximum(tau, previous - largest_change), previous + largest_change)
