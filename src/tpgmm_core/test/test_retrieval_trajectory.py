# SPDX-License-Identifier: Apache-2.0
from __future__ import annotations

import time
from functools import cache

import numpy as np
import pytest

from random_problems import POSE, random_covariance, random_quaternion, random_rotation
from reaching import DURATION as POSE_DURATION
from reaching import frames_at, place, reaching_demonstrations, reaching_model
from tpgmm_core import TPGMM, Demonstration, Frame, GaussianMixture, Manifold
from tpgmm_core.common.types import Array
from tpgmm_core.geometry import quaternion
from tpgmm_core.retrieval.differences import derivatives, difference_weights
from tpgmm_core.retrieval.dynamic_features import (
    manifold_with_derivatives,
    point_manifold,
    with_derivatives,
)
from tpgmm_core.retrieval.smooth_trajectory import SmoothTrajectory
from tpgmm_core.retrieval.smoothing import smoothest
from tpgmm_core.retrieval.trajectory import Trajectory, TrajectoryModel
from worlds import DURATION, assert_moved, moved, planar_demonstrations, planar_frame, planar_situation, random_world

TIMES = np.linspace(0.0, DURATION, 60)
OVER_POSES = "R1 x R3 x S3"


@cache
def model(K: int = 6) -> TPGMM:
    return TPGMM(K, reg_covar=1e-5).fit([with_derivatives(d) for d in planar_demonstrations()])


@cache
def pose_model() -> TPGMM:
    model = TPGMM(6, reg_covar=1e-5, manifold=manifold_with_derivatives(OVER_POSES))
    model.fit([with_derivatives(d, OVER_POSES) for d in reaching_demonstrations()])
    model.metadata_ = {"duration_s": POSE_DURATION}
    return model


def pose_situation() -> dict[str, Frame]:
    return frames_at(start=place(0.1, 0.2, 0.3), object=place(0.6, -0.2, -0.8))


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


def dense(times: Array, means: Array, precisions: Array) -> Array:
    """The same by the explicit matrix W of all differences: positions (T, d)."""
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
    return np.linalg.solve(H, right).reshape(T, d)


@pytest.mark.parametrize("d", [1, 2, 3, 7])
@pytest.mark.parametrize("T", [3, 4, 17])
def test_the_banded_solution_is_the_dense_one(d: int, T: int) -> None:
    rng = np.random.default_rng(10 * d + T)
    times = np.cumsum(rng.uniform(0.05, 0.15, T))
    means = rng.normal(size=(T, 3 * d))
    precisions = np.stack([np.linalg.inv(random_covariance(rng, 3 * d)) for _ in range(T)])
    found = smoothest(
        *difference_weights(times), means, precisions, np.arange(T), Manifold.euclidean(d), np.zeros((T, d))
    )
    np.testing.assert_allclose(found.points, dense(times, means, precisions), atol=1e-7)


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
    with pytest.raises(ValueError, match="with_derivatives"):
        TrajectoryModel(reaching_model())
    with pytest.raises(ValueError, match="1 \\+ 3 d"):
        TrajectoryModel(TPGMM(1).fit_projected({"f": np.random.default_rng(0).normal(size=(20, 5))}))
    for states in ([6] * 60, [0] * 59, [0.5] * 60, [-1] * 60):
        with pytest.raises(ValueError, match="states are 60 integers 0 to 5"):
            retriever.retrieve(planar_situation(), TIMES, states=states)  # type: ignore[arg-type]
    moving = Frame(np.eye(2), np.zeros((80, 2))).with_time()
    with pytest.raises(ValueError, match="vary with time"):
        retriever.retrieve({"goal": moving}, TIMES)
    with pytest.raises(ValueError, match="with_time"):
        retriever.retrieve({"goal": planar_frame(0.0, 0.0, 0.3)}, TIMES)
    with pytest.raises(ValueError, match="increasing"):
        retriever.retrieve(planar_situation(), TIMES[::-1])


