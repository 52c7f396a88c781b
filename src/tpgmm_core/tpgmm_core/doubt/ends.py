# SPDX-License-Identifier: Apache-2.0
"""Movements whose beginning or end is missing, since their poses there cannot be used."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from tpgmm_core.common.types import Nanoseconds
from tpgmm_core.doubt.doubts import Doubt

LOST_S = 0.5
"""A movement that has lost more at one of its ends is not whole."""


def doubts_of_ends(topic: str, recorded: Nanoseconds, good: NDArray[np.bool_]) -> tuple[Doubt, ...]:
    """What begins late or ends early, since its first or last poses cannot be used.

    Parameters
    ----------
    topic
        of the movement
    recorded
        (T,) times of the recorder, ns
    good
        (T,) which poses can be used: one or more

    Returns
    -------
    tuple[Doubt, ...]
        two at most
    """
    kept = np.flatnonzero(good)
    found = []
    for lost, where in ((recorded[kept[0]] - recorded[0], "first"), (recorded[-1] - recorded[kept[-1]], "last")):
        if (seconds := 1e-9 * float(lost)) > LOST_S:
            text = (
                f"the {where} {seconds:.2f} s of {topic} cannot be used, so that the movement is not whole: correct "
                "what publishes it and record again, or leave the bag out"
            )
            found.append(Doubt("gap", (), text))
    return tuple(found)
