# SPDX-License-Identifier: Apache-2.0
"""`Situation`: what a movement is adapted to at one moment, as a value."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType

import numpy as np

from tpgmm_core.common.types import Array
from tpgmm_core.geometry.frame import Frame


@dataclass(frozen=True, slots=True, eq=False)
class Situation:
    """The frames of a moment, how far each is trusted, and where the robot is.

    Two situations are equal when their numbers are, whatever objects hold them: perception makes new ones all the time,
    also while nothing changes. What is kept is a copy, so that writing to a mapping later does not change the
    situation. Comparing costs little where the frames are the same objects, since a `Frame` does not change.

    Parameters
    ----------
    frames
        those that are known, by name
    weights
        how far each frame is trusted, 0 to 1; 1 where not named
    state
        shape (D,), where the robot is; None where that is not known
    """

    frames: Mapping[str, Frame]
    weights: Mapping[str, float] | None = None
    state: Array | None = None

    def __post_init__(self) -> None:
        frames = dict(self.frames)
        weights = dict.fromkeys(frames, 1.0)
        if self.weights is not None:
            weights.update(self.weights)
        object.__setattr__(self, "frames", MappingProxyType(frames))
        object.__setattr__(self, "weights", MappingProxyType(weights))
        if self.state is not None:
            object.__setattr__(self, "state", np.array(self.state, dtype=float))

    def has_frames_of(self, other: Situation) -> bool:
        """Whether frames and weights are equal; the state of the robot does not matter."""
        return self.frames == other.frames and self.weights == other.weights

    def __eq__(self, other: object) -> bool:
        if not isinstance(other, Situation):
            return NotImplemented
        if self.state is None or other.state is None:
            is_same_state = self.state is other.state
        else:
            is_same_state = np.array_equal(self.state, other.state)
        return is_same_state and self.has_frames_of(other)

    __hash__ = None  # type: ignore[assignment]  # compared, never looked up
