# SPDX-License-Identifier: Apache-2.0
"""How new a situation is to a model: how much its frames contradict each other, and how far it is from what was shown.

Covariances do not tell: they say how exactly demonstrations agreed, and grow little where none was. Two numbers do.

- *Contradiction*: in each component, the frames' Gaussians are fused by Eq. (6) to x_k. Each frame j had expected
  N(m_j,k, S_j,k); how far that is from x_k, sum_j (m_j,k - x_k)^T S_j,k^-1 (m_j,k - x_k), is what the product costs: it
  is chi^2 distributed with (P - 1) n degrees of freedom where P frames agree as well as the model says. The root of its
  mean over the components, per degree of freedom.
- *Distance*: where the frames are, as seen from one of them, in standard deviations of the demonstrations: the largest.

Neither has a natural limit, so that both are held against those of demonstrations that a model of the others had not
seen: the contradiction against what it was for 90 % of them, the distance, which says little inside the range, against
the largest of all.
"""

from __future__ import annotations

import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from tpgmm_core.common.text import shown
from tpgmm_core.common.types import Array
from tpgmm_core.geometry.frame import Frame
from tpgmm_core.geometry.manifold import Manifold
from tpgmm_core.geometry.mixture import GaussianMixture
from tpgmm_core.learning.learned_mixture import LearnedMixture
from tpgmm_core.learning.situations import seen_from
from tpgmm_core.model.frame_buffer import manifold_origin
from tpgmm_core.retrieval.interface import Retrieval

KEY = "novelty"
"""Key of the calibration in a model's metadata, a text in JSON."""
USUAL = 0.9
"""A contradiction counts 1 where it is that of this share of the demonstrations left out."""
STILL = (1e-3, 0.01)
"""Frames that never moved may be as far off before they count: units of places (m), rad."""


def contradiction(retrieval: Retrieval, frames: Mapping[str, Frame], state: Array | None = None) -> float:
    """How much frames contradict each other, in standard deviations: see the module.

    Parameters
    ----------
    retrieval
        a movement of the model, which begins anew for this
    frames
        over [time, data]
    state
        (D,), where the robot is; None where not known

    Returns
    -------
    float
        0 for a single frame; infinite where the frames have no product
    """
    if len(frames) < 2:
        return 0.0
    try:
        fused = _mixture(retrieval, frames, state)
    except ValueError:
        return math.inf
    manifold = fused.manifold
    costs = np.zeros(len(fused.priors))
    for name, frame in frames.items():
        seen = _mixture(retrieval, {name: frame}, state)
        steps = np.stack([manifold.log(x, m) for x, m in zip(fused.means, seen.means, strict=True)])
        costs += np.einsum("ki,ki->k", steps, np.linalg.solve(seen.covariances, steps[:, :, None])[:, :, 0])
    freedom = (len(frames) - 1) * manifold.tangent_dim
    return float(np.sqrt(fused.priors @ costs / freedom))


@dataclass(frozen=True, slots=True)
class SituationRange:
    """Where the frames of demonstrations were, as seen from one of them.

    Parameters
    ----------
    manifold
        of the data, without time, as text
    reference
        the frame from which the others are seen
    means
        frame → point (D,), the mean of its origins
    deviations
        frame → (n,), standard deviations about it
    """

    manifold: str
    reference: str
    means: Mapping[str, Sequence[float]]
    deviations: Mapping[str, Sequence[float]]

    @classmethod
    def of(cls, situations: Sequence[Mapping[str, Frame]], names: Sequence[str], manifold: Manifold) -> SituationRange:
        """The range of situations.

        Parameters
        ----------
        situations
            frames over [time, data] of each demonstration, those of a model at least
        names
            the frames of the model
        manifold
            of the data, without time

        Returns
        -------
        SituationRange
            seen from the first of the names
        """
        origin = manifold_origin(manifold)
        floor = np.full(manifold.tangent_dim, STILL[1])
        floor[manifold.flat_tangent] = STILL[0]
        means, deviations = {}, {}
        for name in names[1:]:
            both = [frames for frames in situations if name in frames and names[0] in frames]
            points = np.stack([seen_from(frames[names[0]], frames[name], origin) for frames in both])
            mean = manifold.mean(points)
            spread = np.sqrt(np.mean(manifold.log(mean, points) ** 2, axis=0) * len(both) / max(len(both) - 1, 1))
            means[name] = mean.tolist()
            deviations[name] = np.hypot(spread, floor).tolist()
        return cls(str(manifold), names[0], means, deviations)

    def distance(self, frames: Mapping[str, Frame]) -> float:
        """How far a situation is from the mean, in standard deviations of the coordinate in which that is most."""
        manifold = Manifold.parse(self.manifold)
        origin, largest = manifold_origin(manifold), 0.0
        if self.reference not in frames:
            return largest
        for name, mean in self.means.items():
            if name in frames:
                point = seen_from(frames[self.reference], frames[name], origin)
                deviations = np.abs(manifold.log(np.asarray(mean), point)) / np.asarray(self.deviations[name])
                largest = max(largest, float(deviations.max()))
        return largest