def test_manifolds_grow_by_derivatives_and_shrink_to_points() -> None:
    grown = manifold_with_derivatives("R1 x R3 x S3 x R3 x S3")
    assert (str(grown), grown.dim, grown.tangent_dim) == ("R1 x R3 x S3 x R3 x S3 x R24", 39, 37)
    assert str(point_manifold(grown)) == "R3 x S3 x R3 x S3"
    assert str(point_manifold(Manifold.euclidean(7))) == "R2"
    for text in ("R1 x R3 x S3", "R1 x R12 x R3 x S3", "S3 x R1 x R6", "R1"):
        with pytest.raises(ValueError, match="with_derivatives"):
            point_manifold(Manifold.parse(text))


def moving_pose_demonstration(visible: Array | None = None) -> tuple[Demonstration, Array]:
    """A hand that holds on to an object, which turns and accelerates; and its pose as seen from the object."""
    t = np.linspace(0.0, 1.0, 101)
    axis = np.array([1.0, -2.0, 2.0]) / 3.0
    q = quaternion.exp((1.5 * t + 0.5 * t**2)[:, None] * axis)
    p = np.column_stack([np.sin(2.0 * t), t**2, 1.0 - t])
    held = np.array([0.1, -0.2, 0.3, *quaternion.exp([0.4, 0.1, -0.3])])
    frame = Frame.from_pose(p, q)
    data = np.column_stack([t, np.einsum("tij,j->ti", frame.A, held) + frame.b])
    mask = None if visible is None else {"object": visible}
    return Demonstration(t, data, {"object": frame.with_time()}, mask), held


def test_a_frame_that_moves_sees_what_is_held_to_it_at_rest() -> None:
    demonstration, held = moving_pose_demonstration()
    augmented = with_derivatives(demonstration, OVER_POSES, window=3)
    assert np.abs(augmented.data[:, 8:14]).max() > 1.0 and np.abs(augmented.data[:, 14:]).max() > 1.0
    seen = augmented.projected()["object"]
    np.testing.assert_allclose(POSE.log(held, seen[:, 1:8]), 0.0, atol=1e-12)
    # parabolas through three samples, 0.01 s apart, know velocities to 1e-4, accelerations at the ends to 1e-2 only
    np.testing.assert_allclose(seen[:, 8:14], 0.0, atol=2e-3)
    np.testing.assert_allclose(seen[1:-1, 14:], 0.0, atol=5e-3)
    # the affine map loses nothing
    augmented_frame = augmented.frames["object"]
    np.testing.assert_allclose(
        np.einsum("tij,tj->ti", augmented_frame.A, seen) + augmented_frame.b, augmented.data, atol=1e-10
    )


def test_an_inverse_of_its_own_goes_with_its_frame() -> None:
    """A damped map: what is seen is D (xi - b), with D other than A^+; its derivatives are seen with D too."""
    t = np.linspace(0.0, 1.0, 101)
    A = (1.0 + 0.5 * np.sin(t))[:, None, None] * np.array([[1.0, 0.2], [0.0, 1.0]])
    data = np.column_stack([t, np.cos(t), t**2])
    plain = Frame(A, np.column_stack([t, t])).with_time()
    own = Frame(plain.A, plain.b, np.linalg.inv(plain.A))
    expected, found = (
        with_derivatives(Demonstration(t, data, {"f": frame}), window=3).projected()["f"] for frame in (plain, own)
    )
    np.testing.assert_allclose(found, expected, atol=1e-9)


def test_where_the_motion_of_a_frame_is_not_known_it_was_not_seen() -> None:
    visible = np.ones(101, dtype=bool)
    visible[40:50] = False
    augmented = with_derivatives(moving_pose_demonstration(visible)[0], OVER_POSES, window=5)
    expected = np.ones(101, dtype=bool)
    expected[38:52] = False
    np.testing.assert_array_equal(augmented.is_visible("object"), expected)
    standing = planar_demonstrations()[0]
    masked = Demonstration(standing.times, standing.data, standing.frames, {"goal": visible[:80]})
    np.testing.assert_array_equal(with_derivatives(masked).is_visible("goal"), visible[:80])


