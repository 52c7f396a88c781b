# SPDX-License-Identifier: Apache-2.0
"""States in a situation, and a reference that goes smoothly from one to the next; time is counted in samples."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from tpgmm_core.common.types import Array
from tpgmm_core.geometry.manifold import Manifold
from tpgmm_core.geometry.mixture import GaussianMixture
from tpgmm_core.geometry.region import squared_radius
from tpgmm_core.retrieval.state_filter import NominalSchedule
from tpgmm_core.retrieval.tracking_plan import Planner, TrackingPlan

USUAL = 0.95
"""Share of a state's positions that fit it fully. Within it, only durations distinguish neighbouring states."""
PLAN_STEPS = 24
"""Steps of a plan, four per time constant: later ones would change it by less than a hundredth."""


@dataclass(frozen=True, slots=True, eq=False)
class AdaptedStates:
    """The K states in a situation, as points of the data's manifold, without time (and derivatives).

    Parameters
    ----------
    manifold
        of the data
    means
        (K, D), in the middle of a state
    rates
        (K, n), per sample
    covariances, precisions
        (K, n, n), given the time within the state
    seen
        (K, n, n), precisions of where the robot is seen at any time in a state, errors of tracking included
    tolerance
        (n,), standard deviations of the robot about its reference
    mean_precisions
        (n,), of a state of average precision: one number for all positions and one for all turns
    """

    manifold: Manifold
    means: Array
    rates: Array
    covariances: Array
    precisions: Array
    seen: Array
    tolerance: Array
    mean_precisions: Array

    @classmethod
    def of(cls, mixture: GaussianMixture, manifold: Manifold, sample_time: float, tolerance: Array) -> AdaptedStates:
        """Take the states from a mixture over [time, data, ...].

        Parameters
        ----------
        mixture
            the model in the situation
        manifold
            of the data
        sample_time
            time between samples of the demonstrations, s
        tolerance
            see the class

        Returns
        -------
        AdaptedStates
            the states
        """
        means, n = mixture.means[:, 1 : 1 + manifold.dim], manifold.tangent_dim
        S = mixture.covariances[:, : 1 + n, : 1 + n]
        gains = S[:, 0, 1:] / S[:, :1, 0]
        covariances = S[:, 1:, 1:] - gains[:, :, None] * S[:, :1, 1:]
        seen = np.linalg.inv(S[:, 1:, 1:] + np.diag(tolerance**2))
        variances, mean_precisions = np.diagonal(covariances, axis1=1, axis2=2), np.empty(n)
        for block in (manifold.flat_tangent, *(np.r_[s.tangent] for s in manifold.spheres)):
            if len(block):
                mean_precisions[block] = np.exp(-np.mean(np.log(variances[:, block].mean(axis=1))))
        precisions = np.linalg.inv(covariances)
        return cls(manifold, means, gains * sample_time, covariances, precisions, seen, tolerance, mean_precisions)

    def ending(self, end: Array, last: float) -> AdaptedStates:
        """States of which the last begins where it did, and ends elsewhere.

        Parameters
        ----------
        end
            (D,), where
        last
            age of its last sample

        Returns
        -------
        AdaptedStates
            the same but for the mean and rate of the last one
        """
        means, rates = self.means.copy(), self.rates.copy()
        missing = self.manifold.log(self.manifold.exp(means[-1], 0.5 * last * rates[-1]), end)
        means[-1] = self.manifold.exp(means[-1], 0.5 * missing)
        rates[-1] += missing / max(last, 1.0)
        return replace(self, means=means, rates=rates)

    def fit(self, state: Array, given: Array) -> Array:
        """How well a position fits each state.

        1 within the usual distance from a state, and beyond it falling as its Gaussian does; the same for the distance
        from the reference, for all states: a robot that follows its reference is not held, wherever the reference is.
        On the way between two states it may be where neither expects it, especially where frames are far from where
        they were demonstrated.

        Parameters
        ----------
        state
            (D,), where the robot is
        given
            (D,), the reference that the robot was given

        Returns
        -------
        Array
            0 to 1, shape (K,)
        """
        d = self.manifold.log(self.means, state[None])
        aside = self.manifold.log(given, state) / self.tolerance
        squares = np.minimum(np.einsum("ki,kij,kj->k", d, self.seen, d), aside @ aside)
        return np.exp(-0.5 * np.maximum(squares - squared_radius(USUAL, self.manifold.tangent_dim), 0.0))


