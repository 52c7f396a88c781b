# SPDX-License-Identifier: Apache-2.0
"""What others do with task parameters, to compare with: the three kinds of models that Section 2 of the paper names.

1. `per_demonstration`: M models of the M demonstrations, each of its own situation; what they say is blended by how
   near their situations are.
2. `per_frame`: P models of the P frames, each learned alone, with components of its own; what they say is fused by
   Eq. (6).
3. `parametric`: one model whose output depends on the task parameters as numbers: GMR from time and task parameters to
   the point. In each component the mean is affine in the task parameters, as in a parametric HMM (Wilson and Bobick
   1999).

The first and the third see task parameters as inputs of a regression, not as frames: what they know ends with the
situations that were shown. All three are driven by time, and learn from demonstrations over [time, point] of the same
duration.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Self

import numpy as np

from tpgmm_core.choice.reproducing import spans, without_frames
from tpgmm_core.common.types import Array
from tpgmm_core.geometry.frame import Frame
from tpgmm_core.geometry.gaussian import Gaussian
from tpgmm_core.geometry.manifold import Manifold
from tpgmm_core.learning.learned_mixture import LearnedMixture
from tpgmm_core.learning.situations import FrameCoordinates, first_frames
from tpgmm_core.learning.tpgmm import TPGMM
from tpgmm_core.model.demonstration import Demonstration
from tpgmm_core.model.derived_frames import with_frames
from tpgmm_core.retrieval.regression import AdaptThenRegress

type Predict = Callable[[Demonstration], Array]
"""From a situation, with the times that are asked for, to points (T, D)."""

STILL = 1e-3
"""Task parameters that varied by less than this (m, rad; standard deviation) are no input."""
EXPLAINED = 0.95
"""Share of the variance of the task parameters that the inputs of the parametric model hold."""


@dataclass(frozen=True, slots=True)
class Learner:
    """How the models of a baseline are learned.

    Parameters
    ----------
    manifold
        of [time, point]
    n_components
        of each model
    reg_covar
        see `TPGMM`
    """

    manifold: Manifold
    n_components: int = 5
    reg_covar: float = 1e-4

    @classmethod
    def of(cls, manifold: Manifold, settings: Mapping[str, Any]) -> Self:
        """As settings of a model say, where they do; others, such as of covariances, count for that model alone."""
        return cls(manifold, **{name: settings[name] for name in ("n_components", "reg_covar") if name in settings})

    @property
    def points(self) -> Manifold:
        """Manifold of the points, without time."""
        return self.manifold.subset(range(1, self.manifold.dim))

    def model(self, demonstrations: Sequence[Demonstration], manifold: Manifold | None = None) -> LearnedMixture:
        """A mixture of these demonstrations, on `manifold` where it is another one."""
        return TPGMM(self.n_components, reg_covar=self.reg_covar, manifold=manifold or self.manifold).fit(
            demonstrations
        )


class TaskParameters:
    """The situations of demonstrations as numbers of about the same size: where the frames are at the beginning.

    Parameters
    ----------
    demonstrations
        over [time, point]
    points
        manifold of the points
    """

    def __init__(self, demonstrations: Sequence[Demonstration], points: Manifold) -> None:
        situations = [first_frames(demonstration) for demonstration in demonstrations]
        self._coordinates = FrameCoordinates.of(situations, points)
        shown = np.nan_to_num(np.stack([self._coordinates(frames) for frames in situations]))
        deviations = shown.std(axis=0)
        self._varied = deviations > STILL
        self._scale = deviations[self._varied]
        self.shown: Array = shown[:, self._varied] / self._scale

    def of(self, situation: Demonstration) -> Array:
        """The numbers (C,) of a situation; those of a frame that is not seen are 0, the mean of what was shown."""
        return np.asarray(np.nan_to_num(self._coordinates(first_frames(situation)))[self._varied] / self._scale)


def per_demonstration(demonstrations: Sequence[Demonstration], learner: Learner) -> Predict:
    """M models, blended by situation.

    Weights fall with the squared distance of the task parameters as a Gaussian does, whose standard deviation is
    half the median distance of a demonstration from the one nearest to it.

    Parameters
    ----------
    demonstrations
        two or more
    learner
        of each of the models

    Returns
    -------
    Predict
        the weighted mean of what the models say at each time
    """
    parameters, points = TaskParameters(demonstrations, learner.points), learner.points
    plain = [without_frames(demonstration) for demonstration in demonstrations]
    courses = []
    for demonstration in plain:
        course = AdaptThenRegress(learner.model([demonstration]))
        course.situate(demonstration.frames)
        courses.append(course)
    apart = np.linalg.norm(parameters.shown[:, None] - parameters.shown[None], axis=2)
    width = 0.5 * float(np.median(np.min(apart + np.diag(np.full(len(apart), np.inf)), axis=1)))

    def predict(situation: Demonstration) -> Array:
        squares = np.sum((parameters.shown - parameters.of(situation)) ** 2, axis=1)
        weights = np.exp(-0.5 * (squares - squares.min()) / max(width, 1e-6) ** 2)
        paths = np.stack([course.at(situation.times)[0] for course in courses], axis=1)
        return np.stack([points.mean(path, weights) for path in paths])

    return predict


def per_frame(demonstrations: Sequence[Demonstration], learner: Learner) -> Predict:
    """P models, each of one frame alone.

    Parameters
    ----------
    demonstrations
        one or more
    learner
        of each of the models

    Returns
    -------
    Predict
        the product of what the visible frames say at each time; where none is visible, the place before. Raises
        ValueError where the frames contradict each other so much that there is no product
    """
    names = list(demonstrations[0].frames)
    courses = {
        name: AdaptThenRegress(learner.model([with_frames(item, (name,)) for item in demonstrations])) for name in names
    }
    points = learner.points

    def predict(situation: Demonstration) -> Array:
        path = np.tile(situation.data[0, 1:], (len(situation.times), 1))
        for first, end, frames in spans(situation):
            seen = []
            for name, frame in frames.items():
                courses[name].situate({name: frame}, path[0])
                seen.append(courses[name].at(situation.times[first:end])[:2])
            for i in range(first, end):
                if seen:
                    each = [Gaussian(means[i - first], S[i - first], points) for means, S in seen]
                    path[i] = Gaussian.product(each).mean
                elif i > 0:
                    path[i] = path[i - 1]
        return path

    return predict


def parametric(demonstrations: Sequence[Demonstration], learner: Learner) -> Predict:
    """One model over [time, task parameters, point]; of the task parameters, their first principal components.

    As many of these as hold EXPLAINED of the variance, but no more than half of the demonstrations: a component that
    has as many inputs as situations repeats what was shown and knows nothing of its spread.

    Parameters
    ----------
    demonstrations
        two or more
    learner
        of the model

    Returns
    -------
    Predict
        regression on time and task parameters
    """
    parameters, M = TaskParameters(demonstrations, learner.points), len(demonstrations)
    centred = parameters.shown - parameters.shown.mean(axis=0)
    _, s, directions = np.linalg.svd(centred, full_matrices=False)
    share = np.cumsum(s**2) / max(float(np.sum(s**2)), np.finfo(float).tiny)
    n = min(int(np.searchsorted(share, EXPLAINED)) + 1, max(1, M // 2), len(s))
    basis = directions[:n]
    factors = " x ".join(f"{kind}{size}" for kind, size in learner.points.factors)
    manifold = Manifold.parse(f"R{1 + n} x {factors}")

    def extended(demonstration: Demonstration) -> Demonstration:
        inputs = np.tile(basis @ parameters.of(demonstration), (len(demonstration.times), 1))
        data = np.column_stack([demonstration.times, inputs, demonstration.data[:, 1:]])
        base = Frame(np.eye(manifold.dim), np.zeros(manifold.dim))
        return Demonstration(demonstration.times, data, {"base": base})

    shown = [extended(demonstration) for demonstration in demonstrations]
    mixture = learner.model(shown, manifold).adapt(shown[0].frames)

    def predict(situation: Demonstration) -> Array:
        inputs = np.tile(basis @ parameters.of(situation), (len(situation.times), 1))
        return np.asarray(
            mixture.condition(list(range(1 + n)), np.column_stack([situation.times, inputs])).mean, dtype=float
        )

    return predict


BASELINES: dict[str, Callable[[Sequence[Demonstration], Learner], Predict]] = {
    "M models, blended": per_demonstration,
    "P models, product": per_frame,
    "parametric": parametric,
}
"""By the name that tables give them."""