def test_demonstrated_poses_are_followed_again_in_few_steps() -> None:
    retriever = TrajectoryModel(pose_model())
    for demonstration in reaching_demonstrations():
        found = retriever.retrieve(demonstration.frames, demonstration.times)
        error = POSE.log(demonstration.data[:, 1:], found.positions)
        assert np.sqrt(np.mean(error[:, :3] ** 2)) < 0.01 and np.sqrt(np.mean(error[:, 3:] ** 2)) < 0.02
        assert found.iterations <= 6
        np.testing.assert_allclose(np.linalg.norm(found.positions[:, 3:], axis=1), 1.0, atol=1e-12)
        assert np.sum(found.positions[1:, 3:] * found.positions[:-1, 3:], axis=1).min() > 0.9
        v, a = derivatives(found.times, found.positions, POSE)
        np.testing.assert_allclose(found.velocities, v, atol=1e-9)
        np.testing.assert_allclose(found.accelerations, a, atol=1e-7)


def residuals(times: Array, points: Array, means: Array, states: Array) -> Array:
    """(T, 18), as the definition says, by the manifold's own functions."""
    v, a = derivatives(times, points, POSE)
    return np.column_stack([POSE.log(means[states, :7], points), v - means[states, 7:13], a - means[states, 13:]])


def random_states(rng: np.random.Generator, spread: float) -> tuple[Array, Array]:
    """Means (4, 19) and precisions (4, 18, 18) of states whose poses lie apart."""
    base = np.concatenate([rng.normal(size=3), random_quaternion(rng)])
    means = np.array([[*POSE.exp(base, spread * rng.normal(size=6)), *rng.normal(size=12)] for _ in range(4)])
    scale = np.repeat([0.1, 0.5, 2.0], 6)
    covariances = [random_covariance(rng, 18) * np.outer(scale, scale) for _ in range(4)]
    return means, np.linalg.inv(covariances)


@pytest.mark.parametrize("spread", [0.3, 1.0, 3.0])
def test_on_poses_a_stationary_point_is_found_or_the_failure_is_told(spread: float) -> None:
    rng = np.random.default_rng(8)
    times, states = np.linspace(0.0, 1.2, 12), np.repeat(np.arange(4), 3)
    solved = 0
    for _ in range(10):
        means, precisions = random_states(rng, spread)
        try:
            found = smoothest(*difference_weights(times), means, precisions, states, POSE, means[states, :7])
        except ValueError as error:
            assert "contradict" in str(error)
            continue
        solved += 1

        def residual(step: Array, points: Array = found.points, means: Array = means) -> Array:
            return residuals(times, POSE.exp(points, step.reshape(12, 6)), means, states).ravel()

        h = 1e-6
        G = np.stack([(residual(h * e) - residual(-h * e)) / (2 * h) for e in np.eye(72)], axis=1)
        weighted = np.einsum("tij,tjk->tik", precisions[states], G.reshape(12, 18, 72)).reshape(-1, 72)
        H = G.T @ weighted
        step = np.linalg.solve(H, weighted.T @ residual(np.zeros(72)))
        np.testing.assert_allclose(step, 0.0, atol=1e-6)
    assert solved >= (10 if spread <= 1.0 else 5)


def course(K: int = 6, steps: int = 60) -> tuple[SmoothTrajectory, Trajectory]:
    """In the planar situation, and the trajectory that it interpolates."""
    planar = model(K)
    planar.metadata_ = {"duration_s": DURATION}
    result = SmoothTrajectory(planar, steps=steps)
    result.situate(planar_situation())
    return result, TrajectoryModel(planar).retrieve(planar_situation(), np.linspace(0.0, DURATION, steps))


def test_a_course_is_the_trajectory_at_its_steps_and_smooth_between_them() -> None:
    planar, trajectory = course()
    means, covariances, activations = planar.at(trajectory.times)
    np.testing.assert_allclose(means, trajectory.positions, atol=1e-12)
    np.testing.assert_allclose(covariances, trajectory.covariances, atol=1e-12)
    learned = model(6)  # both frames saw all demonstrations at the same times
    seen = GaussianMixture(learned.priors_, learned.means_["goal"], learned.covariances_["goal"])
    np.testing.assert_allclose(activations, seen.responsibilities([0], [0.0]), atol=1e-9)
    assert (planar.duration, planar.frame_names, str(planar.manifold)) == (DURATION, ("start", "goal"), "R2")


