# SPDX-License-Identifier: Apache-2.0
"""Gaussian processes over time in the frames: means, variances that change with time, and hyperparameters."""

from __future__ import annotations

import numpy as np

from reaching import reaching_demonstrations
from tpgmm_core import Demonstration, Frame
from tpgmm_core.common.types import Array
from tpgmm_core.geometry.manifold import POSE
from tpgmm_core.learning.gaussian_process import LENGTHS, NOISES, GaussianProcessTPGMM, Processes
from tpgmm_core.learning.smooth_paths import smoothed
from tpgmm_core.retrieval.time_steps import TimeSteps
from worlds import planar_demonstrations

T = 60
TIMES = np.linspace(0.0, 1.0, T)


def kernel(length: float) -> Array:
    return np.asarray(np.exp(-0.5 * ((TIMES[:, None] - TIMES) / length) ** 2))


def likelihood(y: Array, K: Array) -> float:
    """Of y (T,) as N(m 1, s K), m integrated out, s the likeliest: Rasmussen and Williams, Eqs. 2.43 to 2.45."""
    inverse, one = np.linalg.inv(K), np.ones(T)
    P = inverse - np.outer(inverse @ one, one @ inverse) / (one @ inverse @ one)
    s = y @ P @ y / (T - 1)
    return float(-0.5 * ((T - 1) * np.log(s) + np.linalg.slogdet(K)[1] + np.log(one @ inverse @ one)))


def test_the_likeliest_process_of_the_grid_is_found_and_smooths_as_regression_does() -> None:
    rng = np.random.default_rng(0)
    y = 3.0 + np.linalg.cholesky(kernel(0.2) + 1e-9 * np.eye(T)) @ rng.normal(size=T) + 0.1 * rng.normal(size=T)
    noises = NOISES[NOISES > 1e-4]  # what plain inverses can do
    scores = {(a, b): likelihood(y, kernel(a) + b * np.eye(T)) for a in LENGTHS for b in noises}
    length, noise = max(scores, key=scores.__getitem__)
    K, one = kernel(length) + noise * np.eye(T), np.ones(T)
    mean = one @ np.linalg.solve(K, y) / (one @ np.linalg.solve(K, one))
    expected = mean + kernel(length) @ np.linalg.solve(K, y - mean)
    found = Processes(T).fit(y[:, None])
    np.testing.assert_allclose(found.smoothers[0] @ y, expected, atol=1e-6)
    np.testing.assert_allclose(found.smoothers[0].sum(axis=1), 1.0, atol=1e-9)
    assert 0.1 < length < 0.4 and 0.5 * 0.1**2 < noise < 2.0 * 0.1**2 / y.var()


def test_how_much_demonstrations_differ_changes_with_time() -> None:
    rng = np.random.default_rng(1)
    width = 0.01 + 0.5 * np.linspace(0.0, 1.0, 80) ** 2
    still = {"still": Frame(np.eye(2), np.zeros(2)).with_time()}
    times = np.linspace(0.0, 1.0, 80)
    offsets = rng.normal(size=(12, 2))
    offsets = (offsets - offsets.mean(axis=0)) / offsets.std(axis=0, ddof=1)
    shown = [Demonstration(times, np.column_stack([times, width[:, None] * o]), still) for o in offsets]
    model = GaussianProcessTPGMM(manifold="R1 x R2", n_steps=50, reg_covar=0.0, prior_strength=1.0).fit(shown)
    S = model.covariances_["still"]
    within = S[:, 1:, 1:] - S[:, 1:, 0, None] * S[:, None, 0, 1:] / S[:, 0, 0, None, None]
    assert np.abs(within[:, 0, 1]).max() < 1e-15
    ratio = np.sqrt(within[:, 0, 0]) / np.interp(np.linspace(0.0, 1.0, 50), times, width)
    assert ratio.min() > 0.6 and ratio.max() < 1.8


def test_tremor_is_left_out_of_the_path() -> None:
    rng = np.random.default_rng(2)
    u = np.linspace(0.0, 1.0, 100)
    smooth = np.column_stack([u, u**2, np.sin(3.0 * u)])
    still = {"still": Frame(np.eye(2), np.zeros(2)).with_time()}
    shown = []
    for _ in range(3):
        shown.append(Demonstration(u, smooth + np.pad(0.02 * rng.normal(size=(100, 2)), ((0, 0), (1, 0))), still))
    model = GaussianProcessTPGMM(manifold="R1 x R2").fit(shown)
    raw = np.mean([d.data[:, 1:] for d in shown], axis=0)
    assert np.std(model.means_["still"][:, 1:] - smooth[:, 1:]) < 0.5 * np.std(raw - smooth[:, 1:])


def test_three_demonstrations_of_a_hand_are_enough_to_find_the_object_elsewhere() -> None:
    movement = TimeSteps(GaussianProcessTPGMM(manifold="R1 x R3 x S3").fit(reaching_demonstrations(3)))
    errors = []
    for demonstration in reaching_demonstrations(20)[3:]:
        movement.situate(demonstration.frames)
        errors.append(np.abs(POSE.log(movement.at(demonstration.times[-1:])[0][0], demonstration.data[-1, 1:])))
    assert np.median(errors, axis=0)[:3].max() < 0.01 and np.median(errors, axis=0)[3:].max() < 0.05


def test_one_demonstration_and_frames_that_were_hidden_are_learned_from() -> None:
    one = reaching_demonstrations()[0]
    movement = TimeSteps(GaussianProcessTPGMM(manifold="R1 x R3 x S3").fit([one]))
    movement.situate(one.frames)
    assert np.abs(POSE.log(movement.at(one.times)[0], one.data[:, 1:])).max() < 0.05
    hidden = [
        Demonstration(d.times, d.data, d.frames, {"goal": d.times > d.times[40]}) for d in planar_demonstrations()
    ]
    model = GaussianProcessTPGMM(n_steps=20, manifold="R1 x R2").fit(hidden)
    widths = np.trace(model.covariances_["goal"][:, 1:, 1:], axis1=1, axis2=2)
    assert widths[:8].min() > 10.0 * widths[12:].max()


def test_a_smoothed_path_turns_with_the_world() -> None:
    rng = np.random.default_rng(3)
    path = np.stack([d.data[:, 1:] for d in reaching_demonstrations(1)])[0][:30]
    weights = rng.uniform(0.0, 1.0, (6, 30, 30)) * np.exp(-np.abs(np.subtract.outer(np.arange(30), np.arange(30))))
    weights[3:] = weights[3]  # the same for all axes of a turn, and of a place
    weights[:3] = weights[0]
    weights /= weights.sum(axis=2, keepdims=True)
    world = Frame.from_pose(np.array([1.0, -2.0, 0.5]), np.array([0.5, -0.5, 0.5, 0.5]))
    moved = smoothed(POSE, path @ world.A.T + world.b, weights)
    np.testing.assert_allclose(POSE.log(smoothed(POSE, path, weights) @ world.A.T + world.b, moved), 0.0, atol=1e-10)
