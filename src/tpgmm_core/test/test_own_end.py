# SPDX-License-Identifier: Apache-2.0
"""The end of a movement as a Gaussian of its own: where demonstrations ended, however few components there are."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from hidden_world import SITUATION
from reaching import DURATION, reaching_demonstrations
from tpgmm_core import Demonstration, Frame
from tpgmm_core.choice.reproducing import reproduce_gaussians
from tpgmm_core.geometry import quaternion
from tpgmm_core.geometry.manifold import POSE, Manifold
from tpgmm_core.learning.learned_mixture import LearnedMixture
from tpgmm_core.retrieval.methods import METHODS, load_model, make_retrieval
from tpgmm_core.retrieval.own_end import KEY, end_of
from tpgmm_core.retrieval.recipe import Recipe

SPACE = Manifold.parse("R1 x R3 x S3")
ENDING = [name for name, method in METHODS.items() if method.may_own_end]
SHOWN = reaching_demonstrations(8)


def learned(method: str, own_end: bool = True, shown: list[Demonstration] = SHOWN, **more: object) -> LearnedMixture:
    settings = {"n_components": 3, "reg_covar": 1e-6, "retrieval": method, KEY: own_end, **more}
    return Recipe.of(settings).learn(shown, SPACE)


def last(model: LearnedMixture, situation: Demonstration) -> tuple[np.ndarray, np.ndarray]:
    means, covariances = reproduce_gaussians(model, situation, settle=1.0)
    return means[-1], covariances[-1]


def test_all_methods_end_in_a_gaussian_of_the_ends_or_in_one_of_the_last_step_or_may() -> None:
    assert ENDING == ["adapt_regress", "regress_product", "trajectory", "semi_markov"]
    for method in METHODS.keys() - set(ENDING):
        assert not Recipe.of({KEY: True}, method).own_end


@pytest.mark.parametrize("method", ENDING)
def test_with_few_components_a_movement_ends_where_the_left_out_demonstration_did(method: str, tmp_path: Path) -> None:
    left_out, others = SHOWN[0], SHOWN[1:]
    there = left_out.frames["object"].b[1:4]  # which a hand that trembles met by some millimetres
    plain, own = learned(method, False, others), learned(method, True, others)
    own.save(tmp_path / "model")
    own = load_model(tmp_path / "model")
    off = [float(np.linalg.norm(last(model, left_out)[0][:3] - there)) for model in (plain, own)]
    assert off[1] < min(0.003, off[0])
    # the first half of the movement is as it was
    T = len(left_out.times)
    half = [reproduce_gaussians(model, left_out)[0][: T // 2] for model in (plain, own)]
    np.testing.assert_allclose(half[0][:, :3], half[1][:, :3], atol=1e-3)


@pytest.mark.parametrize("method", ["adapt_regress", "regress_product", "trajectory"])
def test_the_end_is_as_certain_as_the_demonstrations_agree_on_it(method: str) -> None:
    """Ends that differ by 5 cm in one direction, as every frame sees them, and agree in the others."""
    rng, shown = np.random.default_rng(0), []
    for item in SHOWN:
        data = item.data.copy()
        data[:, 1] += 0.05 * rng.normal() * np.clip(np.linspace(-1.0, 1.0, len(data)), 0.0, 1.0)
        shown.append(replace(item, data=data))
    _, covariance = last(learned(method, shown=shown), shown[0])
    deviations = np.sqrt(np.linalg.eigvalsh(covariance[:3, :3]))
    assert 0.02 < deviations[-1] < 0.1 and deviations[0] < 0.5 * deviations[-1]


@pytest.mark.parametrize("method", ENDING)
def test_turning_and_moving_the_world_turns_and_moves_the_end(method: str) -> None:
    model = learned(method)
    world = Frame.from_pose([2.0, -1.0, 0.5], quaternion.normalize(np.array([0.3, -0.2, 0.5, 0.8]))).with_time()
    A, b = world.A, world.b
    there = SHOWN[0]
    moved = Demonstration(
        there.times,
        there.data @ A.T + b,
        {name: Frame(A @ frame.A, frame.b @ A.T + b) for name, frame in there.frames.items()},
    )
    ends = [last(model, situation)[0] for situation in (there, moved)]
    expected = ends[0] @ A[1:, 1:].T + b[1:]
    np.testing.assert_allclose(POSE.log(ends[1], expected), 0.0, atol=1e-6)


@pytest.mark.parametrize("method", ENDING)
def test_the_end_follows_a_frame_that_moves_late(method: str) -> None:
    model = learned(method)
    movement = make_retrieval(model, horizon_steps=2, horizon_time_step=0.01)
    movement.start(0, SHOWN[0].data[0, 1:])
    frames, pose, step = dict(SITUATION), SHOWN[0].data[0, 1:], round(1e7)
    for i in range(1, round(3.0 * DURATION * 100)):
        if i == round(DURATION * 95):
            there = frames["object"]
            frames["object"] = Frame(there.A, there.b + np.array([0.0, 0.1, 0.0, 0.0, *np.zeros(4)]))
        reference = movement.step(i * step, frames, pose)
        pose = reference.gaussian.mean
    end = end_of(model, POSE)
    assert end is not None
    expected = end.adapt(frames).means[0, 1:]
    np.testing.assert_allclose(POSE.log(pose, expected), 0.0, atol=2e-3)


def test_metadata_that_are_no_end_are_refused() -> None:
    model = learned("adapt_regress")
    model.metadata_[f"{KEY}.object"] = "1 2 3"
    with pytest.raises(
        ValueError, match=r"own_end.object of a model is 7 numbers of a point and 6 x 6 .* train it again"
    ):
        make_retrieval(model)


def test_where_it_cannot_be_learned_it_is_refused() -> None:
    with pytest.raises(ValueError, match="own_end takes the ends of all demonstrations at once"):
        Recipe.of({KEY: True}).learn_parts([SHOWN], SPACE)
    with pytest.raises(ValueError, match="own_end is true or false, got 3"):
        Recipe.of({KEY: 3})
