# SPDX-License-Identifier: Apache-2.0
"""`Durations`: how long the states of a hidden semi-Markov model last.

The log-normal distribution on the integers 1 .. L: p(d) ∝ exp(eta_1 log d + eta_2 (log d)²), eta_2 <= 0. It is
positive, and its spread is in proportion to its mean, as in movements of people. It may also be narrower than a
Poisson distribution, as the durations of a practised movement are; a negative binomial may not. Normalised on its
finite support it is an exponential family, so that its likelihood is concave and EM finds the exact maximum.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Self

import numpy as np
import scipy
from numpy.typing import ArrayLike

from tpgmm_core.common.types import Array

PRIOR_SEGMENTS = 0.1
"""Weight of the prior, in segments: a single demonstration says nothing about the spread of a duration."""
PRIOR_SPREAD = 0.5
"""Standard deviation of log d of the prior: durations that differ by a factor of about 1.6."""
MAX_STEPS = 100  # of Newton's method, which takes about 10


@dataclass(frozen=True, slots=True, eq=False)
class Durations:
    """Distributions of the durations of K states, in samples.

    Parameters
    ----------
    natural
        shape (K, 2), eta
    max_duration
        L, the longest duration
    prior_moments
        shape (K, 2), moments of log d and (log d)² of the PRIOR_SEGMENTS segments that count as seen before all others
        (the conjugate prior)
    """

    natural: Array
    max_duration: int
    prior_moments: Array

    @classmethod
    def around(cls, means: ArrayLike, max_duration: int) -> Self:
        """The prior itself: log d about the logarithms of `means` (K,), in samples, with the spread PRIOR_SPREAD."""
        centre = np.log(np.clip(np.asarray(means, dtype=float), 1.0, max_duration))
        precision = 1.0 / PRIOR_SPREAD**2
        natural = np.column_stack([precision * centre, np.full_like(centre, -0.5 * precision)])
        features = _features(max_duration)
        return cls(natural, max_duration, np.exp(_log_probabilities(natural, features)) @ features.T)

    @property
    def log_probabilities(self) -> Array:
        """Logarithms log p(d), shape (K, L), for d = 1 .. L."""
        return _log_probabilities(self.natural, _features(self.max_duration))

    @property
    def means(self) -> Array:
        """Expected durations (K,), samples."""
        return np.asarray(np.exp(self.log_probabilities) @ np.arange(1.0, self.max_duration + 1.0))

    @property
    def standard_deviations(self) -> Array:
        """Standard deviations (K,) of the durations, samples."""
        d = np.arange(1.0, self.max_duration + 1.0)
        return np.sqrt(np.sum(np.exp(self.log_probabilities) * (d - self.means[:, None]) ** 2, axis=1))

    @property
    def log_survival(self) -> Array:
        """Logarithms log p(duration >= d), shape (K, L), for d = 1 .. L."""
        return np.logaddexp.accumulate(self.log_probabilities[:, ::-1], axis=1)[:, ::-1]

    @property
    def hazards(self) -> Array:
        """p(duration = d | duration >= d), shape (K, L), for d = 1 .. L: how probable it is that a state ends now."""
        return np.exp(np.minimum(self.log_probabilities - self.log_survival, 0.0))

    @property
    def log_prior(self) -> float:
        """Logarithm of the prior's density at these parameters, without its constant: the penalty of EM."""
        features = _features(self.max_duration)
        log_normaliser = scipy.special.logsumexp(self.natural @ features, axis=1)
        return float(PRIOR_SEGMENTS * np.sum(np.sum(self.natural * self.prior_moments, axis=1) - log_normaliser))

    def maximised(self, counts: Array) -> Durations:
        """M-step: the most probable parameters, given the segments.

        At the maximum the moments of log d and (log d)² are those of the segments and of the prior together (except at
        eta_2 = 0, where the segments spread more than any log-normal distribution on 1 .. L).

        Parameters
        ----------
        counts
            shape (K, L), expected number of segments of each duration

        Returns
        -------
        Durations
            the durations after the step
        """
        features = _features(self.max_duration)
        weights = counts.sum(axis=1, keepdims=True) + PRIOR_SEGMENTS
        moments = (counts @ features.T + PRIOR_SEGMENTS * self.prior_moments) / weights
        natural = np.stack([_match_moments(target, features[0]) for target in moments])
        return Durations(natural, self.max_duration, self.prior_moments)


def _features(max_duration: int) -> Array:
    log_d = np.log(np.arange(1.0, max_duration + 1.0))
    return np.stack([log_d, log_d**2])


def _log_probabilities(natural: Array, features: Array) -> Array:
    values = natural @ features
    return np.asarray(values - scipy.special.logsumexp(values, axis=1, keepdims=True))


def _match_moments(target: Array, log_d: Array) -> Array:
    """Parameters eta (2,) at which log d and (log d)² have the moments `target` (2,), or eta_2 = 0.

    Damped Newton steps on the concave likelihood, in (x, x²) with x = (log d - mean) / scale, where the problem is
    well-conditioned.
    """
    centre = target[0]
    # durations are integers: a scale below half of their distance near the mean would see one of them alone
    scale = max(np.sqrt(max(target[1] - centre**2, 0.0)), 0.5 * np.exp(-centre))
    x = (log_d - centre) / scale
    features = np.stack([x, x**2])
    aim = np.array([0.0, (target[1] - centre**2) / scale**2])
    theta = _maximum(features, aim, np.array([0.0, -0.5]))
    if theta[1] > 0.0:  # broader than any power law: the maximum of those with eta_2 <= 0 lies at 0
        theta = np.append(_maximum(features[:1], aim[:1], np.zeros(1)), 0.0)
    linear, square = theta[0] / scale, theta[1] / scale**2
    return np.array([linear - 2.0 * square * centre, square])


def _maximum(features: Array, aim: Array, theta: Array) -> Array:
    """The maximum (F,) of theta^T aim - log sum_d exp(theta^T features_d) for features (F, L), from a start."""

    def log_normaliser(theta: Array) -> float:
        log_p = theta @ features
        top = log_p.max()
        return float(top + np.log(np.exp(log_p - top).sum()))

    for _ in range(MAX_STEPS):
        normaliser = log_normaliser(theta)
        p = np.exp(theta @ features - normaliser)
        gradient = aim - features @ p
        centred = features - (features @ p)[:, None]
        step = np.linalg.solve((p * centred) @ centred.T + 1e-12 * np.eye(len(theta)), gradient)
        gain = float(step @ gradient)
        if gain < 1e-12:  # twice what is left to gain; this last step squares it
            return np.asarray(theta + step)
        length = 1.0
        lowest = theta @ aim - normaliser
        while length > 1e-10:
            new = theta + length * step
            if new @ aim - log_normaliser(new) >= lowest + 0.1 * length * gain:
                break
            length *= 0.5
        theta = theta + length * step
    return theta
