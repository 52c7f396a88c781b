# SPDX-License-Identifier: Apache-2.0
"""Perception trembles: references of every retrieval method are as exact, and as firm, as with poses that do not."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest

from long_tests import mostly_long
from noisy_poses import (
    SECOND,
    Noise,
    Own,
    Run,
    away,
    frames_of,
    later_or_sooner,
    lengths,
    restlessness,
    rms,
    run,
    seen_at,
)
from random_problems import random_covariance
from reaching import place, reaching_demonstrations
from tpgmm_core import TPGMM, Frame, Gaussian
from tpgmm_core.common.types import Array
from tpgmm_core.geometry.manifold import POSE, Manifold
from tpgmm_core.model.situation import Situation
from tpgmm_core.retrieval.continuity import Continuity
from tpgmm_core.retrieval.covariance_fade import CovarianceFade, lasting, multiply, relate
from tpgmm_core.retrieval.methods import METHODS, make_retrieval
from tpgmm_core.retrieval.recipe import Recipe
from worlds import planar_demonstrations

STEP = 0.01
PLACES: dict[str, dict[str, Array]] = {
    "planar": {"start": np.array([-0.1, 0.3, 0.4]), "goal": np.array([1.2, -0.4, -0.6])},
    "poses": {"start": place(0.02, -0.03, 0.2), "object": place(0.5, 0.02, -0.2)},
}
STARTS = {"planar": np.array([-0.1, 0.3]), "poses": PLACES["poses"]["start"]}


@cache
def learned(method: str, what: str) -> TPGMM:
    # What a retrieval makes of noise is measured on the covariances that were learned. Gaussians of a time
    # step need their prior: those of one sample for each demonstration are none.
    own_prior = {} if method in ("time_steps", "promp", "gaussian_process") else {"prior_strength": 0.0}
    recipe = Recipe.of({"n_components": 4, "reg_covar": 1e-5, "retrieval": method, **own_prior})
    if what == "planar":
        return recipe.learn(planar_demonstrations(), "R1 x R2")
    return recipe.learn(reaching_demonstrations(20), "R1 x R3 x S3")


@cache
def own(method: str, what: str, noise: Noise) -> Own:
    return Own.of(learned(method, what), method, PLACES[what], noise, STARTS[what], STEP, 10)


@pytest.mark.parametrize("what", PLACES)
@pytest.mark.parametrize("method", METHODS)
def test_equal_situations_have_equal_references_whatever_objects_hold_them(method: str, what: str) -> None:
    """Bit by bit: new frames with the same numbers at each step, and weights that say what is so anyway."""
    same = frames_of(PLACES[what])
    retrievals = [make_retrieval(learned(method, what), horizon_steps=2) for _ in range(2)]
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


@pytest.mark.parametrize("method", METHODS)
def test_a_mapping_that_is_written_to_is_another_situation(method: str) -> None:
    """The same object is not the same situation: what moved in place is followed."""
    model, places = learned(method, "planar"), PLACES["planar"]
    moved = places | {"goal": places["goal"] + [0.1, 0.1, 0.0]}
    retrieval = make_retrieval(model)
    retrieval.start(0, STARTS["planar"])
    frames, robot = frames_of(places), STARTS["planar"]
    for i in range(1, 800):
        if i == 100:
            frames.update(frames_of(moved))
        robot = retrieval.step(round(0.005 * i * SECOND), frames, robot).gaussian.mean
    fresh = run(model, method, lambda _: frames_of(moved), STARTS["planar"], 0.005, settle=2.0)
    assert np.linalg.norm(robot - fresh.means[-1]) < 0.01


@pytest.mark.parametrize("method", METHODS)
def test_changes_that_are_next_to_nothing_change_next_to_nothing(method: str) -> None:
    """How often a situation changes is of no account: 0.1 nm and 1e-7 deg, anew 30 times per second."""
    model, places = learned(method, "planar"), PLACES["planar"]
    exact = run(model, method, lambda _: frames_of(places), STARTS["planar"], STEP)
    found = run(model, method, seen_at(places, Noise(1e-7, 1e-7), 30.0, 5), STARTS["planar"], STEP)
    assert 0.0 < np.abs(away(exact, found)).max() < 1e-6
    np.testing.assert_allclose(found.deviations, exact.deviations, rtol=1e-5)


@pytest.mark.parametrize(
    "noise", mostly_long([Noise(0.1), Noise(0.5), Noise(2.0)], Noise(0.5)), ids=["0.1mm", "0.5mm", "2mm"]
)
@pytest.mark.parametrize("what", PLACES)
@pytest.mark.parametrize("method", METHODS)
def test_noise_of_poses_makes_references_neither_soft_nor_stiff_nor_restless(
    method: str, what: str, noise: Noise
) -> None:
    expected = own(method, what, noise)
    low, high = expected.band(STEP)
    spread = lengths(expected.exact.manifold, expected.spread())
    for rate in (30.0, 100.0):
        found = run(learned(method, what), method, seen_at(PLACES[what], noise, rate, 5), STARTS[what], STEP)
        assert np.all(found.deviations > low) and np.all(found.deviations < high), rate
        jitter = lengths(expected.exact.manifold, rms(away(expected.exact, found)))
        assert jitter[0] <= spread[0] and jitter[1] <= spread[1], (rate, jitter, spread)
        assert found.phases[-1] == pytest.approx(expected.exact.phases[-1], abs=1e-3)


@pytest.mark.parametrize("method", METHODS)
def test_noise_that_is_new_in_each_step_is_smoothed(method: str) -> None:
    """Poses and references at 1 kHz: a share of what one exact look would be off by."""
    noise, model, places, step = Noise(2.0), learned(method, "planar"), PLACES["planar"], 0.001
    exact = run(model, method, lambda _: frames_of(places), STARTS["planar"], step)
    found = run(model, method, seen_at(places, noise, 1000.0, 5), STARTS["planar"], step)
    expected = own(method, "planar", noise)
    jitter = lengths(exact.manifold, rms(away(exact, found)))[0]
    assert jitter <= lengths(exact.manifold, expected.spread())[0]
    ratio = found.deviations / exact.deviations
    assert np.mean((ratio < 1.1) & (ratio > 1.0 / 1.1)) > 0.97 and ratio.max() < 1.6 and ratio.min() > 0.7


def profile(deviations: Array) -> Run:
    """A run of one dimension with these standard deviations (T,)."""
    T = len(deviations)
    return Run(Manifold.euclidean(1), np.zeros((T, 1)), deviations[:, None, None] ** 2, np.linspace(0.0, 1.0, T), 0.0)


def test_a_profile_that_comes_later_is_the_same_and_one_that_goes_up_and_down_is_not() -> None:
    times = 0.01 * np.arange(300)
    exact = profile(0.01 + 0.07 * (times > 1.0))
    late = profile(0.01 + 0.07 * (times > 1.1))
    assert later_or_sooner(exact, late, 0.01, 0.1) == pytest.approx(1.0)
    assert later_or_sooner(late, exact, 0.01, 0.1) == pytest.approx(1.0)
    assert later_or_sooner(exact, late, 0.01, 0.09) == pytest.approx(8.0)
    again = profile(np.where(np.abs(times - 1.05) < 0.015, 0.01, exact.deviations[:, 0]))
    assert later_or_sooner(exact, again, 0.01, 0.1) > 2.0
    assert restlessness(again)[0] == pytest.approx(3.0 * restlessness(exact)[0])


LAGS = {
    "adapt_regress": 0.30,
    "regress_product": 0.30,
    "time_steps": 0.30,
    "promp": 0.30,
    "gaussian_process": 0.30,
    "trajectory": 0.30,
    "dmp": 0.20,
    "dynamical_system": 0.41,
    "semi_markov": 0.15,
}
"""s, of a movement of 2 s with a blend_time of 0.15 s: what the pages say."""


@pytest.mark.parametrize("method", METHODS)
def test_an_object_that_moves_steadily_is_followed_with_the_lag_that_is_stated(method: str) -> None:
    """5 cm/s, seen 100 times per second, after the movement's end."""
    model, places = learned(method, "planar"), PLACES["planar"]
    retrieval = make_retrieval(model, blend_time=0.15)
    retrieval.start(0, STARTS["planar"])
    robot, path, standing = STARTS["planar"], [], frames_of(places)
    for i in range(1, 1000):
        away_by = 0.05 * max(0.01 * i - 3.0, 0.0)
        frames = standing if away_by == 0.0 else frames_of(places | {"goal": places["goal"] + [away_by, 0.0, 0.0]})
        robot = retrieval.step(10_000_000 * i, frames, robot).gaussian.mean
        path.append(robot)
    speed = float(np.linalg.norm(path[-1] - path[-101]))
    for i in range(1000, 2000):  # where it would be, had the object stood there
        robot = retrieval.step(10_000_000 * i, frames, robot).gaussian.mean
    lag = float(np.linalg.norm(robot - path[-1])) / speed
    assert speed == pytest.approx(0.05, rel=0.05)
    assert lag == pytest.approx(LAGS[method], rel=0.1)


