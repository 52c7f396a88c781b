# SPDX-License-Identifier: Apache-2.0
"""Which frames count in which segment of a movement: where a frame predicts badly, the product is made without it.

Each component of a mixture over time is a segment. With e_j(s) the error with which frame j alone predicts
demonstrations that are left out, at a share s of the time (`learning/frame_screen.py`), and h_k(s) how active component
k is then, the relevance of frame j in segment k is its precision there over that of the best frame:

    r_jk = min_i e_ik^2 / e_jk^2,   e_jk^2 = sum_s h_k(s) e_j(s)^2 / sum_s h_k(s).

Of few demonstrations, some direction of a frame agrees by chance, and EM takes the frame for certain of it. Where r_jk
is too small the frame is left out: to its covariance there, WIDER times that of all that it saw is added, the same in
all directions of a place, and in those of a turn. In the product (Eq. 6) it then has next to no weight. It is not
without any, so that regression goes on without a jump, and so that it still says roughly where the hand is as long as
the frames that count there are not seen.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tpgmm_core.common.text import shown
from tpgmm_core.common.types import Array
from tpgmm_core.geometry.manifold import Manifold
from tpgmm_core.geometry.mixture import GaussianMixture
from tpgmm_core.learning.estimation.initialization import moments
from tpgmm_core.learning.frame_screen import SHARES, screen_frames
from tpgmm_core.learning.learned_mixture import LearnedMixture
from tpgmm_core.learning.shown_to_frame import isotropic
from tpgmm_core.model.demonstration import Demonstration
from tpgmm_core.model.samples import Samples
from tpgmm_core.retrieval.encodings import encoding_of

KEY = "prune"
"""Key in metadata and settings: the relevance below which a frame is left out of a segment."""
SPACES = ("R1 x R3", "R1 x R3 x S3")
"""Of demonstrations whose frames can be compared."""
WIDER = 4.0
"""How much less certain a frame is where it is left out than of the whole movement: twice the standard deviation."""
_UNSEEN = 1e6
"""Squared error of a frame that was not seen, m^2."""


@dataclass(frozen=True, slots=True, eq=False)
class SegmentFrames:
    """Which frames count in which segment.

    Parameters
    ----------
    least
        relevance below which a frame is left out
    relevance
        name → (K,), r of the module: 1 for the best frame of each segment
    """

    least: float
    relevance: dict[str, Array]

    def is_kept(self, name: str) -> NDArray[np.bool_]:
        """Whether a frame counts in each segment, (K,)."""
        return np.asarray(self.relevance[name] >= self.least)

    def metadata(self) -> dict[str, str | float]:
        """As a model keeps it."""
        texts = {f"{KEY}.{name}": " ".join(f"{r:.4f}" for r in values) for name, values in self.relevance.items()}
        return {KEY: self.least, **texts}

    @classmethod
    def of_model(cls, model: LearnedMixture) -> SegmentFrames | None:
        """Read what a model keeps.

        Parameters
        ----------
        model
            with metadata

        Returns
        -------
        SegmentFrames | None
            None where all frames count everywhere

        Raises
        ------
        ValueError
            for metadata that are no relevances
        """
        if KEY not in model.metadata_:
            return None
        relevance = {}
        for name in model.frame_names_:
            text = model.metadata_.get(f"{KEY}.{name}")
            try:
                relevance[name] = np.array([float(word) for word in str(text).split()])
            except ValueError:
                relevance[name] = np.zeros(0)
            if relevance[name].shape != model.priors_.shape:
                raise ValueError(
                    f"{KEY}.{name} of a model is a number for each of {len(model.priors_)} components, got "
                    f"{shown(text)}: train it again"
                )
        return cls(float(model.metadata_[KEY]), relevance)


def activations(model: LearnedMixture, shares: Array) -> Array:
    """How active each component of a model over time is, at shares of the movement.

    Parameters
    ----------
    model
        of [time, data], or of another input that time leads through
    shares
        (S,), 0 to 1

    Returns
    -------
    Array
        (K, S), which adds up to 1 over the components

    Raises
    ------
    ValueError
        for a model without time
    """
    inputs = encoding_of(model).inputs(shares, float(model.metadata_.get("duration_s", 1.0)))
    name = model.frame_names_[0]
    mixture = GaussianMixture(model.priors_, model.means_[name][:, :1], model.covariances_[name][:, :1, :1])
    return mixture.responsibilities([0], inputs[:, None])


def prune(
    model: LearnedMixture,
    demonstrations: Sequence[Demonstration],
    encoded: Sequence[Demonstration],
    space: Manifold,
    least: float,
) -> None:
    """Leave frames out of the segments in which they predict badly; the model's covariances and metadata say so then.

    Parameters
    ----------
    model
        that was learned from the demonstrations
    demonstrations
        over [time, position] or [time, pose], two or more
    encoded
        as the model encodes them
    space
        of the demonstrations' data
    least
        relevance below which a frame is left out, 0 to 1

    Raises
    ------
    ValueError
        for other spaces, and a single demonstration
    """
    if str(space) not in SPACES:
        raise ValueError(f"{KEY} compares frames of positions and poses, {' or '.join(SPACES)}, not {space}")
    names = model.frame_names_
    squares = np.minimum(screen_frames(demonstrations, names).mean_errors ** 2, _UNSEEN) + 1e-12
    active = activations(model, np.linspace(0.0, 1.0, SHARES))
    errors = squares @ active.T / active.sum(axis=1)  # (P, K)
    found = SegmentFrames(least, dict(zip(names, errors.min(axis=0) / errors, strict=True)))
    samples = Samples.from_demonstrations(encoded, model.manifold_)
    everything = np.zeros(samples.n_samples, dtype=np.intp)
    data = space.subset(range(1, space.dim))
    n, orders = data.tangent_dim, (model.manifold_.tangent_dim - 1) // data.tangent_dim
    for name, seen in zip(names, samples.seen, strict=True):
        manifold = samples.manifolds[name]
        (spread,) = moments(manifold, samples.X[name], seen, everything, 1, 0.0)[1]
        wider = model.covariances_[name].copy()
        for order in range(orders):  # positions, velocities and accelerations each have a unit of their own
            own = slice(1 + order * n, 1 + (order + 1) * n)
            wider[~found.is_kept(name), own, own] += WIDER * isotropic(data, spread[own, own])
        model.covariances_[name] = wider
    model.metadata_ |= found.metadata()
