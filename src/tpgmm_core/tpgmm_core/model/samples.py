# SPDX-License-Identifier: Apache-2.0
"""`Samples`: what all frames saw of all demonstrations, stacked and checked: the input of every estimator."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Self

import numpy as np
from numpy.typing import ArrayLike, NDArray

from tpgmm_core.common.types import Array
from tpgmm_core.geometry.manifold import Manifold
from tpgmm_core.model.demonstration import Demonstration


@dataclass(frozen=True, slots=True, eq=False)
class Samples:
    """What all frames saw.

    Parameters
    ----------
    manifolds
        name → space of what the frame sees
    X
        name → shape (N, D_j), finite
    seen
        shape (P, N), whether the frame saw the sample
    times
        shape (N,), s
    lengths
        number of samples of each demonstration
    manifold
        space of the data; where not given, the largest of `manifolds`
    """

    manifolds: Mapping[str, Manifold]
    X: Mapping[str, Array]
    seen: NDArray[np.bool_]
    times: Array
    lengths: Sequence[int]
    manifold: Manifold = None  # type: ignore[assignment]  # set below

    def __post_init__(self) -> None:
        if self.manifold is None:
            object.__setattr__(self, "manifold", max(self.manifolds.values(), key=lambda m: m.dim))

    @property
    def n_samples(self) -> int:
        """N, the number of samples of all demonstrations."""
        return self.seen.shape[1]

    @classmethod
    def from_demonstrations(
        cls, demonstrations: Sequence[Demonstration], manifold: Manifold | str, *, may_be_unseen: bool = False
    ) -> Self:
        """Demonstrations, projected into their frames by Eq. (4).

        Parameters
        ----------
        demonstrations
            one or more, with the same frames
        manifold
            space of their data, or its text
        may_be_unseen
            whether a frame may be hidden all the time, as where a model is only tested

        Returns
        -------
        Self
            the samples of all demonstrations, one after the other

        Raises
        ------
        ValueError
            for demonstrations that do not agree in dimensions or frames, and for data that do not fit the manifold
        """
        demonstrations = list(demonstrations)
        if not demonstrations:
            raise ValueError("fit needs at least one demonstration")
        names = list(demonstrations[0].frames)
        D = demonstrations[0].data.shape[1]
        for i, demonstration in enumerate(demonstrations):
            if set(demonstration.frames) != set(names):
                raise ValueError(
                    f"demonstration {i} has the frames {sorted(demonstration.frames)}, 0 has {sorted(names)}"
                )
            if demonstration.data.shape[1] != D:
                raise ValueError(f"demonstration {i} has {demonstration.data.shape[1]} dimensions, 0 has {D}")
        views = [demonstration.projected() for demonstration in demonstrations]
        for name in names:
            if len({view[name].shape[1] for view in views}) > 1:
                raise ValueError(f"frame {name!r} has views of different dimensions in different demonstrations")
        X = {name: np.concatenate([view[name] for view in views]) for name in names}
        seen = np.stack([np.concatenate([d.is_visible(name) for d in demonstrations]) for name in names])
        times = np.concatenate([d.times for d in demonstrations])
        lengths = [len(d.times) for d in demonstrations]
        return cls._checked(X, seen, times, lengths, parsed(manifold, D), may_be_unseen)

    @classmethod
    def from_projected(
        cls, X: Mapping[str, ArrayLike], visible: Mapping[str, ArrayLike] | None, manifold: Manifold | str
    ) -> Self:
        """Data that were already observed from each frame, as one demonstration.

        The first dimension of the first frame is the time.

        Parameters
        ----------
        X
            name → shape (N, D_j)
        visible
            name → mask (N,), always seen where not named
        manifold
            space of the data, or its text

        Returns
        -------
        Self
            the samples

        Raises
        ------
        ValueError
            for shapes that do not fit
        """
        if not X:
            raise ValueError("fit_projected needs the data of at least one frame")
        arrays = {name: np.array(x, dtype=float) for name, x in X.items()}
        first = next(iter(arrays.values()))
        for name, x in arrays.items():
            if x.ndim != 2 or len(x) != len(first) or x.size == 0:
                raise ValueError(f"data has shape (N, D_j) with the same N > 0 in all frames, {name!r} has {x.shape}")
        masks = {name: np.asarray(mask) for name, mask in (visible or {}).items()}
        for name, mask in masks.items():
            if name not in arrays or mask.shape != (len(first),) or mask.dtype != np.bool_:
                raise ValueError(
                    f"visible is frame name → bool mask ({len(first)},), got {name!r}: {mask.dtype} {mask.shape}"
                )
        seen = np.stack([masks.get(name, np.ones(len(first), dtype=bool)) for name in arrays])
        D = max(x.shape[1] for x in arrays.values())
        return cls._checked(arrays, seen, first[:, 0], [len(first)], parsed(manifold, D))

    @classmethod
    def _checked(
        cls,
        X: dict[str, Array],
        seen: NDArray[np.bool_],
        times: Array,
        lengths: Sequence[int],
        manifold: Manifold,
        may_be_unseen: bool = False,
    ) -> Self:
        manifolds: dict[str, Manifold] = {}
        for j, (name, x) in enumerate(X.items()):
            if not seen[j].any() and not may_be_unseen:
                raise ValueError(f"frame {name!r} was never seen: leave it out")
            if not np.all(np.isfinite(x[seen[j]])):
                raise ValueError(f"the data of frame {name!r} must be finite where it is visible")
            if seen[j].any():
                x[~seen[j]] = x[seen[j]][0]  # any point of the space: its weight is zero
            manifolds[name] = view_manifold(manifold, x.shape[1])
            if x.shape[1] != manifolds[name].dim:
                raise ValueError(f"on {manifold} every frame has {manifold.dim} dimensions, {name!r} has {x.shape[1]}")
        return cls(manifolds, X, seen, times, lengths, manifold)


def parsed(manifold: Manifold | str, D: int) -> Manifold:
    """The space of data with D dimensions, read from a text such as "euclidean" where it is one."""
    return manifold if isinstance(manifold, Manifold) else Manifold.parse(manifold, D)


def view_manifold(manifold: Manifold, D_j: int) -> Manifold:
    """Space of what a frame sees: R^D_j on Euclidean data, else that of the data."""
    return Manifold.euclidean(D_j) if manifold.is_euclidean else manifold