def test_between_steps_a_course_over_poses_has_continuous_velocities() -> None:
    poses = SmoothTrajectory(pose_model(), steps=80)
    poses.situate(pose_situation())
    grid = np.linspace(0.0, POSE_DURATION, 80)
    trajectory = TrajectoryModel(pose_model()).retrieve(pose_situation(), grid)
    h = 1e-5
    inner = grid[1:-1]
    before, at, after = (poses.at(inner + offset)[0] for offset in (-h, 0.0, h))
    np.testing.assert_allclose(POSE.log(trajectory.positions[1:-1], at), 0.0, atol=1e-12)
    for velocity in (POSE.log(before, at) / h, POSE.log(at, after) / h):
        np.testing.assert_allclose(velocity, trajectory.velocities[1:-1], atol=2e-3)
    middles = 0.5 * (grid[1:] + grid[:-1])
    assert min(np.linalg.eigvalsh(S).min() for S in poses.at(middles)[1]) > 0.0
    fine = TrajectoryModel(pose_model()).retrieve(pose_situation(), np.sort(np.concatenate([grid, middles])))
    np.testing.assert_allclose(POSE.log(fine.positions[1::2], poses.at(middles)[0]), 0.0, atol=5e-3)


def test_a_course_ends_where_its_grid_ends_and_forgets_former_situations() -> None:
    poses = SmoothTrajectory(pose_model(), steps=40)
    poses.situate(frames_at(start=place(-0.5, 0.4, 2.0), object=place(1.0, 1.0, -2.0)))
    poses.situate(pose_situation())
    fresh = SmoothTrajectory(pose_model(), steps=40)
    fresh.situate(pose_situation())
    times = np.array([-1.0, 0.0, 0.7, POSE_DURATION, 10.0])
    for found, expected in zip(poses.at(times), fresh.at(times), strict=True):
        np.testing.assert_array_equal(found, expected)
    means, _, _ = poses.at(times)
    np.testing.assert_array_equal(means[[0, 3]], means[[1, 4]])


def test_a_course_that_begins_at_its_former_solution_finds_what_one_from_the_beginning_does() -> None:
    poses, fresh = SmoothTrajectory(pose_model(), steps=40), SmoothTrajectory(pose_model(), steps=40)
    times = np.linspace(0.0, POSE_DURATION, 90)
    for shift in np.linspace(0.0, 0.1, 6):
        situation = pose_situation() | frames_at(object=place(0.55 + 3.0 * shift, 0.08, -0.4 + shift))
        poses.situate(situation)
    fresh.situate(situation)
    means, covariances, _ = poses.at(times)
    expected, expected_covariances, _ = fresh.at(times)
    np.testing.assert_allclose(POSE.log(expected, means), 0.0, atol=1e-7)
    np.testing.assert_allclose(covariances, expected_covariances, rtol=0.0, atol=1e-3 * expected_covariances.max())


@pytest.mark.parametrize("jump", [0.0, 0.15, 2.5])
def test_frames_that_move_at_each_step_leave_no_error_behind_however_long_they_do(jump: float) -> None:
    """The former solution only saves time; a turn at once, jump, makes it useless."""
    poses = SmoothTrajectory(pose_model(), steps=40)
    times = np.linspace(0.0, POSE_DURATION, 15)
    for i, angle in enumerate(np.linspace(0.0, 4.0 * np.pi, 120)):
        turn = 3.0 + 0.1 * np.sin(angle) + jump * (i > 60)
        situation = pose_situation() | frames_at(object=place(turn, 0.08 + 0.02 * np.cos(angle), -0.4))
        poses.situate(situation)
        if i % 20 == 1:
            fresh = SmoothTrajectory(pose_model(), steps=40)
            fresh.situate(situation)
            np.testing.assert_allclose(POSE.log(fresh.at(times)[0], poses.at(times)[0]), 0.0, atol=1e-7)