def test_equal_situations_are_equal_and_others_are_not() -> None:
    places = PLACES["poses"]
    one, state = Situation(frames_of(places), state=STARTS["poses"]), STARTS["poses"]
    assert one == Situation(frames_of(places), dict.fromkeys(places, 1.0), state.copy())
    assert one == Situation(dict(reversed(frames_of(places).items())), {}, state.tolist())
    assert one != Situation(frames_of(places)) and one.has_frames_of(Situation(frames_of(places)))
    assert one != Situation(frames_of(places), {"object": 0.5}, state)
    assert one != Situation(frames_of(places), None, np.append(state[:-1], 0.0))
    assert one != Situation({"start": frames_of(places)["start"]}, None, state)
    assert one != "a situation"
    moved = places | {"object": places["object"] + np.eye(7)[0] * 1e-15}
    assert one != Situation(frames_of(moved), None, state)
    written: dict[str, Frame] = frames_of(places)
    kept = Situation(written, None, state)
    written["object"] = frames_of(moved)["object"]
    assert kept == one
    with pytest.raises(TypeError):
        kept.frames["object"] = written["object"]  # type: ignore[index]
    with pytest.raises(TypeError):
        hash(one)


def test_frames_are_values_that_nobody_else_can_change() -> None:
    A, b = np.eye(2), np.array([0.0, 1.0])
    one, other = Frame(A, b), Frame(A.copy(), b.copy())
    assert one == other and hash(one) == hash(other) and one == Frame(A, np.array([-0.0, 1.0]))
    assert hash(one) == hash(Frame(A, np.array([-0.0, 1.0])))
    A[0, 0] = b[0] = 5.0
    assert one == other and one != Frame(A, b) and one != Frame(np.eye(2), np.array([0.0, 1.0]), np.eye(2))
    assert Frame(np.ones((2, 3)), np.zeros(2)) != Frame(np.ones((2, 2)), np.zeros(2))


