# SPDX-License-Identifier: Apache-2.0
"""How new a situation is: contradiction of the frames, distance, and what they are held against."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest

from reaching import frames_at, place, reaching_demonstrations
from tpgmm_core import TPGMM, Frame, Gaussian
from tpgmm_core.choice.novelty import novelty_of, range_of
from tpgmm_core.geometry.manifold import POSE
from tpgmm_core.learning.situations import first_frames
from tpgmm_core.retrieval.methods import METHODS, make_retrieval
from tpgmm_core.retrieval.novelty import KEY, NoveltyScale, contradiction
from tpgmm_core.retrieval.recipe import Recipe
from worlds import moved, random_world

OVER_POSES = "R1 x R3 x S3"
STATE = place(0.02, -0.03, 0.2)
NEAR = frames_at(start=STATE, object=place(0.5, 0.02, -0.2))
FAR = frames_at(start=STATE, object=place(1.7, 0.02, -0.2))


@cache
def learned(method: str) -> TPGMM:
    recipe = Recipe.of({"n_components": 3, "reg_covar": 1e-5, "retrieval": method})
    return recipe.learn(reaching_demonstrations(), OVER_POSES)


@cache
def scale() -> NoveltyScale:
    shown = list(reaching_demonstrations(8))
    found = []
    for left_out in shown:
        others = [d for d in shown if d is not left_out]
        model = Recipe.of({"n_components": 3, "reg_covar": 1e-5}).learn(others, OVER_POSES)
        found.append(novelty_of(model, others, left_out, POSE))
    against, far = zip(*found, strict=True)
    return NoveltyScale(range_of(learned("adapt_regress"), shown, POSE), against, far)


def test_contradiction_is_what_the_product_costs_per_degree_of_freedom() -> None:
    """Two frames on R^1, one component: (b - a)^2 / (variance + variance), and nothing where they agree."""
    model = TPGMM(1, reg_covar=0.0)
    rng = np.random.default_rng(0)
    seen = {name: np.column_stack([np.linspace(0, 1, 50), rng.normal(size=50)]) for name in ("one", "other")}
    model.fit_projected(seen).metadata_ = {"duration_s": 1.0}

    def at(a: float, b: float) -> float:
        frames = {name: Frame(np.eye(1), [x]).with_time() for name, x in (("one", a), ("other", b))}
        return contradiction(make_retrieval(model), frames, np.zeros(1))

    gaussians = [Gaussian(model.means_[name][0], model.covariances_[name][0]) for name in seen]
    apart = gaussians[1].mean - gaussians[0].mean + [0.0, 3.0]
    spread = gaussians[0].covariance + gaussians[1].covariance
    assert at(1.0, 4.0) == pytest.approx(np.sqrt(apart @ np.linalg.solve(spread, apart) / 2.0), rel=1e-9)
    assert contradiction(make_retrieval(model), {"one": Frame(np.eye(1), [0.0]).with_time()}) == 0.0


@pytest.mark.parametrize("method", METHODS)
def test_for_every_method_frames_far_from_what_was_shown_contradict_each_other_more(method: str) -> None:
    retrieval = make_retrieval(learned(method))
    near, far = (contradiction(retrieval, frames, STATE) for frames in (NEAR, FAR))
    assert far > 3.0 * near > 0.0


def test_moving_the_world_is_nothing_new() -> None:
    world = random_world(7, np.random.default_rng(3))
    elsewhere = moved(world, NEAR)
    one = scale().judge(make_retrieval(learned("adapt_regress")), NEAR, STATE)
    other = scale().judge(make_retrieval(learned("adapt_regress")), elsewhere, world.A @ STATE + world.b)
    for name in ("contradiction", "distance", "score"):
        assert getattr(one, name) == pytest.approx(getattr(other, name), rel=1e-6)


def test_a_situation_like_the_demonstrated_ones_is_usual_and_one_far_away_is_not() -> None:
    retrieval = make_retrieval(learned("adapt_regress"))
    near, far = (scale().judge(retrieval, frames, STATE) for frames in (NEAR, FAR))
    assert near.score < 1.5 and near.percentile < 1.0
    assert far.score > 3.0 and far.percentile == 1.0 and "more than for 100%" in str(far)


def test_what_never_varied_counts_as_soon_as_it_does() -> None:
    """All demonstrations lie at one height."""
    up = frames_at(start=STATE, object=place(0.5, 0.02, -0.2) + [0.0, 0.0, 0.3, 0.0, 0.0, 0.0, 0.0])
    assert scale().range.distance(up) > 50.0 > 5.0 > scale().range.distance(NEAR)


def test_a_model_keeps_the_scale_and_one_without_it_says_so() -> None:
    model = learned("adapt_regress")
    assert NoveltyScale.of_model(model) is None
    copy = TPGMM()
    copy.metadata_ = dict(scale().metadata())
    assert NoveltyScale.of_model(copy) == scale()
    for text in ("{}", "none", '{"range": {}, "contradictions": [], "distances": []}', 3.0):
        copy.metadata_ = {KEY: text}
        with pytest.raises(ValueError, match="train it again"):
            NoveltyScale.of_model(copy)


def test_frames_that_are_missing_are_not_judged() -> None:
    assert scale().range.distance({"object": NEAR["object"]}) == 0.0
    assert first_frames(reaching_demonstrations()[0]).keys() == NEAR.keys()