@pytest.mark.parametrize("of_poses", [False, True])
def test_the_standard_deviation_does_not_depend_on_the_number_of_steps(of_poses: bool) -> None:
    """Eight demonstrations are eight observations at each time, however many steps a trajectory is asked for."""
    learned, frames = (pose_model(), pose_situation()) if of_poses else (model(), planar_situation())
    learned.metadata_ = {"duration_s": POSE_DURATION if of_poses else DURATION}
    deviations = []
    for steps in (25, 100, 400):
        found = SmoothTrajectory(learned, steps=steps)
        found.situate(frames)
        covariances = found.at(np.linspace(0.0, found.duration, 25))[1]
        deviations.append(np.sqrt(np.linalg.eigvalsh(covariances)))  # whatever the axes of a turn are
    for other in deviations[1:]:
        np.testing.assert_allclose(other, deviations[0], rtol=0.1)


def test_the_covariance_is_that_of_what_the_adapted_mixture_says_at_that_time() -> None:
    retriever = TrajectoryModel(model())
    found = retriever.retrieve(planar_situation(), TIMES)
    adapted, activations = retriever.adapt(planar_situation()), retriever.activations(TIMES)
    for t, S, h in zip(TIMES, found.covariances, activations, strict=True):
        means, within = adapted.means, adapted.covariances
        gains = within[:, 1:3, 0] / within[:, 0, 0, None]
        conditional_means = means[:, 1:3] + gains * (t - means[:, 0, None])
        conditional = within[:, 1:3, 1:3] - gains[:, :, None] * within[:, None, 0, 1:3]
        apart = conditional_means - h @ conditional_means
        expected = np.einsum("k,kij->ij", h, conditional + apart[:, :, None] * apart[:, None, :])
        np.testing.assert_allclose(S, expected, rtol=1e-9, atol=1e-12)


def test_states_that_are_given_have_their_own_covariances() -> None:
    retriever = TrajectoryModel(model())
    found = retriever.retrieve(planar_situation(), TIMES, states=[2] * len(TIMES))
    one = retriever.adapt(planar_situation()).component(2)
    given = GaussianMixture([1.0], one.mean[None], one.covariance[None]).condition([0], [TIMES[30]])
    np.testing.assert_allclose(found.covariances[30], given.covariance[:2, :2], rtol=1e-9)


def test_states_hold_when_they_were_learned_to_although_frames_contradict_each_other_on_where_they_are() -> None:
    far = planar_situation() | {"goal": planar_frame(6.0, -3.0, 2.0).with_time()}
    moved_in_time = TrajectoryModel(model()).adapt(far).means[:, 0]
    learned = model().means_["goal"][:, 0]
    assert np.abs(moved_in_time - learned).max() > 0.1
    near, found = (TrajectoryModel(model()).retrieve(frames, TIMES) for frames in (planar_situation(), far))
    np.testing.assert_array_equal(found.states, near.states)
    assert np.linalg.norm(found.positions[-1] - far["goal"].b[1:]) < 0.05 * np.ptp(found.positions, axis=0).max()


def test_what_no_frame_constrains_stays_where_the_robot_is() -> None:
    only_x = {"goal": Frame([[1.0, 0.0], [0.0, 0.0]], [0.4, 0.0]).with_time()}
    found = TrajectoryModel(model()).retrieve(only_x, TIMES, state=[7.0, -3.0])
    np.testing.assert_allclose(found.positions[:, 1], -3.0, atol=1e-3)
    assert np.ptp(found.positions[:, 0]) > 0.3


def test_a_course_says_what_it_lacks() -> None:
    fresh = SmoothTrajectory(pose_model())
    with pytest.raises(ValueError, match="situate"):
        fresh.at(np.zeros(1))
    with pytest.raises(ValueError, match="three"):
        SmoothTrajectory(pose_model(), steps=2)
    timeless = TPGMM(2).fit([with_derivatives(d) for d in planar_demonstrations()])
    with pytest.raises(ValueError, match="duration_s"):
        SmoothTrajectory(timeless)
