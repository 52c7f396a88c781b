# SPDX-License-Identifier: Apache-2.0
"""DP-means over all frames jointly, and its subspace version: hard clusters whose number, and dimension, are found.

Small-variance asymptotics of a Dirichlet process mixture of Gaussians (Kulis and Jordan, ICML 2012), and of one
of probabilistic principal component analyzers (Wang and Zhu, IJCAI 2015).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Self

import numpy as np
from numpy.typing import ArrayLike, NDArray

from tpgmm_core.common.types import Array, Indices
from tpgmm_core.geometry.manifold import Manifold
from tpgmm_core.learning.estimation.initialization import Labels
from tpgmm_core.learning.estimator import Estimator
from tpgmm_core.model.demonstration import Demonstration
from tpgmm_core.model.samples import Samples

ROUNDING = 1e-12  # what the cost has to fall by, relatively, for another sweep


@dataclass(eq=False, repr=False)
class DPMeans(Estimator):
    """Clusters of samples that all frames see together; as many as pay for themselves.

    With c_k, U_k the centre and the subspace (d_k dimensions, orthonormal columns) of cluster k in a frame,
    the cost is

        sum_n sum_j |(I - U_k U_k^T) (x_n - c_k)|^2  +  penalty K  +  dimension_penalty sum_k sum_j d_k

    over the frames j that saw sample n, with k its cluster. Without dimension_penalty all d_k are 0: DP-means.
    Coordinates are scaled to unit variance per dimension, since seconds, metres and radians do not compare,
    and S³ is seen in the tangent space at the mean of its samples; so both penalties are pure numbers. The
    search starts from one cluster without dimensions, adds clusters until all samples are near one, and then
    lets subspaces grow and absorb neighbours. Library only: no program finds such clusters.

    Parameters
    ----------
    penalty
        of a cluster, lambda of Kulis and Jordan. A sample farther than its root from all clusters makes its own
    dimension_penalty
        of a dimension of a cluster's subspace: a dimension is worth the sum of squares along it, of all samples of the
        cluster. No subspace fills its frame, d_k < D_j. None: no subspaces
    max_iter
        most sweeps
    manifold
        space of the data, as in `TPGMM`

    Attributes
    ----------
    labels_
        shape (N,), cluster of each sample, 0 to K - 1: `TPGMM(n_components=clusters.n_components_,
        init=clusters.labels_)` starts there
    n_components_
        K
    dimensions_
        name → shape (K,), d_k
    costs_
        the cost over the sweeps, which never rises
    n_iter_, converged_
        sweeps that were made, and whether the cost stopped falling
    """

    labels_: Labels = field(init=False)
    n_components_: int = field(init=False)
    dimensions_: dict[str, Indices] = field(init=False)
    costs_: Array = field(init=False)
    n_iter_: int = field(init=False)
    converged_: bool = field(init=False)

    penalty: float = 1.0
    dimension_penalty: float | None = None
    max_iter: int = 1000
    manifold: str | Manifold = "euclidean"

    def fit(self, demonstrations: Sequence[Demonstration]) -> Self:
        """Cluster the samples of demonstrations, projected into their frames by Eq. (4).

        Parameters
        ----------
        demonstrations
            one or more, with the same frames

        Returns
        -------
        Self
            itself, fitted

        Raises
        ------
        ValueError
            like `TPGMM.fit`
        """
        self._check_parameters()
        return self._fit(Samples.from_demonstrations(demonstrations, self.manifold))

    def fit_projected(self, X: Mapping[str, ArrayLike], visible: Mapping[str, ArrayLike] | None = None) -> Self:
        """Cluster data that was already observed from each frame: see `TPGMM.fit_projected`."""
        self._check_parameters()
        return self._fit(Samples.from_projected(X, visible, self.manifold))

    @staticmethod
    def suggested_penalty(
        n_components: int, demonstrations: Sequence[Demonstration], manifold: str | Manifold = "euclidean"
    ) -> float:
        """A penalty for about `n_components` clusters (Kulis and Jordan 2012, Section 5).

        As many samples are chosen one after the other, each the farthest from those before. The penalty is the squared
        distance of the sample that is then the farthest from them.

        Parameters
        ----------
        n_components
            the number of clusters that is wanted
        demonstrations, manifold
            as for `fit` and the constructor

        Returns
        -------
        float
            squared distance

        Raises
        ------
        ValueError
            for a number of components below 1
        """
        if n_components < 1:
            raise ValueError(f"n_components is an integer from 1, got {n_components}")
        views = _views(Samples.from_demonstrations(demonstrations, manifold))
        nearest = _distances(views, [_Flat.fit(view, np.inf) for view in views])
        for _ in range(n_components):
            farthest = np.argmax(nearest)
            nearest = np.minimum(nearest, _distances(views, [_Flat.point(view.x[farthest]) for view in views]))
        return float(nearest.max())

    def _check_parameters(self) -> None:
        self._check_numbers(
            "penalty", *([] if self.dimension_penalty is None else ["dimension_penalty"]), positive=True
        )
        self._check_integers("max_iter")

    def _fit(self, samples: Samples) -> Self:
        """Make sweeps of steps none of which raises the cost.

        The steps: start a cluster at the sample that is farthest from all, drop one that does not pay, assign every
        sample to the nearest, fit centres and subspaces.
        """
        views = _views(samples)
        dimension_penalty = np.inf if self.dimension_penalty is None else float(self.dimension_penalty)
        threshold = np.inf  # subspaces grow when there are clusters for them: a single one would take all dimensions
        labels: Labels = np.zeros(samples.n_samples, dtype=np.intp)
        flats = [[_Flat.fit(view, threshold) for view in views]]
        distances = _distances(views, flats[0])[:, None]
        costs = [self._cost(distances[:, 0], flats, dimension_penalty)]
        self.converged_ = False
        for _ in range(self.max_iter):
            farthest = int(np.argmax(distances.min(axis=1)))
            if distances[farthest].min() > self.penalty:
                flats.append([_Flat.point(view.x[farthest]) for view in views])
                distances = np.column_stack([distances, _distances(views, flats[-1])])
            labels = np.argmin(distances, axis=1)
            labels = self._without_the_least(labels, distances, flats, dimension_penalty)
            used, labels = np.unique(labels, return_inverse=True)
            flats = [
                [_Flat.fit(view.of(labels == k), threshold, flat) for view, flat in zip(views, flats[old], strict=True)]
                for k, old in enumerate(used)
            ]
            distances = np.column_stack([_distances(views, flat) for flat in flats])
            costs.append(self._cost(distances[np.arange(len(labels)), labels], flats, dimension_penalty))
            if costs[-2] - costs[-1] <= ROUNDING * costs[0] and distances.min(axis=1).max() <= self.penalty:
                if threshold == dimension_penalty:
                    self.converged_ = True
                    break
                threshold = dimension_penalty
        self.labels_ = labels
        self.n_components_ = len(flats)
        self.dimensions_ = {name: np.array([flat[j].dim for flat in flats]) for j, name in enumerate(samples.X)}
        self.costs_ = np.array(costs)
        self.n_iter_ = len(costs) - 1
        return self

    def _cost(self, distances: Array, flats: Sequence[Sequence[_Flat]], dimension_penalty: float) -> float:
        return float(distances.sum()) + sum(self._price(flat, dimension_penalty) for flat in flats)

    def _price(self, flats: Sequence[_Flat], dimension_penalty: float) -> float:
        """Cost of one cluster: its own, and that of its dimensions in all frames."""
        dims = sum(flat.dim for flat in flats)
        return self.penalty + (dimension_penalty * dims if dims else 0.0)

    def _without_the_least(
        self, labels: Labels, distances: Array, flats: Sequence[Sequence[_Flat]], dimension_penalty: float
    ) -> Labels:
        """Labels without the cluster that costs most beyond what its samples would cost as members of others."""
        if distances.shape[1] == 1:
            return labels
        nearest_two = np.argpartition(distances, 1, axis=1)[:, :2]
        rows = np.arange(len(labels))[:, None]
        gain = distances[rows, nearest_two].max(axis=1) - distances.min(axis=1)
        gains = np.bincount(labels, gain, minlength=len(flats))
        surplus = np.array([self._price(flat, dimension_penalty) for flat in flats]) - gains
        worst = int(np.argmax(surplus))
        if surplus[worst] <= 0.0:
            return labels
        others = distances.copy()
        others[:, worst] = np.inf
        return np.argmin(others, axis=1)


@dataclass(frozen=True, slots=True, eq=False)
class _FrameView:
    """What one frame saw, scaled: x (N, n), and which samples (N,) it saw."""

    x: Array
    seen: NDArray[np.bool_]

    def of(self, chosen: NDArray[np.bool_]) -> _FrameView:
        return _FrameView(self.x[chosen], self.seen[chosen])


@dataclass(frozen=True, slots=True, eq=False)
class _Flat:
    """Centre (n,) and basis (n, d) of an affine subspace."""

    centre: Array
    basis: Array

    @property
    def dim(self) -> int:
        return self.basis.shape[1]

    @classmethod
    def point(cls, centre: Array) -> _Flat:
        return cls(centre, np.zeros((len(centre), 0)))

    @classmethod
    def fit(cls, view: _FrameView, dimension_penalty: float, former: _Flat | None = None) -> _Flat:
        """The cheapest subspace: principal directions along which the squares sum to more than the penalty are kept."""
        x = view.x[view.seen]
        if len(x) == 0:  # this frame saw nothing of it: any subspace is right
            return cls.point(np.zeros(view.x.shape[1]) if former is None else former.centre)
        centre = x.mean(axis=0)
        if not np.isfinite(dimension_penalty):
            return cls.point(centre)
        squares, directions = np.linalg.eigh((x - centre).T @ (x - centre))
        return cls(centre, directions[:, 1:][:, squares[1:] > dimension_penalty])


def _views(samples: Samples) -> list[_FrameView]:
    views = []
    for (name, manifold), seen in zip(samples.manifolds.items(), samples.seen, strict=True):
        x = manifold.log(manifold.mean(samples.X[name][seen]), samples.X[name])
        spread = x[seen].std(axis=0)
        views.append(_FrameView(x / np.where(spread > 0.0, spread, 1.0), seen))
    return views


def _distances(views: Sequence[_FrameView], flats: Sequence[_Flat]) -> Array:
    """Squared distances (N,) of the samples to a cluster, over the frames that saw them."""
    total = np.zeros(len(views[0].x))
    for view, flat in zip(views, flats, strict=True):
        d = view.x - flat.centre
        squares = np.einsum("ni,ni->n", d, d)
        if flat.dim:
            along = d @ flat.basis
            squares = np.maximum(squares - np.einsum("ni,ni->n", along, along), 0.0)
        total += np.where(view.seen, squares, 0.0)
    return total
