# SPDX-License-Identifier: Apache-2.0
"""Perception trembles: references of every way of retrieval are as exact, and as firm, as with poses that do not."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest

from noisy_poses import SECOND, Noise, Own, away, frames_of, lengths, rms, run, seen_at
from reaching import place, reaching_demonstrations
from tpgmm_core import TPGMM
from tpgmm_core.quaternion import Array
from tpgmm_core.retrieval.recipe import Recipe
from tpgmm_core.retrieval.ways import WAYS, make_retrieval
from worlds import planar_demonstrations

STEP = 0.005
PLACES: dict[str, dict[str, Array]] = {
    "planar": {"start": np.array([-0.1, 0.3, 0.4]), "goal": np.array([1.2, -0.4, -0.6])},
    "poses": {"start": place(0.02, -0.03, 0.2), "object": place(0.5, 0.02, -0.2)},
}
STARTS = {"planar": np.array([-0.1, 0.3]), "poses": PLACES["poses"]["start"]}


@cache
def learned(way: str, what: str) -> TPGMM:
    recipe = Recipe.of({"n_components": 4, "reg_covar": 1e-5, "retrieval": way})
    if what == "planar":
        return recipe.learn(planar_demonstrations(), "R1 x R2")
    return recipe.learn(reaching_demonstrations(20), "R1 x R3 x S3")


@cache
def own(way: str, what: str, noise: Noise) -> Own:
    return Own.of(learned(way, what), way, PLACES[what], noise, STARTS[what], STEP, 16)


@pytest.mark.parametrize("what", PLACES)
@pytest.mark.parametrize("way", WAYS)
def test_equal_situations_have_equal_references_whatever_objects_hold_them(way: str, what: str) -> None:
    """Bit by bit: new frames with the same numbers at each step, and weights that say what is so anyway."""
    same = frames_of(PLACES[what])
    retrievals = [make_retrieval(learned(way, what), horizon_steps=2) for _ in range(2)]
    for retrieval in retrievals:
        retrieval.start(0, STARTS[what])
    robot = STARTS[what]
    for i in range(1, 300):
        time_ns, copied = round(0.008 * i * SECOND), frames_of(PLACES[what])
        weights = None if i % 2 else dict.fromkeys(copied, 1.0)
        one = retrievals[0].step(time_ns, same, robot)
        other = retrievals[1].step(time_ns, dict(reversed(copied.items())), robot.copy(), weights)
        assert one.phase == other.phase
        np.testing.assert_array_equal(one.activations, other.activations)
        for g, h in zip((one.gaussian, *one.horizon), (other.gaussian, *other.horizon), strict=True):
            np.testing.assert_array_equal(g.mean, h.mean)
            np.testing.assert_array_equal(g.covariance, h.covariance)
        robot = one.gaussian.mean


@pytest.mark.parametrize("way", WAYS)
def test_a_mapping_that_is_written_to_is_another_situation(way: str) -> None:
    """The same object is not the same situation: what moved in place is followed."""
    model, places = learned(way, "planar"), PLACES["planar"]
    moved = places | {"goal": places["goal"] + [0.1, 0.1, 0.0]}
    retrieval = make_retrieval(model)
    retrieval.start(0, STARTS["planar"])
    frames, robot = frames_of(places), STARTS["planar"]
    for i in range(1, 800):
        if i == 100:
            frames.update(frames_of(moved))
        robot = retrieval.step(round(0.005 * i * SECOND), frames, robot).gaussian.mean
    fresh = run(model, way, lambda _: frames_of(moved), STARTS["planar"], 0.005, settle=2.0)
    assert np.linalg.norm(robot - fresh.means[-1]) < 0.01


@pytest.mark.parametrize("noise", [Noise(0.1), Noise(0.5), Noise(2.0)], ids=["0.1mm", "0.5mm", "2mm"])
@pytest.mark.parametrize("what", PLACES)
@pytest.mark.parametrize("way", WAYS)
def test_noise_of_poses_makes_references_neither_soft_nor_stiff_nor_restless(way: str, what: str, noise: Noise) -> None:
    expected = own(way, what, noise)
    low, high = expected.band(STEP)
    spread = lengths(expected.exact.manifold, expected.spread())
    for rate in (30.0, 100.0):
        found = run(learned(way, what), way, seen_at(PLACES[what], noise, rate, 5), STARTS[what], STEP)
        assert np.all(found.deviations > low) and np.all(found.deviations < high), rate
        jitter = lengths(expected.exact.manifold, rms(away(expected.exact, found)))
        assert jitter[0] <= spread[0] and jitter[1] <= spread[1], (rate, jitter, spread)
        assert found.phases[-1] == pytest.approx(expected.exact.phases[-1], abs=1e-3)


@pytest.mark.parametrize("way", WAYS)
def test_noise_that_is_new_in_each_step_is_smoothed(way: str) -> None:
    """Poses and references at 1 kHz: a share of what one exact look would be off by."""
    noise, model, places, step = Noise(2.0), learned(way, "planar"), PLACES["planar"], 0.001
    exact = run(model, way, lambda _: frames_of(places), STARTS["planar"], step)
    found = run(model, way, seen_at(places, noise, 1000.0, 5), STARTS["planar"], step)
    expected = own(way, "planar", noise)
    jitter = lengths(exact.manifold, rms(away(exact, found)))[0]
    assert jitter <= lengths(exact.manifold, expected.spread())[0]
    ratio = found.deviations / exact.deviations
    assert np.mean((ratio < 1.1) & (ratio > 1.0 / 1.1)) > 0.97 and ratio.max() < 1.6 and ratio.min() > 0.7