@dataclass(frozen=True, slots=True)
class Novelty:
    """How new a situation is.

    Parameters
    ----------
    contradiction, distance
        see the module, in standard deviations
    score
        the larger of both, each in units of what it was for the demonstrations left out: contradiction over its 90 %
        quantile, distance over its largest
    percentile
        share of the demonstrations left out whose score was less
    """

    contradiction: float
    distance: float
    score: float
    percentile: float

    def __str__(self) -> str:
        return (
            f"frames contradict each other by {self.contradiction:.2g} standard deviations, and are "
            f"{self.distance:.2g} from where they were: more than for {self.percentile:.0%} of the demonstrations left "
            "out"
        )


@dataclass(frozen=True, slots=True)
class NoveltyScale:
    """What novelty usually is: of demonstrations that a model of the others had not seen.

    Parameters
    ----------
    range
        of the demonstrated situations
    contradictions, distances
        of each demonstration left out
    """

    range: SituationRange
    contradictions: tuple[float, ...]
    distances: tuple[float, ...]

    @classmethod
    def of_model(cls, model: LearnedMixture) -> NoveltyScale | None:
        """What the metadata of a model say of it; None where they say nothing.

        Parameters
        ----------
        model
            with metadata

        Returns
        -------
        NoveltyScale | None
            as `metadata` wrote it

        Raises
        ------
        ValueError
            for a text that does not hold it
        """
        text = model.metadata_.get(KEY)
        if text is None:
            return None
        try:
            found: dict[str, Any] = json.loads(str(text))
            scale = cls(
                SituationRange(**found["range"]),
                tuple(map(float, found["contradictions"])),
                tuple(map(float, found["distances"])),
            )
            manifold = Manifold.parse(scale.range.manifold)
            sizes = {(len(scale.range.means[name]), len(d)) for name, d in scale.range.deviations.items()}
            is_whole = sizes <= {(manifold.dim, manifold.tangent_dim)} and len(scale.distances) > 0
        except (ValueError, TypeError, KeyError, AttributeError) as error:
            raise ValueError(f"the model's metadata hold no {KEY}: {shown(str(error))}; train it again") from error
        if not is_whole or len(scale.contradictions) != len(scale.distances):
            raise ValueError(f"the model's metadata hold no {KEY} of its frames; train it again")
        return scale

    def metadata(self) -> dict[str, str]:
        """As a model keeps it."""
        return {KEY: json.dumps(asdict(self))}

    def judge(self, retrieval: Retrieval, frames: Mapping[str, Frame], state: Array | None = None) -> Novelty:
        """How new a situation is.

        Parameters
        ----------
        retrieval, frames, state
            as for `contradiction`

        Returns
        -------
        Novelty
            against the demonstrations left out
        """
        against, far = contradiction(retrieval, frames, state), self.range.distance(frames)
        usual, farthest = float(np.quantile(self.contradictions, USUAL)), max(self.distances)
        scale = 1.0 / np.maximum([usual, farthest], 1e-9)
        left_out = np.column_stack([self.contradictions, self.distances])
        score = float((scale * [against, far]).max())
        return Novelty(against, far, score, float(np.mean((scale * left_out).max(axis=1) < score)))


def _mixture(retrieval: Retrieval, frames: Mapping[str, Frame], state: Array | None) -> GaussianMixture:
    retrieval.start(0, state)
    retrieval.step(0, frames, state)
    return retrieval.mixture()
