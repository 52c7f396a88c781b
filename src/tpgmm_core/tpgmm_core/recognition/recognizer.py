# SPDX-License-Identifier: Apache-2.0
"""`Recognizer`: which of several skills is being shown, judged while it goes on, and where the hand goes next.

Bayes' rule over the skills, with the likelihoods of their chains (`recognition.skill`), and over one more class:
*unknown*. Its likelihood is what the skill that explains the hand best would give to a hand on the border of what it
expects: at the squared Mahalanobis distance that a share `expected` of what is shown of a skill does not exceed (chi^2,
with the covariances as they were calibrated on demonstrations left out). So a hand that stays within the border of one
skill is known, and one that is outside all of them for some time is not.

Times are ns of a clock of the caller's; a step takes no time but the computer's.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from tpgmm_core.common.settings import Settings, setting
from tpgmm_core.common.types import Array
from tpgmm_core.geometry.frame import Frame
from tpgmm_core.geometry.gaussian import Gaussian
from tpgmm_core.geometry.manifold import Manifold
from tpgmm_core.geometry.region import squared_radius
from tpgmm_core.model.situation import Situation
from tpgmm_core.recognition.skill import Skill, SkillFilter, moments

UNKNOWN = "unknown"
"""Name of the class of movements that are none of the skills."""
_SECOND = 1_000_000_000


@dataclass(frozen=True, slots=True, kw_only=True)
class RecognitionConfig(Settings):
    """How movements are recognised."""

    n_states: int = setting(50, 2, 1000, "Number of points in time of each skill that the hand is compared with")
    memory: float = setting(0.2, 1e-3, 60.0, "Time within which everything that is seen counts as one observation, s")
    begins: float = setting(
        0.9,
        0.0,
        1.0,
        "Probability that a movement is at its beginning when it is first seen; otherwise it may be anywhere",
    )
    expected: float = setting(
        0.99,
        0.5,
        0.999999,
        "Share of the observations of a skill that lie within its border; beyond it, a movement counts as unknown",
    )
    pause: float = setting(
        2.0, 0.01, 3600.0, "Another movement begins after the hand was not seen for longer than this, s"
    )
    unknown_prior: float = setting(
        0.1, 0.0, 0.999, "Probability of an unknown movement, before anything was seen; 0: it is one of the skills"
    )


@dataclass(frozen=True, slots=True)
class Recognition:
    """What is known after a step.

    Parameters
    ----------
    probabilities
        of each skill by name, and of UNKNOWN; they sum to 1
    phases
        mean share of the movement that is done, by name of the skill, were it this one
    """

    probabilities: Mapping[str, float]
    phases: Mapping[str, float]

    @property
    def most_probable(self) -> str:
        """Name of the class with the largest probability."""
        return max(self.probabilities, key=self.probabilities.__getitem__)


class Recognizer:
    """Watches one movement.

    Parameters
    ----------
    skills
        one or more with different names, on one manifold
    config
        settings

    Raises
    ------
    ValueError
        for no skills, a name that is given twice or UNKNOWN, and skills on different manifolds
    """

    def __init__(self, skills: Sequence[Skill], config: RecognitionConfig | None = None) -> None:
        self.config = config or RecognitionConfig()
        names = [skill.name for skill in skills]
        if not names or len(set(names)) < len(names) or UNKNOWN in names:
            raise ValueError(
                f"skills have different names, none of them {UNKNOWN!r}, and there is at least one: {names}"
            )
        self.filters = [SkillFilter(skill, self.config.n_states, self.config.begins) for skill in skills]
        spaces = {skill.name: str(skill.course.manifold) for skill in skills}
        if len(set(spaces.values())) > 1:
            raise ValueError(f"skills that are told apart are on one manifold, got {spaces}")
        self._border = squared_radius(self.config.expected, skills[0].course.manifold.tangent_dim)
        priors = np.array([skill.prior for skill in skills])
        known = 1.0 - self.config.unknown_prior
        with np.errstate(divide="ignore"):
            self._log_priors = np.log(np.append(known * priors / priors.sum(), self.config.unknown_prior))
        self.start()

    @property
    def names(self) -> tuple[str, ...]:
        """The skills, in the order of their probabilities; UNKNOWN comes last."""
        return tuple(one.skill.name for one in self.filters)

    @property
    def manifold(self) -> Manifold:
        """Manifold of the points, without time."""
        return self.filters[0].skill.course.manifold

    def start(self) -> None:
        """Watch another movement: forget all that was seen."""
        for one in self.filters:
            one.start()
        self._log_posterior = self._log_priors.copy()
        self._last_ns: int | None = None
        self._situation: Situation | None = None

    def step(
        self,
        time_ns: int,
        point: ArrayLike,
        frames: Mapping[str, Frame],
        weights: Mapping[str, float] | None = None,
    ) -> Recognition:
        """Take in where the hand is.

        Parameters
        ----------
        time_ns
            when it was there, ns; a time before the last one counts as that. Further away than `pause`, another
            movement begins
        point
            (D,), such as its pose
        frames
            over [time, point], those that are known now, by name; a skill none of whose frames is known is neither
            more nor less probable afterwards
        weights
            how far each frame is trusted, 0 to 1; 1 where not named

        Returns
        -------
        Recognition
            what is known by now

        Raises
        ------
        ValueError
            for a point that does not fit or is not finite, and as of `TimeParametrized.situate`
        """
        x = np.array(point, dtype=float)
        if x.shape != (self.manifold.dim,) or not np.isfinite(x).all():
            raise ValueError(f"the point is finite, of shape ({self.manifold.dim},) on {self.manifold}; got {point!r}")
        if self._last_ns is not None and abs(time_ns - self._last_ns) > self.config.pause * _SECOND:
            self.start()
        seconds = 0.0 if self._last_ns is None else max(0.0, (time_ns - self._last_ns) / _SECOND)
        first, self._last_ns = self._last_ns is None, time_ns if self._last_ns is None else max(time_ns, self._last_ns)
        situation = Situation(frames, weights)
        if self._situation is None or not situation.has_frames_of(self._situation):
            for one in self.filters:
                one.situate(situation.frames, x, situation.weights)
            self._situation = situation
        # a hand that was not seen for long says no more than one observation
        weight = 1.0 if first else min(1.0, seconds / self.config.memory)
        gained, borders = np.full(len(self.filters), np.nan), np.full(len(self.filters), np.nan)
        for i, one in enumerate(self.filters):
            one.advance(seconds)
            if one.is_situated and weight > 0.0:
                gained[i], borders[i] = one.see(x, weight, self._border)
        if not np.isnan(gained).all():
            border = borders[np.nanargmax(self._log_posterior[:-1] + gained)]
            # who is not judged is as probable against the rest as before
            self._log_posterior += np.append(
                np.where(np.isnan(gained), self._mean_gain(gained, border), gained), border
            )
        self._log_posterior -= self._log_posterior.max()
        return self.recognition()

    def _mean_gain(self, gained: Array, border: float) -> float:
        """What the classes that were judged gained on average, by their probabilities."""
        all_gained = np.append(gained, border)
        judged = ~np.isnan(all_gained)
        log_joint = self._log_posterior[judged] + all_gained[judged]
        return float(np.logaddexp.reduce(log_joint) - np.logaddexp.reduce(self._log_posterior[judged]))

    def recognition(self) -> Recognition:
        """What is known by now, as of the last step."""
        probabilities = self._probabilities()
        return Recognition(
            dict(zip((*self.names, UNKNOWN), probabilities.tolist(), strict=True)),
            {one.skill.name: one.phase() for one in self.filters},
        )

    def _probabilities(self) -> Array:
        p = np.exp(self._log_posterior - self._log_posterior.max())
        return np.asarray(p / p.sum())

    def predict(self, ahead: float) -> Gaussian | None:
        """Where the hand will be if it goes on with one of the skills, all of them by their probabilities.

        Parameters
        ----------
        ahead
            s from the last step; infinite: where the movement ends

        Returns
        -------
        Gaussian | None
            with the mean and the covariance of all possibilities; None before the first step, and while no skill can
            be judged

        Raises
        ------
        ValueError
            for a negative time
        """
        if not ahead >= 0.0:
            raise ValueError(f"a prediction is made for a time from now on, got {ahead!r} s")
        parts: list[tuple[Array, Array, Array]] = []
        for p, one in zip(self._probabilities(), self.filters, strict=False):
            if one.is_situated:
                end = np.eye(len(one.alpha))[-1]
                alpha = end if math.isinf(ahead) else one.later(ahead)
                parts.append((p * alpha, one.means, one.covariances))
        if self._situation is None or not parts or not sum(float(w.sum()) for w, _, _ in parts) > 0.0:
            return None
        weights, means, covariances = (np.concatenate(group) for group in zip(*parts, strict=True))
        manifold = self.manifold
        return Gaussian(*moments(manifold, weights, means, covariances), manifold)
