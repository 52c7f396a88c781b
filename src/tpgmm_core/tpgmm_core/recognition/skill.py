# SPDX-License-Identifier: Apache-2.0
"""`Skill`, a movement that can be recognised, and `SkillFilter`, how far along it a hand is that is being watched.

A model over time is turned round: not "where at this time", but "at which of the model's times, judged by where the
hand is". The times t_1 < ... < t_N of a skill are the states of a chain. In the present situation each has the Gaussian
N(mu_i, S_i) that regression on the adapted mixture gives (Eqs. 5 and 6, GMR), so that the judgement is made from the
frames' points of view. A state is left for the next one at the rate at which the model's time passes: the chain as a
whole takes as long as demonstrated, with a standard deviation of 1 / N^(1/2) of that. The last state is kept.

The forward variable alpha_i of the chain is the probability of state i, given all that was seen. Neighbouring samples
say the same thing twice: a density counts with the exponent dt / memory, so that what is found does not depend on how
often the hand is seen.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from tpgmm_core.common.constants import LOG_2PI
from tpgmm_core.common.types import Array
from tpgmm_core.geometry.frame import Frame
from tpgmm_core.geometry.manifold import Manifold
from tpgmm_core.learning.learned_mixture import LearnedMixture
from tpgmm_core.recognition import kernels_recognition
from tpgmm_core.retrieval.calibrated import covariance_scale
from tpgmm_core.retrieval.interface import TimeParametrized
from tpgmm_core.retrieval.methods import method_of

LARGEST_SHARE = 0.25
"""Of a state that is left within one step of the chain; longer times are taken in several steps."""


@dataclass(frozen=True, slots=True)
class Skill:
    """A movement that can be recognised.

    Parameters
    ----------
    name
        of the skill
    course
        the movement as a function of the model's time
    scale
        what its covariances are to be multiplied by: those of few demonstrations are too small
    prior
        how probable it is before anything was seen, against the other skills

    Raises
    ------
    ValueError
        for a scale or a prior that is not positive
    """

    name: str
    course: TimeParametrized
    scale: float = 1.0
    prior: float = 1.0

    def __post_init__(self) -> None:
        for what, value in (("scale", self.scale), ("prior", self.prior)):
            if not 0.0 < value < math.inf:
                raise ValueError(f"the {what} of the skill {self.name!r} is a positive number, got {value!r}")

    @classmethod
    def of_model(cls, name: str, model: LearnedMixture, prior: float = 1.0) -> Skill:
        """A skill of a model, with the scale that was found for what `train --leave-one-out` had left out.

        Parameters
        ----------
        name
            of the skill
        model
            that knows the movement as a function of time
        prior
            against the other skills

        Returns
        -------
        Skill
            to be recognised

        Raises
        ------
        ValueError
            for a model of a retrieval method with a state of its own
        """
        method = method_of(model)
        if method.time_parametrized is None:
            raise ValueError(
                f"the model of {name!r} is of the method {method.name}, which does not know its movement as a function "
                "of time: train it with --retrieval adapt_regress, regress_product, trajectory or time_steps"
            )
        method.check(model)
        return cls(name, method.time_parametrized(model), covariance_scale(model, method.name), prior)


class SkillFilter:
    """The forward variable of one skill's chain.

    Parameters
    ----------
    skill
        whose chain it is
    n_states
        N
    begins
        probability that the movement is at its beginning when it is first seen; else it may be anywhere

    Attributes
    ----------
    alpha
        (N,), probabilities of the states, given all that was seen
    means, covariances
        (N, D) and (N, n, n), of the states in the present situation, scaled
    """

    def __init__(self, skill: Skill, n_states: int, begins: float) -> None:
        self.skill, self.manifold = skill, skill.course.manifold
        self.times = np.linspace(0.0, skill.course.duration, n_states)
        self._start = np.full(n_states, (1.0 - begins) / n_states)
        self._start[0] += begins
        n, D = self.manifold.tangent_dim, self.manifold.dim
        self.means, self.covariances = np.zeros((n_states, D)), np.zeros((n_states, n, n))
        self._whitening, self._log_norms = np.zeros((n_states, n, n)), np.zeros(n_states)
        self._is_situated = False
        self.start()
        self.log_densities(np.zeros(D), 1.0)  # compiled, or loaded from the cache
        self.later(1e-3)

    def start(self) -> None:
        """Forget all that was seen; the situation stays."""
        self.alpha = self._start.copy()

    @property
    def is_situated(self) -> bool:
        """Whether any of the skill's frames is known, so that it can be judged at all."""
        return self._is_situated

    def situate(self, frames: Mapping[str, Frame], state: Array, weights: Mapping[str, float] | None) -> None:
        """Change to a situation.

        Parameters
        ----------
        frames
            over [time, point], by name; those that the skill does not know are not for it
        state
            (D,), where the hand is: what no frame constrains is expected there
        weights
            how far each frame is trusted, 0 to 1
        """
        mine = {name: frame for name, frame in frames.items() if name in self.skill.course.frame_names}
        known = {name: weight for name, weight in (weights or {}).items() if name in mine}
        self._is_situated = any(known.get(name, 1.0) > 0.0 for name in mine)
        if not self._is_situated:
            return
        self.skill.course.situate(mine, state, known)
        means, covariances, _ = self.skill.course.at(self.times)
        self.means, self.covariances = np.array(means), np.array(self.skill.scale * covariances)
        self.manifold = self.skill.course.manifold
        L = np.linalg.cholesky(self.covariances)
        self._whitening = np.ascontiguousarray(np.linalg.inv(L))
        logs = np.log(np.diagonal(L, axis1=1, axis2=2)).sum(axis=1)
        self._log_norms = -logs - 0.5 * self.manifold.tangent_dim * LOG_2PI

    def advance(self, seconds: float) -> None:
        """Let time pass, s."""
        self.alpha = self.later(seconds)

    def later(self, seconds: float) -> Array:
        """Probabilities (N,) of the states in some seconds, with no more known than now."""
        alpha = self.alpha.copy()
        if seconds > 0.0:
            kernels_recognition.advance(alpha, seconds * (len(alpha) - 1) / self.times[-1], LARGEST_SHARE)
        return alpha

    def see(self, point: Array, weight: float, border: float) -> tuple[float, float]:
        """Take in where the hand is.

        Parameters
        ----------
        point
            (D,)
        weight
            exponent of the densities
        border
            squared Mahalanobis distance at which what is seen is on the border of what the skill expects

        Returns
        -------
        tuple[float, float]
            log-likelihood of the point under the skill, and that of a point on the border
        """
        log_densities, at_border = self.log_densities(point, weight), self.border_densities(border, weight)
        top = float(log_densities.max())
        joint = self.alpha * np.exp(log_densities - top)
        total = float(joint.sum())
        if not total > 0.0:  # all that is left of the chain is far away: judge it where it is best
            joint, total = np.exp(log_densities - top), np.finfo(float).tiny
        highest = float(at_border.max())
        expected = highest + math.log(float(self.alpha @ np.exp(at_border - highest)))
        self.alpha = joint / joint.sum()
        return top + math.log(total), expected

    def log_densities(self, point: Array, weight: float) -> Array:
        """Of a point (D,) in each state, (N,), times a weight."""
        out, manifold = np.empty(len(self.means)), self.manifold
        kernels_recognition.log_densities(
            self.means, self._whitening, self._log_norms, point, weight,
            manifold.ambient_of_tangent, manifold.sphere_starts, out,
        )  # fmt: skip
        return out

    def border_densities(self, border: float, weight: float) -> Array:
        """As `log_densities`, (N,), of points at this squared Mahalanobis distance from each state."""
        return np.asarray(weight * (self._log_norms - 0.5 * border))

    def phase(self) -> float:
        """Mean share of the movement that is done, 0 to 1."""
        return float(self.alpha @ self.times) / float(self.times[-1])


def moments(manifold: Manifold, weights: Array, means: Array, covariances: Array) -> tuple[Array, Array]:
    """Mean (D,) and covariance (n, n) of a mixture on a manifold.

    Parameters
    ----------
    manifold
        of the points
    weights
        (K,), with a positive sum
    means, covariances
        (K, D) and (K, n, n)

    Returns
    -------
    tuple[Array, Array]
        where the weighted tangent vectors cancel out; covariances moved there by parallel transport
    """
    chosen = weights > 1e-4 * weights.max()
    w = weights[chosen] / weights[chosen].sum()
    mean = manifold.mean(means[chosen], w)
    steps = manifold.log(mean, means[chosen])
    moved = covariances[chosen]
    if not manifold.is_euclidean:
        maps = manifold.transport(means[chosen], mean)
        moved = maps @ moved @ maps.swapaxes(1, 2)
    return mean, np.einsum("k,kij->ij", w, moved + steps[:, :, None] * steps[:, None, :])
