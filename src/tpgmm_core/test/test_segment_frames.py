# SPDX-License-Identifier: Apache-2.0
"""Frames are left out of the segments in which they predict badly, by every method with segments, and files say so."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from reaching import frames_at, place, reaching_demonstrations
from tpgmm_core import Demonstration, LearnedMixture
from tpgmm_core.choice.automatic import positions_alone
from tpgmm_core.choice.reproducing import reproduce
from tpgmm_core.choice.trial import Trial
from tpgmm_core.retrieval.methods import METHODS, load_model
from tpgmm_core.retrieval.recipe import Recipe
from tpgmm_core.retrieval.relevance import relevance
from tpgmm_core.retrieval.segment_frames import KEY, SegmentFrames

SPACE = "R1 x R3 x S3"
SEGMENTED = [name for name, method in METHODS.items() if method.has_segments]


def with_phantom(shown: Demonstration, seed: int) -> Demonstration:
    """One more frame, anywhere."""
    random = np.random.default_rng(seed)
    anywhere = place(*random.uniform(-0.5, 0.5, 2), random.uniform(-3.0, 3.0))
    return Demonstration(shown.times, shown.data, {**shown.frames, **frames_at(phantom=anywhere)})


SHOWN = [with_phantom(shown, seed) for seed, shown in enumerate(reaching_demonstrations(5))]


def learned(method: str, prune: float) -> LearnedMixture:
    settings = {"n_components": 5, "covariance": "diag", "reg_covar": 1e-4, KEY: prune}
    return Recipe.of(settings, method).learn(SHOWN[:4], SPACE)


def influence(model: LearnedMixture) -> float:
    """How far the movement goes aside where the frame that does not matter is elsewhere, m."""
    elsewhere = with_phantom(SHOWN[4], 99)
    return float(np.linalg.norm(reproduce(model, SHOWN[4])[:, :3] - reproduce(model, elsewhere)[:, :3], axis=1).max())


@pytest.mark.parametrize("method", SEGMENTED)
def test_a_frame_that_does_not_matter_is_left_out_everywhere_and_each_that_does_where_it_does(
    method: str, tmp_path: Path
) -> None:
    whole, pruned = learned(method, 0.0), learned(method, 0.4)
    assert SegmentFrames.of_model(whole) is None
    pruned.save(tmp_path / "model")
    read = load_model(tmp_path / "model")
    found = SegmentFrames.of_model(read)
    assert found is not None and not found.is_kept("phantom").any()
    order = np.argsort(read.means_["start"][:, 0])
    first, last = (order[-1], order[0]) if method == "dmp" else (order[0], order[-1])  # its input falls with time
    for name, here, elsewhere in (("start", first, last), ("object", last, first)):
        assert found.is_kept(name)[here] and not found.is_kept(name)[elsewhere]
    assert influence(read) < 0.4 * influence(whole)
    assert relevance(read).shares["phantom"].max() < 0.1


def test_what_is_left_out_still_says_roughly_where_the_hand_is_as_long_as_nothing_else_does() -> None:
    """At the end the object counts alone; where it is not seen, the movement ends some 0.2 m from it."""
    pruned, alone = learned("adapt_regress", 0.4), Demonstration(SHOWN[4].times, SHOWN[4].data, SHOWN[4].frames)
    hidden = {"object": np.zeros(len(alone.times), dtype=bool)}
    path = reproduce(pruned, Demonstration(alone.times, alone.data, alone.frames, hidden))
    assert np.linalg.norm(path[-1, :3] - alone.data[-1, 1:4]) < 0.3


@pytest.mark.parametrize("alone", [True, False])
def test_positions_velocities_and_accelerations_are_each_widened_by_their_own_spread(alone: bool) -> None:
    """As much is added to the positions with derivatives as without: their units have nothing to do with it."""
    shown = [positions_alone(item) for item in SHOWN[:4]] if alone else SHOWN[:4]
    space, n = ("R1 x R3", 3) if alone else (SPACE, 6)
    settings = {"n_components": 5, "covariance": "diag", "reg_covar": 1e-4}
    added = {}
    for method in ("adapt_regress", "trajectory"):
        whole, pruned = (Recipe.of({**settings, KEY: least}, method).learn(shown, space) for least in (0.0, 1.0))
        added[method] = pruned.covariances_["phantom"][0] - whole.covariances_["phantom"][0]
    np.testing.assert_allclose(added["trajectory"][: 1 + n, : 1 + n], added["adapt_regress"], atol=1e-9)
    of_places = [np.diagonal(added["trajectory"])[1 + order * n :][:3] for order in range(3)]
    for variances in of_places:
        np.testing.assert_allclose(variances, variances[0])
    assert len({round(float(variances[0]), 6) for variances in of_places}) == 3


def test_a_method_without_segments_takes_no_notice_and_learning_in_parts_refuses() -> None:
    for method in METHODS.keys() - set(SEGMENTED):
        assert Recipe.of({KEY: 0.4}, method).prune == 0.0
        assert Trial.of(method, ["start"], {KEY: 0.4}).settings == {}
    with pytest.raises(ValueError, match="prune compares all demonstrations at once"):
        Recipe.of({KEY: 0.4}).check_parts()


@pytest.mark.parametrize("wrong", [-0.1, 1.5, float("nan")])
def test_a_relevance_is_a_share(wrong: float) -> None:
    with pytest.raises(ValueError, match="prune is a relevance from 0 to 1, got"):
        Recipe.of({KEY: wrong})


def test_metadata_that_are_no_relevances_are_refused() -> None:
    model = learned("adapt_regress", 0.4)
    for text in ("1 2", "nonsense", 3.0):
        model.metadata_[f"{KEY}.object"] = text
        with pytest.raises(ValueError, match=f"{KEY}.object of a model is a number for each of 5 components"):
            SegmentFrames.of_model(model)
