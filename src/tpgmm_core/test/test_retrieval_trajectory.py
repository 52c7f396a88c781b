# SPDX-License-Identifier: Apache-2.0
from __future__ import annotations

import time
from functools import cache

import numpy as np
import pytest

from random_problems import random_covariance, random_rotation
from reaching import reaching_model
from tpgmm_core import TPGMM, Demonstration, Frame, Manifold, quaternion
from tpgmm_core.quaternion import Array
from tpgmm_core.retrieval.differences import derivatives, difference_weights
from tpgmm_core.retrieval.trajectory import TrajectoryModel, smoothest, with_derivatives
from worlds import DURATION, assert_moved, moved, planar_demonstrations, planar_frame, planar_situation, random_world

TIMES = np.linspace(0.0, DURATION, 60)


@cache
def model(K: int = 6) -> TPGMM:
    return TPGMM(K, reg_covar=1e-5).fit([with_derivatives(d) for d in planar_demonstrations()])


@pytest.mark.parametrize("window", [3, 7])
def test_derivatives_are_exact_for_parabolas_at_uneven_times(window: int) -> None:
    rng = np.random.default_rng(0)
    t = np.cumsum(rng.uniform(0.01, 0.05, 40))
    x = np.column_stack([1.0 + 2.0 * t - 3.0 * t**2, 4.0 - t])
    v, a = derivatives(t, x, Manifold.euclidean(2), window)
    np.testing.assert_allclose(v, np.column_stack([2.0 - 6.0 * t, -np.ones(40)]), atol=1e-9)
    np.testing.assert_allclose(a, np.tile([-6.0, 0.0], (40, 1)), atol=1e-7)


def test_turning_about_an_axis_has_its_angular_velocity_and_acceleration_whatever_the_signs() -> None:
    rng = np.random.default_rng(0)
    t = np.linspace(0.0, 1.0, 30)
    axis = np.array([1.0, 2.0, -2.0]) / 3.0
    q = quaternion.multiply(quaternion.exp((t + 2.0 * t**2)[:, None] * axis), quaternion.exp([0.3, -0.5, 0.2]))
    v, a = derivatives(t, q * rng.choice([-1.0, 1.0], (30, 1)), Manifold.parse("S3"))
    np.testing.assert_allclose(v, (1.0 + 4.0 * t)[:, None] * axis, atol=1e-9)
    np.testing.assert_allclose(a, np.tile(4.0 * axis, (30, 1)), atol=1e-7)


def test_windows_that_do_not_fit_are_refused() -> None:
    for window in (2, 4, 9):
        with pytest.raises(ValueError, match="window"):
            difference_weights(np.arange(7.0), window)
    with pytest.raises(ValueError, match="three"):
        difference_weights([0.0, 1.0])


def test_frames_see_derivatives_as_derivatives_of_what_they_see() -> None:
    demonstration = planar_demonstrations()[0]
    augmented = with_derivatives(demonstration, window=3)
    for name, seen in augmented.projected().items():
        positions = demonstration.projected()[name][:, 1:]
        v, a = derivatives(demonstration.times, positions, Manifold.euclidean(2), 3)
        np.testing.assert_allclose(seen[:, 1:], np.column_stack([positions, v, a]), atol=1e-8)


def dense(times: Array, means: Array, precisions: Array) -> tuple[Array, Array]:
    """The same by the explicit matrix W of all differences: positions (T, d) and their whole covariance."""
    T, d = len(times), means.shape[1] // 3
    first, weights = difference_weights(times)
    W = np.zeros((T, 3, d, T, d))
    for t in range(T):
        for order in range(3):
            for p in range(3):
                W[t, order, :, first[t] + p, :] = weights[order, t, p] * np.eye(d)
    W = W.reshape(T, 3 * d, T * d)
    H = np.einsum("tai,tab,tbj->ij", W, precisions, W)
    right = np.einsum("tai,tab,tb->i", W, precisions, means)
    return np.linalg.solve(H, right).reshape(T, d), np.linalg.inv(H)


@pytest.mark.parametrize("d", [1, 2, 3, 7])
@pytest.mark.parametrize("T", [3, 4, 17])
def test_the_banded_solution_is_the_dense_one(d: int, T: int) -> None:
    rng = np.random.default_rng(10 * d + T)
    times = np.cumsum(rng.uniform(0.05, 0.15, T))
    means = rng.normal(size=(T, 3 * d))
    precisions = np.stack([np.linalg.inv(random_covariance(rng, 3 * d)) for _ in range(T)])
    positions, covariances = smoothest(*difference_weights(times), means, precisions)
    expected, covariance = dense(times, means, precisions)
    np.testing.assert_allclose(positions, expected, atol=1e-7)
    for t in range(T):
        block = covariance[t * d : (t + 1) * d, t * d : (t + 1) * d]
        np.testing.assert_allclose(covariances[t], block, rtol=1e-6, atol=1e-8 * np.abs(block).max())


def test_the_effort_is_linear_in_the_length() -> None:
    """Against the same work on a shorter one, with a wide margin; dense solutions would take 64 times as long."""
    model()
    retriever = TrajectoryModel(model())

    def seconds(T: int) -> float:
        times = np.linspace(0.0, DURATION, T)
        best = np.inf
        for _ in range(5):
            start = time.perf_counter()
            retriever.retrieve(planar_situation(), times)
            best = min(best, time.perf_counter() - start)
        return best

    assert seconds(8000) < 30.0 * seconds(1000)