@pytest.mark.parametrize("n", [1, 2, 6])
def test_a_covariance_that_takes_over_begins_where_the_former_one_was_and_stays_positive(n: int) -> None:
    rng = np.random.default_rng(n)
    fade = CovarianceFade(n, 0.15)
    shown = random_covariance(rng, n, 0.4)
    for _ in range(200):
        present = 10.0 ** rng.uniform(-6.0, 1.0) * random_covariance(rng, n, 0.4)
        fade.take_over(shown, present)
        np.testing.assert_allclose(fade.of(present), shown, rtol=1e-6, atol=1e-9 * np.abs(shown).max())
        fade.advance(rng.uniform(0.0, 0.2))
        later = 10.0 ** rng.uniform(-2.0, 2.0) * present  # the course goes on, and is followed
        shown = fade.of(later)
        np.testing.assert_array_equal(shown, shown.T)
        assert np.linalg.eigvalsh(shown).min() > 0.0
    fade.advance(20.0)
    assert fade.is_gone and fade.of(present) is present


def test_what_is_left_of_a_covariance_is_as_large_as_the_change_was() -> None:
    rng = np.random.default_rng(0)
    one, change = random_covariance(rng, 6, 0.4), random_covariance(rng, 6, 0.4)
    for size in (1e-2, 1e-4, 1e-6):
        fade = CovarianceFade(6, 0.15)
        fade.take_over(one + size * change, one)
        fade.advance(0.05)
        left = (fade.of(7.0 * one) - 7.0 * one) / size  # of a course that has become wider meanwhile
        np.testing.assert_allclose(left, 7.0 * np.exp(-1.0 / 3.0) * change, rtol=0.05, atol=20.0 * size)


