# SPDX-License-Identifier: Apache-2.0
"""The inverse optimal control reading of a model (Section 5): each frame is a sub-objective, with learned weights.

A reproduction minimises Eq. (3), the sum over the frames of `(xi - xi_j)^T Lambda_j (xi - xi_j)` at each time. The
precisions Lambda_j were learned: they say how much each frame mattered in the demonstrations, when, and in which
directions. With Sigma the covariance of the product, the matrices `Sigma^(1/2) Lambda_j Sigma^(1/2)` add up to the
identity, whatever the units: their diagonals are the shares of the frames in the objective.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from tpgmm_core.common.types import Array
from tpgmm_core.geometry.frame import Frame
from tpgmm_core.geometry.kernels_terms import add_term, scratch_for
from tpgmm_core.learning.learned_mixture import LearnedMixture
from tpgmm_core.retrieval.regression import RegressThenProduct


@dataclass(frozen=True, slots=True)
class SubObjectives:
    """The objectives of P frames for a movement at T times, on n tangent dimensions.

    Parameters
    ----------
    frames
        names, in the order of the axes P
    means
        (T, D), the movement: where the sum of all is least
    covariances
        (T, n, n), of the movement, in the tangent spaces at the means
    precisions
        (T, P, n, n), Lambda_j at the movement, in the unit of the data to the power of -2
    shares
        (T, P, n), of each frame in the objective along each dimension: 0 to 1, the sum over the frames is 1
    costs
        (T, P), what remains of each sub-objective: how far the frames contradict each other, in variances
    """

    frames: tuple[str, ...]
    means: Array
    covariances: Array
    precisions: Array
    shares: Array
    costs: Array

    def weights(self, dimensions: slice | list[int] = slice(None)) -> Array:
        """Shares of the frames, averaged over tangent dimensions (positions, say, or rotations): (T, P)."""
        return np.asarray(self.shares[..., dimensions].mean(axis=-1))


def sub_objectives(model: LearnedMixture, times: ArrayLike, frames: Mapping[str, Frame]) -> SubObjectives:
    """The sub-objectives of a model's frames in one situation.

    Parameters
    ----------
    model
        with time as the first dimension
    times
        (T,), of the model
    frames
        over [time, data], one or more

    Returns
    -------
    SubObjectives
        of each frame, at all times

    Raises
    ------
    ValueError
        like `RegressThenProduct` and its `retrieve`
    """
    retrieval = RegressThenProduct(model)
    movement = retrieval.retrieve(frames, times)
    manifold = movement[0].manifold
    layout = manifold.ambient_of_tangent, manifold.sphere_starts
    T, P, n = len(movement), len(frames), manifold.tangent_dim
    precisions, costs = np.zeros((T, P, n, n)), np.empty((T, P))
    for j, (name, frame) in enumerate(frames.items()):
        for t, wanted in enumerate(retrieval.retrieve({name: frame}, times)):
            scratch, gradient = scratch_for(n), np.zeros(n)
            costs[t, j] = 2.0 * add_term(
                movement[t].mean, wanted.mean, wanted.precision, *layout, scratch, gradient, precisions[t, j]
            )
    covariances = np.stack([g.covariance for g in movement])
    values, vectors = np.linalg.eigh(precisions.sum(axis=1))
    root = (vectors / np.sqrt(values)[:, None, :]) @ np.swapaxes(vectors, 1, 2)
    shares = np.einsum("tik,tpkl,tli->tpi", root, precisions, root)
    return SubObjectives(tuple(frames), np.stack([g.mean for g in movement]), covariances, precisions, shares, costs)


def quadratic_costs(model: LearnedMixture, times: ArrayLike) -> dict[str, Any]:
    """The learned weights as terms of a cost, Eq. (3), with which a solver of somebody else can begin.

    At each time the cost of a state x is the sum over the frames of `e^T W e`, e = log(x_j) at the frame's target:
    x_j is x as the frame sees it, W the frame's precision; on R^D, e is x_j - target. All is in the axes of the frames,
    so that the same terms hold in every situation: frames are put where the objects are. The mean of the movement is
    where the sum is least.

    Parameters
    ----------
    model
        with time as the first dimension
    times
        (T,), of the model, s

    Returns
    -------
    dict[str, Any]
        as JSON can hold it: `manifold` of x; `dimensions`, its coordinates, where the model names them; `times`;
        `frames`: name → `targets` (T, D) and `precisions` (T, n, n), in the tangent spaces at the targets

    Raises
    ------
    ValueError
        for a model without time
    """
    names = tuple(model.dimensions_ or ("time",))
    if names[0] != "time":
        raise ValueError(f"costs over time need a model over time; this one is over {', '.join(names)}")
    retrieval = RegressThenProduct(model)
    at = np.asarray(times, dtype=float)
    frames = {}
    for name in model.frame_names_:
        D = model.means_[name].shape[1]
        wanted = retrieval.retrieve({name: Frame(np.eye(D), np.zeros(D))}, at)
        frames[name] = {
            "targets": [one.mean.tolist() for one in wanted],
            "precisions": [one.precision.tolist() for one in wanted],
        }
    return {
        "cost": "at each time the sum over the frames of e^T precision e, e = log(x as the frame sees it) at target",
        "manifold": str(retrieval.manifold),
        "dimensions": list(names[1:]),
        "times": at.tolist(),
        "frames": frames,
    }