class PathFollower:
    """The reference as it advances: a place in the sequence of states, and a plan that is renewed as it is used up.

    Time is counted in samples. A plan begins every so many whole samples, whatever happens in between: where a state
    takes over from another is then met at the same steps of a plan, and what is planned does not depend on how often
    the situation has changed. Planned anew at once, each change moved the path in time by about half a sample, however
    small it was.
    """

    place: tuple[int, float]
    states: AdaptedStates
    plan: TrackingPlan

    def __init__(self, schedule: NominalSchedule, manifold: Manifold, smoothing: float) -> None:
        self.schedule = schedule
        self._time_constant = smoothing * float(np.mean(schedule.nominal))
        self._stride = max(1, round(self._time_constant / 4.0))
        self._planner = Planner(manifold, float(self._stride), PLAN_STEPS)

    def begin(self, place: tuple[int, float], states: AdaptedStates, state: Array | None) -> None:
        """Begin at rest, at a position (D,), or at the position that is expected at the place."""
        self.place, self.states = place, states
        self.fraction = 0.0
        position = self._targets()[0][0] if state is None else np.array(state)
        self._replan(position, np.zeros(states.manifold.tangent_dim))
        self.covariance = self._covariances[self.place[0]]

    def change(self, states: AdaptedStates) -> None:
        """Change to the states of another situation, from the next plan on: position and velocity stay."""
        self.states = states
        self._move_covariances(self.at())

    def advance(self, samples: float) -> bool:
        """Advance, at most to the next whole sample; returns whether that was reached."""
        self._planned += samples
        self.fraction += samples
        share = 1.0 - math.exp(-samples / self._time_constant)
        self.covariance = self.covariance + share * (self._covariances[self.place[0]] - self.covariance)
        if self.fraction < 1.0 - 1e-9:
            return False
        self.fraction = 0.0
        return True

    def arrive(self, place: tuple[int, float]) -> None:
        """Set the place, at a whole sample."""
        self.place = place
        if self._planned > self._stride - 1e-6:
            self._replan(*self.plan.at(self._planned))

    def at(self, samples: float = 0.0) -> Array:
        """Position (D,), so many samples ahead."""
        return self.plan.point(self._planned + samples)

    def _replan(self, position: Array, velocity: Array) -> None:
        states = self.states
        targets, which = self._targets()
        precisions = self._move_covariances(position)
        # of accelerations per sample²: a state of average precision is met within the time constant
        cost = np.diag(self._time_constant**4 * states.mean_precisions)
        self.plan = self._planner.plan(position, velocity, targets, precisions[which], cost)
        self._planned = 0.0

    def _move_covariances(self, position: Array) -> Array:
        """The states' covariances and precisions, moved to a position (D,); returns the latter (K, n, n)."""
        states = self.states
        self._covariances, precisions = states.covariances, states.precisions
        if not states.manifold.is_euclidean:
            T = states.manifold.transport(states.means, position)
            self._covariances, precisions = (T @ S @ np.swapaxes(T, 1, 2) for S in (self._covariances, precisions))
        return precisions

    def _targets(self) -> tuple[Array, list[int]]:
        """Positions (PLAN_STEPS + 1, D) that the states expect, from the place on, and which states."""
        schedule, states = self.schedule, self.states
        state, age = self.place
        if age >= schedule.longest[state]:
            ahead = [schedule.onwards(state, age, 0.0)] * (PLAN_STEPS + 1)
        else:
            ahead = [schedule.onwards(state, age, float(i * self._stride)) for i in range(PLAN_STEPS + 1)]
        which = [state for state, _ in ahead]
        lasts = schedule.nominal[which] - 1.0  # ages of a state's samples are 0 to this
        offsets = np.minimum([age for _, age in ahead], lasts) - 0.5 * lasts
        return states.manifold.exp(states.means[which], offsets[:, None] * states.rates[which]), which
