# SPDX-License-Identifier: Apache-2.0
"""What each frame of a model says of where the hand is, over the movement: read from the model alone, in no situation.

A frame contributes its precision Lambda_j to the product of Eq. (6). With H their sum, the trace of H^-1 Lambda_j over
the positions, divided by their number, is the share of the frame: 0 to 1, adding up to 1 over the frames (see
`retrieval/sub_objectives.py`, which reads the same in a situation). The axes of all frames count as parallel here.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from tpgmm_core.common.text import listed
from tpgmm_core.common.types import Array
from tpgmm_core.geometry.mixture import GaussianMixture
from tpgmm_core.learning.learned_mixture import LearnedMixture
from tpgmm_core.retrieval.encodings import encoding_of


@dataclass(frozen=True, slots=True, eq=False)
class Relevance:
    """Shares of the frames.

    Attributes
    ----------
    along
        what the columns are: "movement", its parts from the beginning to the end (of a cycle), or "component", those of
        a model without time, in their order
    shares
        name → (M,), from 0 to 1; of all frames together 1
    """

    along: str
    shares: dict[str, Array]


def relevance(model: LearnedMixture, parts: int = 10) -> Relevance:
    """How much each frame says of where the hand is, in each part of the movement.

    Parameters
    ----------
    model
        a fitted model whose frames see the same space, over poses, positions, or other numbers
    parts
        M, of the movement

    Returns
    -------
    Relevance
        shares of the frames

    Raises
    ------
    ValueError
        the frames see different spaces, as kinematic ones do: what each says depends on the configuration of the robot.
    """
    spaces = {str(manifold) for manifold in model.frame_manifolds_.values()}
    if len(spaces) > 1:
        raise ValueError(f"the frames see different spaces ({listed(sorted(spaces))}): shares depend on the situation")
    encoding = encoding_of(model)
    has_time = encoding.follows_time
    places, tangent = position_dimensions(model)
    if has_time:
        inputs = encoding.inputs((np.arange(parts) + 0.5) / parts, float(model.metadata_.get("duration_s", 1.0)))
        seen = {name: _over_time(model, name, places, inputs) for name in model.frame_names_}
    else:
        seen = {name: model.covariances_[name][:, tangent[:, None], tangent] for name in model.frame_names_}
    precisions = {name: np.linalg.inv(covariances) for name, covariances in seen.items()}
    total = np.sum(list(precisions.values()), axis=0)
    shares = {
        name: np.trace(np.linalg.solve(total, precision), axis1=1, axis2=2) / len(places)
        for name, precision in precisions.items()
    }
    return Relevance("movement" if has_time else "component", shares)


def position_dimensions(model: LearnedMixture) -> tuple[list[int], Array]:
    """Where a model's data hold the position: the first three Euclidean numbers that are no time and no derivative.

    Parameters
    ----------
    model
        a fitted model

    Returns
    -------
    tuple[list[int], Array]
        ambient dimensions, three or fewer, and tangent dimensions
    """
    first = 1 if encoding_of(model).follows_time else 0
    flat = [int(i) for i in model.manifold_.flat_ambient if i >= first]
    names = model.dimensions_
    if names is not None:
        flat = [i for i in flat if not names[i].startswith(("v_", "a_"))]
    return flat[:3], _tangent(model, flat[:3])


def _tangent(model: LearnedMixture, places: Sequence[int]) -> Array:
    known = dict(zip(model.manifold_.flat_ambient.tolist(), model.manifold_.flat_tangent.tolist(), strict=True))
    return np.array([known[i] for i in places])


def _over_time(model: LearnedMixture, name: str, places: Sequence[int], inputs: Array) -> Array:
    """Covariances (M, 3, 3) of the position as one frame sees it, at some inputs (M,)."""
    tangent = _tangent(model, [0, *places])
    mixture = GaussianMixture(
        model.priors_,
        np.ascontiguousarray(model.means_[name][:, [0, *places]]),
        np.ascontiguousarray(model.covariances_[name][:, tangent[:, None], tangent]),
    )
    return np.stack([mixture.condition([0], [value]).covariance for value in inputs])