def test_a_demonstrated_situation_gives_the_demonstrated_movement() -> None:
    for demonstration in planar_demonstrations():
        found = TrajectoryModel(model()).retrieve(demonstration.frames, demonstration.times)
        error = np.linalg.norm(found.positions - demonstration.data[:, 1:], axis=1)
        assert np.sqrt(np.mean(error**2)) < 0.05 and error[-1] < 0.05


def test_the_trajectory_is_smooth_although_states_change_at_once() -> None:
    found = TrajectoryModel(model()).retrieve(planar_situation(), TIMES)
    assert len(np.unique(found.states)) == 6
    peak = max(np.abs(with_derivatives(d).data[:, 5:]).max() for d in planar_demonstrations())
    assert np.abs(found.accelerations).max() < 2.0 * peak
    np.testing.assert_allclose(np.gradient(found.positions, TIMES, axis=0, edge_order=2), found.velocities, atol=1e-9)
    assert all(np.linalg.eigvalsh(S).min() > 0.0 for S in found.covariances)
    np.testing.assert_array_equal(found.gaussians[7].mean, found.positions[7])


def test_states_can_be_given() -> None:
    retriever = TrajectoryModel(model())
    chosen = retriever.retrieve(planar_situation(), TIMES)
    again = retriever.retrieve(planar_situation(), TIMES, states=chosen.states)
    np.testing.assert_array_equal(again.positions, chosen.positions)
    # the movement's end only, held for all the time
    held = retriever.retrieve(planar_situation(), TIMES, states=[5] * len(TIMES))
    assert np.linalg.norm(held.positions[-1] - chosen.positions[-1]) < 0.1


def test_moving_the_world_moves_the_trajectory() -> None:
    rng = np.random.default_rng(4)
    retriever = TrajectoryModel(model())
    for T in (60, 400):
        times = np.linspace(0.0, DURATION, T)
        before = retriever.retrieve(planar_situation(), times)
        for _ in range(5):
            world = random_world(2, rng)
            after = retriever.retrieve(moved(world, planar_situation()), times)
            assert_moved(world, before.gaussians, after.gaussians)
            np.testing.assert_array_equal(after.states, before.states)


def test_positions_keep_their_digits_at_short_time_steps() -> None:
    """The normal equations alone would lose five digits here."""
    retriever = TrajectoryModel(model())
    times = np.linspace(0.0, DURATION, 2000)
    world = random_world(2, np.random.default_rng(6))
    before = retriever.retrieve(planar_situation(), times).positions
    after = retriever.retrieve(moved(world, planar_situation()), times).positions
    np.testing.assert_allclose(after, before @ world.A.T + world.b, atol=1e-11)


def test_times_too_close_together_are_refused() -> None:
    times = 1e-7 * np.arange(2000)
    with pytest.raises(ValueError, match="longer time steps"):
        TrajectoryModel(model()).retrieve(planar_situation(), times)


def test_in_three_dimensions_with_a_scaled_frame() -> None:
    rng = np.random.default_rng(5)
    t = np.linspace(0.0, 1.0, 50)
    demonstrations = []
    for _ in range(4):
        frame = Frame(0.3 * random_rotation(rng, 3), rng.normal(size=3)).with_time()
        seen = np.column_stack([t, t, np.sin(3.0 * t), t**2])
        demonstrations.append(Demonstration(t, seen @ frame.A.T + frame.b, {"frame": frame}))
    spatial = TPGMM(5, reg_covar=1e-6).fit([with_derivatives(d, window=3) for d in demonstrations])
    found = TrajectoryModel(spatial).retrieve(demonstrations[0].frames, t)
    assert np.abs(found.positions - demonstrations[0].data[:, 1:]).max() < 0.05


def test_bad_input_is_refused_with_the_reason() -> None:
    retriever = TrajectoryModel(model())
    with pytest.raises(ValueError, match="Euclidean"):
        TrajectoryModel(reaching_model())
    with pytest.raises(ValueError, match="1 \\+ 3 d"):
        TrajectoryModel(TPGMM(1).fit_projected({"f": np.random.default_rng(0).normal(size=(20, 5))}))
    for states in ([6] * 60, [0] * 59, [0.5] * 60, [-1] * 60):
        with pytest.raises(ValueError, match="states are 60 integers 0 to 5"):
            retriever.retrieve(planar_situation(), TIMES, states=states)  # type: ignore[arg-type]
    moving = Frame(np.eye(2), np.zeros((80, 2))).with_time()
    with pytest.raises(ValueError, match="vary with time"):
        retriever.retrieve({"goal": moving}, TIMES)
    with pytest.raises(ValueError, match="vary with time"):
        with_derivatives(Demonstration(np.arange(80.0), np.zeros((80, 3)), {"goal": moving}))
    with pytest.raises(ValueError, match="with_time"):
        retriever.retrieve({"goal": planar_frame(0.0, 0.0, 0.3)}, TIMES)
    with pytest.raises(ValueError, match="increasing"):
        retriever.retrieve(planar_situation(), TIMES[::-1])
