# SPDX-License-Identifier: Apache-2.0
"""Constraints that a movement meets exactly: to be where a frame says at a phase, such as at its end.

A constraint is a Gaussian with (nearly) no variance in one frame at one phase: in the product over the frames, the
others have no say there. Alone, it would be a jump. So the movement is taken for a Gaussian process about what it says
by itself, with the correlation k(s, s') = exp(-(s - s')^2 / (2 width^2)) between phases, and is conditioned on the
constraints, as probabilistic movement primitives are on via-points (Paraschos et al., NIPS 2013): with v_a the tangent
vectors to the constraints and K the correlations between them,

    mean(s) moves by k(s)^T K^-1 v,   covariance(s) is multiplied by 1 - k(s)^T K^-1 k(s).

So means go through the points exactly, and some widths away the movement is what it was.
"""

from __future__ import annotations

import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from tpgmm_core.common.text import listed, shown
from tpgmm_core.common.types import Array
from tpgmm_core.geometry.frame import Frame
from tpgmm_core.learning.learned_mixture import LearnedMixture
from tpgmm_core.retrieval.interface import TimeParametrized
from tpgmm_core.retrieval.wrapped import WrappedTimeParametrized

KEY = "exact"
"""Key of the constraints in metadata and settings, a text."""
WIDTH = 0.1
"""Share of the movement over which it bends to a constraint, as a standard deviation."""
EXACT = 1e-4
"""Standard deviation (m, rad) that is left, so that a covariance has an inverse."""
_ONE = re.compile(r"\s*(\S+)\s+at\s+(\S+)\s*")


@dataclass(frozen=True, slots=True)
class Constraint:
    """Be where a frame says, at a phase.

    Parameters
    ----------
    frame
        its name
    phase
        0 to 1
    point
        as the frame sees it (D,); None: where the model says that demonstrations were, as the frame saw them

    Raises
    ------
    ValueError
        for another phase
    """

    frame: str
    phase: float
    point: tuple[float, ...] | None = None

    def __post_init__(self) -> None:
        if not (math.isfinite(self.phase) and 0.0 <= self.phase <= 1.0):
            raise ValueError(f"the phase of a constraint is 0 to 1, and that of frame {self.frame!r} is {self.phase!r}")


def parsed(text: Any) -> tuple[Constraint, ...]:
    """Read constraints.

    Parameters
    ----------
    text
        such as "target at 1, object at 0.45"

    Returns
    -------
    tuple[Constraint, ...]
        in the order of the text

    Raises
    ------
    ValueError
        for another text, and two constraints at the same phase
    """
    parts = [_ONE.fullmatch(part) for part in text.split(",")] if isinstance(text, str) else [None]
    try:
        found = tuple(Constraint(part[1], float(part[2])) for part in parts if part is not None)
    except ValueError as error:
        raise ValueError(f"{KEY} is {shown(text)}: {error}") from error
    if len(found) < len(parts):
        raise ValueError(f"{KEY} is {shown(text)}; expected frames and phases, such as 'target at 1, object at 0.45'")
    if len({constraint.phase for constraint in found}) < len(found):
        raise ValueError(f"{KEY} is {shown(text)}: two constraints have the same phase; give each its own")
    return found


def constraints_of(model: LearnedMixture) -> tuple[Constraint, ...]:
    """What the metadata of a model ask for.

    Parameters
    ----------
    model
        with metadata

    Returns
    -------
    tuple[Constraint, ...]
        none where they ask for none

    Raises
    ------
    ValueError
        for a text that holds no constraints, and for frames that the model does not have
    """
    text = model.metadata_.get(KEY)
    found = () if text is None else parsed(text)
    unknown = [constraint.frame for constraint in found if constraint.frame not in model.frame_names_]
    if unknown:
        raise ValueError(f"{KEY} names {listed(unknown)}; the model has the frames {listed(model.frame_names_)}")
    return found


class Constrained(WrappedTimeParametrized):
    """A movement as a function of time that meets constraints.

    A constraint whose frame is not known, or is not trusted at all, has no effect.

    Parameters
    ----------
    course
        the movement without constraints; its situation is changed
    constraints
        one or more, each at a phase of its own
    width
        share of the movement over which it bends

    Raises
    ------
    ValueError
        for a frame that the model does not have, and a point of another space
    """

    def __init__(self, course: TimeParametrized, constraints: Sequence[Constraint], width: float = WIDTH) -> None:
        super().__init__(course)
        self._width = width * course.duration
        self._at, self._points = np.array([c.phase * course.duration for c in constraints]), []
        self._frames = [constraint.frame for constraint in constraints]
        D = course.manifold.dim
        for constraint, time in zip(constraints, self._at, strict=True):
            if constraint.frame not in course.frame_names:
                known = listed(course.frame_names)
                raise ValueError(f"{KEY} names frame {constraint.frame!r}; the model has the frames {known}")
            point = constraint.point
            if point is None:
                course.situate({constraint.frame: Frame(np.eye(D + 1), np.zeros(D + 1))})
                point = tuple(course.at(np.array([time]))[0][0])
            if len(point) != D:
                raise ValueError(f"a point of {course.manifold} has {D} numbers, the constraint has {len(point)}")
            self._points.append(np.array(point))
        self._targets: Mapping[int, Array] = {}
        self._shifts: Array | None = None

    def situate(
        self, frames: Mapping[str, Frame], state: Array | None = None, weights: Mapping[str, float] | None = None
    ) -> None:
        """Change to this situation: see `TimeParametrized.situate`."""
        super().situate(frames, state, weights)
        self._targets = {
            i: frames[name].A[1:, 1:] @ point + frames[name].b[1:]
            for i, (name, point) in enumerate(zip(self._frames, self._points, strict=True))
            if name in frames and (weights or {}).get(name, 1.0) > 0.0
        }
        self._shifts = None

    def at(self, times: Array) -> tuple[Array, Array, Array]:
        """The movement at times (H,), s: see `TimeParametrized.at`."""
        times, chosen = np.asarray(times, dtype=float), list(self._targets)
        if not chosen:
            return self._course.at(times)
        H, at = len(times), self._at[chosen]
        if self._shifts is None:
            means, covariances, activations = self._course.at(np.concatenate([times, at]))
            missing = [self.manifold.log(means[H + k], self._targets[i]) for k, i in enumerate(chosen)]
            self._correlations = np.linalg.inv(self._correlated(at, at))
            self._shifts = self._correlations @ np.array(missing)
            means, covariances = means[:H], covariances[:H]
        else:
            means, covariances, activations = self._course.at(times)
        k = self._correlated(np.clip(times, 0.0, self.duration), at)
        left = np.maximum(1.0 - np.einsum("ha,ab,hb->h", k, self._correlations, k), 0.0)
        floor = EXACT**2 * np.eye(covariances.shape[-1])
        return self.manifold.exp(means, k @ self._shifts), left[:, None, None] * covariances + floor, activations

    def _correlated(self, one: Array, other: Array) -> Array:
        return np.asarray(np.exp(-0.5 * ((one[:, None] - other) / self._width) ** 2))