def test_no_covariance_waits_for_the_compiler() -> None:
    """Those of a `Gaussian` are read-only, slices lie otherwise in memory: to the compiler both are other types."""
    fade = CovarianceFade(6, 0.15)
    kernels = relate, multiply, lasting
    compiled = [len(kernel.signatures) for kernel in kernels]
    frozen = Gaussian(np.zeros(6), 2.0 * np.eye(6)).covariance
    assert not frozen.flags.writeable
    several = np.tile(np.eye(6), (2, 1, 1))
    for covariance in (frozen, frozen.T, np.eye(12)[::2, ::2]):
        fade.take_over(covariance, 3.0 * covariance)
        fade.of(covariance)
        fade.take_over(3.0 * covariance, covariance, fade.lasting(several[:, ::-1, ::-1], several, np.arange(2.0)))
    assert [len(kernel.signatures) for kernel in kernels] == compiled


def test_what_is_left_of_a_covariance_turns_and_scales_with_the_world() -> None:
    rng = np.random.default_rng(1)
    former, present, later = (random_covariance(rng, 6, 0.4) for _ in range(3))
    world = rng.normal(size=(6, 6))

    def shown(A: Array) -> Array:
        fade = CovarianceFade(6, 0.15)
        fade.take_over(A @ former @ A.T, A @ present @ A.T)
        fade.advance(0.1)
        return fade.of(A @ later @ A.T)

    expected = world @ shown(np.eye(6)) @ world.T
    np.testing.assert_allclose(shown(world), expected, rtol=1e-6, atol=1e-8 * np.abs(expected).max())


def test_velocities_of_a_moment_are_no_reason_to_swing_out() -> None:
    """Two courses with the same fast step, 10 ms apart: the reference goes no farther than they do."""

    def course(late: float, times: Array) -> Array:
        path = np.zeros((len(times), 7))
        path[:, 6] = 1.0
        path[:, 0] = 0.02 / (1.0 + np.exp(-(times - late) / 0.002))
        return path

    continuity = Continuity(POSE, 0.15)
    at = continuity.moments + 0.5
    spread = np.tile(np.eye(6), (len(at), 1, 1))
    continuity.take_over(list(course(0.5, at)), list(course(0.51, at)), np.eye(6), spread, spread)
    times, path = 0.5 + 0.001 * np.arange(500, dtype=np.float64), []
    for mean in course(0.51, times):
        path.append(continuity.mean(mean)[0])
        continuity.advance(0.001)
    assert path[0] == pytest.approx(0.01) and path[-1] == pytest.approx(0.02, abs=2e-3)
    assert min(path) > -0.002 and max(path) < 0.036
    assert abs(path[1] - path[0] - (0.01 - course(0.5, np.array([0.499]))[0, 0])) < 1e-3  # as fast as before
