# SPDX-License-Identifier: Apache-2.0
"""What novelty was for demonstrations that a model of the others had not seen: what `NoveltyScale` holds against."""

from __future__ import annotations

from collections.abc import Sequence

from tpgmm_core.choice.reproducing import as_seen_by
from tpgmm_core.geometry.manifold import Manifold
from tpgmm_core.learning.learned_mixture import LearnedMixture
from tpgmm_core.learning.situations import first_frames
from tpgmm_core.model.demonstration import Demonstration
from tpgmm_core.retrieval.methods import make_retrieval
from tpgmm_core.retrieval.novelty import SituationRange, contradiction


def range_of(model: LearnedMixture, demonstrations: Sequence[Demonstration], manifold: Manifold) -> SituationRange:
    """Where the frames of a model were in demonstrations.

    Parameters
    ----------
    model
        of these demonstrations
    demonstrations
        over [time, data]
    manifold
        of the data, without time

    Returns
    -------
    SituationRange
        at the beginnings of the demonstrations
    """
    situations = [first_frames(as_seen_by(model, demonstration)) for demonstration in demonstrations]
    return SituationRange.of(situations, model.frame_names_, manifold)


def novelty_of(
    model: LearnedMixture, demonstrations: Sequence[Demonstration], left_out: Demonstration, manifold: Manifold
) -> tuple[float, float]:
    """How new the situation of a demonstration is to a model of others.

    Parameters
    ----------
    model
        of the others
    demonstrations
        those others
    left_out
        the one that the model has not seen
    manifold
        of the data, without time

    Returns
    -------
    tuple[float, float]
        contradiction and distance: see `tpgmm_core.retrieval.novelty`
    """
    frames = first_frames(as_seen_by(model, left_out))
    against = contradiction(make_retrieval(model, horizon_steps=0), frames, left_out.data[0, 1:])
    return against, range_of(model, demonstrations, manifold).distance(frames)
