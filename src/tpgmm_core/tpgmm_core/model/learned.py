# SPDX-License-Identifier: Apache-2.0
"""`Learned`: the numbers of a model at one moment, to tell whether what was prepared from them still holds."""

from __future__ import annotations

from tpgmm_core.model.fitted import FittedModel


class Learned:
    """A copy of what a model learned: its frames, space, priors, means and covariances.

    Comparing takes a few microseconds, in proportion to the size of the model, and sees every change: another fit,
    attributes set by hand, and arrays changed in place.

    Parameters
    ----------
    model
        whose numbers are copied
    """

    __slots__ = ("frame_names", "manifold", "contents")

    def __init__(self, model: FittedModel) -> None:
        self.frame_names, self.manifold = model.frame_names_, model.manifold_
        self.contents = _contents(model)

    def is_of(self, model: FittedModel) -> bool:
        """Whether the model holds the same numbers now, bit by bit."""
        if model.manifold_ is not self.manifold and model.manifold_ != self.manifold:
            return False
        return model.frame_names_ == self.frame_names and _contents(model) == self.contents


def _contents(model: FittedModel) -> list[bytes]:
    """Priors, means and covariances. In a sound model their shapes follow from the number of priors and of bytes."""
    means, covariances = model.means_, model.covariances_
    contents = [model.priors_.tobytes()]
    for name in model.frame_names_:
        contents.append(means[name].tobytes())
        contents.append(covariances[name].tobytes())
    return contents
