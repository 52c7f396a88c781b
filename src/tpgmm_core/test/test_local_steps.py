# SPDX-License-Identifier: Apache-2.0
"""Demonstrations of near situations say more: weights, the Gaussians that they make, and that they help."""

from __future__ import annotations

from functools import cache
from pathlib import Path

import numpy as np
import pytest

from reaching import DURATION, frames_at, place, reaching_demonstrations
from tpgmm_core import Demonstration, Frame
from tpgmm_core.common.types import Array
from tpgmm_core.geometry.manifold import POSE
from tpgmm_core.learning.local_weights import Places
from tpgmm_core.learning.promp import ProMPTPGMM
from tpgmm_core.learning.shown_to_frame import isotropic
from tpgmm_core.learning.time_steps import TimeStepTPGMM
from tpgmm_core.retrieval.local_steps import localise
from tpgmm_core.retrieval.methods import load_model
from tpgmm_core.retrieval.recipe import Recipe
from tpgmm_core.retrieval.time_steps import TimeSteps
from worlds import moved, random_world

SPACE = "R1 x R3 x S3"
STEPS = 40


@cache
def learned(kind: type[TimeStepTPGMM] = TimeStepTPGMM, locality: float = 2.0) -> TimeStepTPGMM:
    model = kind(manifold=SPACE, n_steps=STEPS, locality=locality).fit(reaching_demonstrations(8))
    model.metadata_ = {"duration_s": DURATION, "retrieval": "time_steps"}
    return model


SITUATION = frames_at(start=place(0.05, -0.02, 0.2), object=place(0.55, 0.06, -0.3))


def weights_by_hand(locality: float) -> Array:
    """Of the eight demonstrations, whose frames stand still: from where the object is, as seen from the start."""

    def seen(frames: dict[str, Frame]) -> Array:
        start, there = frames["start"], frames["object"].A[1:, 1:] @ np.eye(7)[6] + frames["object"].b[1:]
        return start.project(np.array([[0.0, *there]]))[0, 1:]

    points = np.stack([seen(dict(d.frames)) for d in reaching_demonstrations(8)])
    base = POSE.mean(points)
    z, here = POSE.log(base, points), POSE.log(base, seen(SITUATION))
    scales = np.maximum(z.std(axis=0, ddof=1), [1e-3] * 3 + [1e-2] * 3)
    w = np.exp(-0.5 * locality * np.mean(((z - here) / scales) ** 2, axis=1))
    return np.asarray(w / w.sum())


def test_a_step_is_made_of_weighted_demonstrations() -> None:
    """Mean and covariance in one frame, against the equations; at a time between two steps too."""
    movement, model = TimeSteps(learned()), learned()
    only = {"object": SITUATION["object"]}
    movement.situate(SITUATION, weights={"start": 0.0})
    grid, step, w = model.means_["object"][:, 0], 20, weights_by_hand(2.0)
    shown = [d.frames["object"].project(d.data)[:, 1:] for d in reaching_demonstrations(8)]
    times = reaching_demonstrations(8)[0].times
    points = np.stack([[np.interp(grid[step], times, column) for column in x.T] for x in shown])
    points[:, 3:] /= np.linalg.norm(points[:, 3:], axis=1, keepdims=True)
    mean = model.means_["object"][step, 1:]
    e = POSE.log(mean, points)
    shift, count = w @ e, 1.0 / np.sum(w**2)
    S = np.einsum("i,ia,ib->ab", w, e - shift, e - shift) / (1.0 - np.sum(w**2))
    B = isotropic(POSE, np.cov(POSE.log(mean, points), rowvar=False))
    nu = 3.0 * (count - 1.0)
    R = (1.0 + 1.0 / count) * nu / max(nu - 2.0, 1.0) * ((count - 1.0) * S + 10.0 * B) / (count + 9.0)
    data = Frame(only["object"].A[1:, 1:], only["object"].b[1:])
    turn = POSE.tangent_map(data.A)
    means, covariances, _ = movement.at(grid[[step]])
    np.testing.assert_allclose(means[0], data.A @ POSE.exp(mean, shift) + data.b, atol=2e-3)
    np.testing.assert_allclose(covariances[0], turn @ (R + 1e-6 * np.eye(6)) @ turn.T, rtol=0.1, atol=2e-6)


def test_near_demonstrations_count_more_and_with_a_large_locality_the_nearest_alone() -> None:
    movement = TimeSteps(learned(locality=1e6))
    for i, shown in enumerate(reaching_demonstrations(8)):
        movement.situate(shown.frames)
        assert movement._local is not None and movement._local.weights(10)[i] == pytest.approx(1.0)
        assert np.abs(POSE.log(movement.at(shown.times)[0], shown.data[:, 1:]))[:, :3].max() < 0.02


