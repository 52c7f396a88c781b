# SPDX-License-Identifier: Apache-2.0
"""`Learned`: the numbers of a model at one moment, to tell whether what was prepared from them still holds."""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING

from tpgmm_core.quaternion import Array

if TYPE_CHECKING:
    from tpgmm_core.tpgmm import TPGMM


class Learned:
    """A copy of what a model learned: its frames, space, priors, means and covariances.

    Comparing takes a few microseconds, in proportion to the size of the model, and sees every change: another fit,
    attributes set by hand, and arrays changed in place.
    """

    __slots__ = ("frame_names", "manifold", "contents")

    def __init__(self, model: TPGMM) -> None:
        self.frame_names, self.manifold = model.frame_names_, model.manifold_
        self.contents = [(array.shape, array.dtype, array.tobytes()) for array in _arrays(model)]

    def is_of(self, model: TPGMM) -> bool:
        """Whether the model holds the same numbers now, bit by bit."""
        if model.frame_names_ != self.frame_names or model.manifold_ != self.manifold:
            return False
        for array, (shape, dtype, content) in zip(_arrays(model), self.contents, strict=True):
            if array.shape != shape or array.dtype != dtype or array.tobytes() != content:
                return False
        return True


def _arrays(model: TPGMM) -> Iterator[Array]:
    means, covariances = model.means_, model.covariances_
    yield model.priors_
    for name in model.frame_names_:
        yield means[name]
        yield covariances[name]
