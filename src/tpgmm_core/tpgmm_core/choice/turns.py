# SPDX-License-Identifier: Apache-2.0
"""Demonstrations that repeat, as one turn each: so frames can be screened over the phase, as others are over time."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from tpgmm_core.common.types import Array
from tpgmm_core.geometry.manifold import Manifold
from tpgmm_core.learning.cycles import STEPS, TURN
from tpgmm_core.learning.periodic import phases_shown
from tpgmm_core.model.demonstration import Demonstration
from tpgmm_core.model.samples import Samples


def phases_of(demonstrations: Sequence[Demonstration], space: Manifold) -> list[Array] | None:
    """The phase at each sample, where every demonstration repeats itself.

    Parameters
    ----------
    demonstrations
        over [time, data], with the same frames
    space
        of their data

    Returns
    -------
    list[Array] | None
        of each demonstration (T,), rad, increasing, the same phase at the same place of the movement; None where a
        demonstration does not repeat
    """
    try:
        return phases_shown(Samples.from_demonstrations(demonstrations, space))
    except ValueError:
        return None


def one_turn(shown: Demonstration, phases: Array) -> Demonstration:
    """A demonstration from phase 0 to 2 pi, by the samples that are nearest to evenly spaced phases.

    Parameters
    ----------
    shown
        over [time, data]
    phases
        (T,), rad

    Returns
    -------
    Demonstration
        of STEPS samples, whose time is the share of the turn
    """
    shares = np.arange(STEPS) / STEPS
    apart = np.mod(phases[:, None] - TURN * shares + np.pi, TURN) - np.pi
    at = np.abs(apart).argmin(axis=0)
    data = np.column_stack([shares, shown.data[at, 1:]])
    visible = {name: shown.is_visible(name)[at] for name in shown.frames}
    return Demonstration(shares, data, {name: frame.at(at) for name, frame in shown.frames.items()}, visible)