@pytest.mark.parametrize("kind", [TimeStepTPGMM, ProMPTPGMM])
def test_a_small_locality_changes_little_and_continuously(kind: type[TimeStepTPGMM]) -> None:
    times = np.linspace(0.0, DURATION, 50)
    found = []
    for locality in (0.0, 1e-9):
        movement = TimeSteps(learned(kind, locality))
        movement.situate(SITUATION)
        found.append(movement.at(times))
    np.testing.assert_allclose(POSE.log(found[0][0], found[1][0]), 0.0, atol=1e-4)
    np.testing.assert_allclose(found[0][1], found[1][1], rtol=1e-3, atol=1e-8)


def test_what_depends_on_the_situation_in_no_simple_way_is_done_as_in_near_situations() -> None:
    """The hand lifts the higher, the farther it goes: no frame explains that."""

    def lift(far: float) -> Demonstration:
        u = np.linspace(0.0, 1.0, 60)
        path = np.column_stack([far * u, 4.0 * u * (1.0 - u) * far**2])
        frames = {"start": Frame(np.eye(2), np.zeros(2)), "goal": Frame(np.eye(2), [far, 0.0])}
        return Demonstration(u, np.column_stack([u, path]), {name: frame.with_time() for name, frame in frames.items()})

    shown = [lift(far) for far in np.linspace(0.5, 1.5, 9)]
    errors = {}
    for locality in (0.0, 30.0):
        movement, new = TimeSteps(TimeStepTPGMM(manifold="R1 x R2", locality=locality).fit(shown)), lift(1.33)
        movement.situate(new.frames)
        errors[locality] = np.abs(movement.at(new.times)[0] - new.data[:, 1:]).max()
    assert errors[30.0] < 0.2 * errors[0.0]


@pytest.mark.parametrize("kind", [TimeStepTPGMM, ProMPTPGMM])
def test_the_origin_of_the_world_does_not_matter(kind: type[TimeStepTPGMM]) -> None:
    rng, times = np.random.default_rng(3), np.linspace(0.0, DURATION, 20)
    movement = TimeSteps(learned(kind))
    movement.situate(SITUATION)
    means, covariances, _ = movement.at(times)
    world = random_world(7, rng)
    movement.situate(moved(world, SITUATION))
    there, wider, _ = movement.at(times)
    turn = POSE.tangent_map(world.A)
    np.testing.assert_allclose(POSE.log(means @ world.A.T + world.b, there), 0.0, atol=1e-9)
    np.testing.assert_allclose(turn @ covariances @ turn.T, wider, rtol=1e-7, atol=1e-12)


def test_a_frame_that_is_not_known_is_not_compared() -> None:
    movement = TimeSteps(learned())
    movement.situate({"object": SITUATION["object"]})
    assert movement._local is not None
    np.testing.assert_allclose(movement._local.weights(5), 1.0 / 8.0)
    assert np.isnan(Places(POSE, ("start", "object"), np.eye(7)[[6]])({"start": SITUATION["start"]})).all()


def test_demonstrations_are_saved_with_the_model(tmp_path: Path) -> None:
    learned().save(tmp_path / "model.tpgmm")
    loaded = load_model(tmp_path / "model.tpgmm")
    one, other = TimeSteps(learned()), TimeSteps(loaded)
    for movement in (one, other):
        movement.situate(SITUATION)
    np.testing.assert_array_equal(one.at(np.array([0.7]))[0], other.at(np.array([0.7]))[0])
    assert learned(locality=0.0).shown_ is None


def test_no_step_waits_for_the_compiler() -> None:
    movement = TimeSteps(learned())
    compiled = list(localise.signatures)
    movement.situate(SITUATION, weights={"start": 0.5})
    movement.at(0.005 * np.arange(3))
    assert compiled and list(localise.signatures) == compiled


def test_a_locality_that_cannot_be_or_means_nothing_is_refused() -> None:
    with pytest.raises(ValueError, match="locality is a finite number from 0, got -1"):
        TimeStepTPGMM(locality=-1.0).fit(reaching_demonstrations(3))
    with pytest.raises(ValueError, match="unknown settings locality of gaussian_process"):
        Recipe.of({"locality": 1.0}, method="gaussian_process")
    recipe = Recipe.of({"retrieval": "promp", "locality": 1.0, "n_components": 5})
    assert recipe.arguments["locality"] == 1.0
