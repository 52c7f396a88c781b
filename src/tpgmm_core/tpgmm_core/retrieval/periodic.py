# SPDX-License-Identifier: Apache-2.0
"""Movements that repeat: a course over the phase, an angle that wraps, and how that angle goes on from rest to rest.

The pace is the demonstrated one, whatever the duration: that is of the whole movement, and says how many cycles there
are, a whole number. The movement begins and ends at rest. At both ends the pace grows and falls along half a cosine
wave, so that velocity and acceleration do not jump; what the cycles leave of the duration is shared between them, a
quarter of the period at least. There a circle is not accelerated along its path by more than towards its centre. Only
where the duration is too short for one cycle and that, the cycle is faster than demonstrated.
"""

from __future__ import annotations

import math

import numpy as np

from tpgmm_core.common.types import Array
from tpgmm_core.learning.cycles import TURN
from tpgmm_core.learning.learned_mixture import LearnedMixture
from tpgmm_core.learning.periodic import PeriodicTPGMM
from tpgmm_core.retrieval.interface import TimeParametrized
from tpgmm_core.retrieval.phase import ClockPhase
from tpgmm_core.retrieval.time_steps import TimeSteps

LEAST_RAMP = 0.25
"""Of the period: how long the pace grows and falls, together twice half of that."""


class PhaseSteps(TimeSteps):
    """A movement as a function of its phase, rad, in place of time: the same after each turn, in mean and covariance.

    Its duration is that of the demonstrations, s, all their cycles together.
    """

    def at(self, times: Array) -> tuple[Array, Array, Array]:
        """The movement at phases (H,), rad."""
        return super().at(np.mod(np.asarray(times, dtype=float), TURN))


class PeriodicPhase(ClockPhase):
    """The phase of a movement that repeats, from rest to rest: see the module.

    Parameters
    ----------
    period
        of a cycle as demonstrated, s
    """

    def __init__(self, period: float) -> None:
        self._period = period
        super().__init__()

    @classmethod
    def of(cls, model: LearnedMixture) -> PeriodicPhase:
        """With the period of a periodic model."""
        assert isinstance(model, PeriodicTPGMM)  # checked by `RetrievalMethod.check`
        return cls(model.period_)

    def bind(self, course: TimeParametrized, duration: float) -> None:
        """Use this movement from now on, for a whole number of cycles."""
        super().bind(course, duration)
        self.cycles = max(math.floor(duration / self._period - LEAST_RAMP + 1e-9), 1)
        least = min(LEAST_RAMP * self._period, 0.5 * duration)
        ramp = min(max(duration - self.cycles * self._period, least), 0.5 * duration)
        self._ramp = ramp / duration  # of the whole, at each end
        self._rate = TURN * self.cycles / (1.0 - self._ramp)  # rad per share of the whole

    def _model_times(self, values: Array) -> Array:
        r = self._ramp
        nearer = np.minimum(values, 1.0 - values)
        ramp = 0.5 * (nearer - r / np.pi * np.sin(np.pi * nearer / r))
        passed = np.where(nearer < r, ramp, nearer - 0.5 * r)
        return np.asarray(self._rate * np.where(values < 0.5, passed, 1.0 - r - passed))
