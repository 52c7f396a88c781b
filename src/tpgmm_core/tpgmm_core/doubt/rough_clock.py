# SPDX-License-Identifier: Apache-2.0
"""When the messages of a recording came, roughly, where the recorder's clock was set while it recorded.

It is enough to find takes in a recording; when each message of a take was true is for `clocks` to say.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tpgmm_core.common.types import Nanoseconds
from tpgmm_core.doubt.stamps import DISORDER_S, breaks

_NEAR_NS = 500_000_000
"""Topics begin and end so far from one another."""


@dataclass(frozen=True, slots=True, eq=False)
class RoughClock:
    """A time that goes on where the recorder's clock stepped back.

    Attributes
    ----------
    begins, ends
        (P,) first and last times of the recorder for the movement, in each part between steps, ns
    shifts
        (P,) what is added to the times of a part, ns: it begins one period after the former one has ended
    """

    begins: Nanoseconds
    ends: Nanoseconds
    shifts: Nanoseconds

    @classmethod
    def of(cls, recorded: Nanoseconds) -> RoughClock:
        """The time of a movement whose messages were recorded at these times (T,), ns, in the order of writing."""
        steps = np.diff(recorded)
        at = np.array([k for k in breaks(recorded).tolist() if steps[k - 1] < 0 or recorded[k - 1] <= 0], np.intp)
        period = int(np.median(steps[steps > 0])) if (steps > 0).any() else 0
        parts = np.split(recorded, at)
        begins, ends = (np.array([how(part) for part in parts], np.int64) for how in (np.min, np.max))
        shifts = np.zeros(len(parts), np.int64)
        for k in range(1, len(parts)):
            shifts[k] = ends[k - 1] + shifts[k - 1] + period - begins[k]
        return cls(begins, ends, shifts)

    def placed(self, recorded: Nanoseconds) -> tuple[NDArray[np.intp], Nanoseconds]:
        """Where messages of any topic lie.

        Parameters
        ----------
        recorded
            (N,) times of the recorder in the order of writing, ns

        Returns
        -------
        tuple[NDArray[np.intp], Nanoseconds]
            number of the part (N,), never decreasing, and the time of this clock (N,), ns
        """
        if len(self.begins) == 1:
            return np.zeros(len(recorded), np.intp), recorded + self.shifts[0]
        first, last = (self.begins - _NEAR_NS).tolist(), (self.ends + _NEAR_NS).tolist()
        parts, part, latest = np.empty(len(recorded), np.intp), 0, int(np.iinfo(np.int64).min)
        for i, at in enumerate(recorded.tolist()):
            later = range(part + 1, len(first))
            stepped = latest - at > 1e9 * DISORDER_S
            if stepped or not first[part] <= at <= last[part]:
                found = next((k for k in later if first[k] <= at <= last[k]), min(part + 1, len(first) - 1))
                part = found if stepped or first[found] <= at <= last[found] else part
                latest = at
            latest = max(latest, at)
            parts[i] = part
        return parts, recorded + self.shifts[parts]
