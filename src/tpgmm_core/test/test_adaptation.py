# SPDX-License-Identifier: Apache-2.0
from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from random_problems import random_covariance, random_quaternion, random_rotation
from tpgmm_core import TPGMM, Adapter, Frame, Gaussian, GaussianMixture, Manifold
from tpgmm_core.model import kernels_adapt, kernels_regress
from tpgmm_core.model.adaptation import UNCONSTRAINED_VARIANCE
from tpgmm_core.retrieval.regression import AdaptThenRegress, RegressThenProduct
from tpgmm_core.warm_up import warm_up
from workloads import pose_demonstrations


def model_of(manifold: str, dims: dict[str, int], K: int, rng: np.random.Generator) -> TPGMM:
    """A model with random parameters, as if it had been learned."""
    model = TPGMM(K, manifold=manifold)
    model.frame_names_ = tuple(dims)
    model.manifold_ = Manifold.parse(manifold, max(dims.values()))
    model.priors_ = rng.dirichlet(np.ones(K))
    model.means_, model.covariances_ = {}, {}
    for name, D in dims.items():
        model.means_[name] = 0.5 * rng.normal(size=(K, D))
        for s in model.manifold_.spheres:
            near = model.manifold_.exp(np.r_[np.zeros(D - 4), 0, 0, 0, 1], 0.3 * rng.normal(size=(K, D - 1)))
            model.means_[name][:, s.ambient] = near[:, s.ambient]
        n = model.frame_manifolds_[name].tangent_dim
        model.covariances_[name] = np.stack([random_covariance(rng, n, 0.3) for _ in range(K)])
    return model


def expected(
    model: TPGMM, frames: dict[str, Frame], weights: dict[str, float], k: int
) -> tuple[np.ndarray, np.ndarray]:
    """Eqs. (5) and (6) with explicit pseudo-inverses."""
    H, h = 0.0, 0.0
    for name, frame in frames.items():
        inverse = np.linalg.pinv(frame.A)
        precision = weights.get(name, 1.0) * inverse.T @ np.linalg.inv(model.covariances_[name][k]) @ inverse
        H = H + precision
        h = h + precision @ (frame.A @ model.means_[name][k] + frame.b)
    return np.linalg.solve(H, h), np.linalg.inv(H)


@settings(max_examples=40)
@given(seed=st.integers(0, 2**32 - 1), D=st.integers(2, 7), P=st.integers(1, 4), K=st.integers(1, 11))
def test_adapt_matches_explicit_inverses_for_any_invertible_frame(seed: int, D: int, P: int, K: int) -> None:
    rng = np.random.default_rng(seed)
    model = model_of("euclidean", {f"f{j}": D for j in range(P)}, K, rng)
    kinds = [
        random_rotation(rng, D),
        np.sqrt(0.1) * random_rotation(rng, D),
        random_rotation(rng, D) @ np.diag([-1.0] + [1.0] * (D - 1)),
        random_rotation(rng, D) @ np.diag(rng.uniform(0.3, 3.0, D)) @ random_rotation(rng, D),
    ]
    frames = {f"f{j}": Frame(kinds[rng.integers(4)], rng.normal(size=D)) for j in range(P)}
    weights = {f"f{j}": float(rng.uniform(0.1, 1.0)) for j in range(P)}
    mixture = model.adapt(frames, weights=weights)
    for k in range(K):
        mean, covariance = expected(model, frames, weights, k)
        np.testing.assert_allclose(mixture.means[k], mean, rtol=1e-9, atol=1e-9)
        np.testing.assert_allclose(mixture.covariances[k], covariance, rtol=1e-8, atol=1e-10)
        images = [mixture_component(model, name, k).transform(frame) for name, frame in frames.items()]
        if all(w == 1.0 for w in weights.values()):
            np.testing.assert_allclose(Gaussian.product(images).mean, mean, rtol=1e-7, atol=1e-8)
    np.testing.assert_array_equal(mixture.priors, model.priors_)


def mixture_component(model: TPGMM, name: str, k: int) -> Gaussian:
    return Gaussian(model.means_[name][k], model.covariances_[name][k], model.frame_manifolds_[name])


def test_rectangular_frames_of_different_dimensions_add_up() -> None:
    rng = np.random.default_rng(1)
    model = model_of("euclidean", {"wide": 5, "same": 4, "narrow": 2}, 3, rng)
    frames = {
        "wide": Frame(rng.normal(size=(4, 5)), rng.normal(size=4)),
        "same": Frame(rng.normal(size=(4, 4)), rng.normal(size=4)),
        "narrow": Frame(rng.normal(size=(4, 2)), rng.normal(size=4)),
    }
    mixture = model.adapt(frames)
    assert mixture.means.shape == (3, 4)
    for k in range(3):
        mean, covariance = expected(model, frames, {}, k)
        np.testing.assert_allclose(mixture.means[k], mean, rtol=1e-8, atol=1e-8)
        np.testing.assert_allclose(mixture.covariances[k], covariance, rtol=1e-7, atol=1e-9)


def test_what_no_frame_constrains_stays_at_the_state() -> None:
    rng = np.random.default_rng(2)
    model = model_of("euclidean", {"tall": 2, "flat": 4}, 2, rng)
    A = np.linalg.qr(rng.normal(size=(4, 2)))[0]
    state = rng.normal(size=4)
    mixture = model.adapt({"tall": Frame(A, np.zeros(4))}, state)
    free = np.linalg.svd(A)[0][:, 2:]
    for k in range(2):
        np.testing.assert_allclose(A.T @ mixture.means[k], model.means_["tall"][k], atol=1e-6)
        np.testing.assert_allclose(free.T @ mixture.means[k], free.T @ state, atol=1e-6)
        np.testing.assert_allclose(A.T @ mixture.covariances[k] @ A, model.covariances_["tall"][k], rtol=1e-6)
        loose = free.T @ mixture.component(k).covariance @ free
        np.testing.assert_allclose(loose / UNCONSTRAINED_VARIANCE, np.eye(2), atol=1e-3)
    np.testing.assert_allclose(model.adapt({"tall": Frame(A, np.zeros(4))}).means @ free, 0.0, atol=1e-6)
    # a square frame of lower rank: a null-space projection
    N = np.eye(4) - A @ A.T
    mixture = model.adapt({"flat": Frame(N, np.zeros(4))}, state)
    np.testing.assert_allclose(mixture.means @ A, np.tile(A.T @ state, (2, 1)), atol=1e-6)


def test_a_state_counts_for_its_own_call_alone() -> None:
    rng = np.random.default_rng(2)
    model = model_of("euclidean", {"tall": 2}, 2, rng)
    tall = {"tall": Frame(np.linalg.qr(rng.normal(size=(4, 2)))[0], np.zeros(4))}
    adapter = Adapter(model)
    fresh = adapter.adapt(tall).means
    assert np.abs(adapter.adapt(tall, np.full(4, 3.0)).means - fresh).max() > 0.1
    np.testing.assert_array_equal(adapter.adapt(tall).means, fresh)


def test_a_frame_fades_out_without_a_jump() -> None:
    rng = np.random.default_rng(3)
    model = model_of("euclidean", {"a": 3, "b": 3}, 2, rng)
    frames = {name: Frame(random_rotation(rng, 3), rng.normal(size=3)) for name in ("a", "b")}
    adapter = Adapter(model)
    means = [adapter.adapt(frames, weights={"b": w}).means for w in np.linspace(1.0, 0.0, 2001)]
    assert np.abs(np.diff(means, axis=0)).max() < 0.05
    np.testing.assert_allclose(means[-1], adapter.adapt({"a": frames["a"]}).means, atol=1e-12)
    state = np.array([5.0, 5.0, 5.0])
    lone = [adapter.adapt({"a": frames["a"]}, state, {"a": w}).means for w in (1e-9, 1e-12, 0.0)]
    np.testing.assert_allclose(lone[-1], np.tile(state, (2, 1)))
    np.testing.assert_allclose(lone[1], lone[-1], atol=1e-3)


def pose_frames(rng: np.random.Generator) -> dict[str, Frame]:
    """Frames whose views agree to within some tenths of a radian."""
    turns = Manifold.parse("S3").exp([0.0, 0.0, 0.0, 1.0], 0.2 * rng.normal(size=(3, 3)))
    names = ("object", "target", "robot")
    return {n: Frame.from_pose(0.1 * rng.normal(size=3), q).with_time() for n, q in zip(names, turns, strict=True)}


def test_poses_adapt_to_the_product_of_the_frames_gaussians() -> None:
    rng = np.random.default_rng(4)
    model = model_of("R1 x R3 x S3", {"object": 8, "target": 8, "robot": 8}, 4, rng)
    frames = pose_frames(rng)
    mixture = model.adapt(frames)
    for k in range(4):
        product = Gaussian.product([mixture_component(model, name, k).transform(f) for name, f in frames.items()])
        assert mixture.manifold.distance(mixture.means[k], product.mean) < 1e-10
        np.testing.assert_allclose(mixture.covariances[k], product.covariance, rtol=1e-7, atol=1e-11)


def test_moving_the_world_moves_the_reproduction() -> None:
    rng = np.random.default_rng(5)
    model = model_of("R1 x R3 x S3", {"object": 8, "target": 8, "robot": 8}, 4, rng)
    frames, adapter = pose_frames(rng), Adapter(model)
    world = Frame.from_pose(rng.normal(size=3), random_quaternion(rng)).with_time()
    moved_frames = {name: Frame(world.A @ f.A, world.A @ f.b + world.b) for name, f in frames.items()}
    for t in (-0.3, 0.0, 0.4):
        mean, covariance, h = (a.copy() for a in adapter.adapt_and_condition(frames, [t]))
        moved_mean, moved_covariance, moved_h = adapter.adapt_and_condition(moved_frames, [t])
        manifold = model.manifold_.subset(range(1, 8))
        there = world.A[1:, 1:] @ mean[0] + world.b[1:]
        T = manifold.tangent_map(world.A[1:, 1:])
        assert manifold.distance(there, moved_mean[0]) < 1e-9
        np.testing.assert_allclose(T @ covariance[0] @ T.T, moved_covariance[0], atol=1e-9)
        np.testing.assert_allclose(h, moved_h, atol=1e-9)


def test_quaternion_signs_do_not_matter() -> None:
    rng = np.random.default_rng(6)
    model = model_of("R1 x R3 x S3", {"object": 8, "target": 8, "robot": 8}, 3, rng)
    frames = pose_frames(rng)
    mean, covariance, _ = Adapter(model).adapt_and_condition(frames, [0.1])
    model.means_["target"][1, 4:] *= -1.0
    negative = frames["object"].A.copy()
    negative[4:, 4:] *= -1.0
    frames["object"] = Frame(negative, frames["object"].b)
    other_mean, other_covariance, _ = Adapter(model).adapt_and_condition(frames, [0.1])
    assert model.manifold_.subset(range(1, 8)).distance(mean[0], other_mean[0]) < 1e-10
    np.testing.assert_allclose(covariance, other_covariance, atol=1e-10)


@pytest.mark.parametrize("manifold", ["euclidean", "R1 x R3 x S3"])
def test_the_compiled_regression_is_that_of_the_mixture(manifold: str) -> None:
    rng = np.random.default_rng(7)
    model = model_of(manifold, {"object": 8, "target": 8, "robot": 8}, 5, rng)
    frames, adapter = pose_frames(rng), Adapter(model)
    times = np.array([-0.5, 0.0, 0.3, 9.0])
    means, covariances, activations = adapter.adapt_and_condition(frames, times, {"robot": 0.5})
    mixture = adapter.adapt(frames, weights={"robot": 0.5})
    np.testing.assert_allclose(activations, mixture.responsibilities([0], times[:1]), atol=1e-12)
    for mean, covariance, t in zip(means, covariances, times, strict=True):
        g = mixture.condition([0], [t])
        assert g.manifold.distance(mean, g.mean) < 1e-9
        np.testing.assert_allclose(covariance, g.covariance, rtol=1e-8, atol=1e-10)
    for array, again in zip((means, covariances, activations), adapter.condition(times), strict=True):
        np.testing.assert_allclose(array, again, rtol=1e-9, atol=1e-11)


def test_results_are_the_callers_to_keep() -> None:
    rng = np.random.default_rng(8)
    model = model_of("euclidean", {"a": 3}, 2, rng)
    adapter = Adapter(model)
    first = adapter.adapt_and_condition({"a": Frame(np.eye(3), np.zeros(3))}, [0.0])
    kept = [array.copy() for array in first]
    adapter.adapt_and_condition({"a": Frame(np.eye(3), np.ones(3))}, [0.5])
    for array, copy in zip(first, kept, strict=True):
        np.testing.assert_array_equal(array, copy)


def test_no_step_waits_for_the_compiler() -> None:
    warm_up()
    kernels = kernels_adapt.adapt, kernels_regress.regress_all
    before = [len(kernel.signatures) for kernel in kernels]
    model = TPGMM(3, manifold="R1 x R3 x S3").fit(pose_demonstrations(2, n_samples=30))
    Adapter(model).adapt_and_condition(pose_demonstrations(1)[0].frames, np.array([0.2]))
    rng = np.random.default_rng(9)
    flat = model_of("euclidean", {"a": 3, "b": 2}, 2, rng)
    frames = {"a": Frame(np.eye(3), np.zeros(3)), "b": Frame(np.eye(3, 2), np.zeros(3))}
    Adapter(flat).adapt_and_condition(frames, [0.0, 1.0], {"a": 0.5}, np.zeros(3))
    assert [len(kernel.signatures) for kernel in kernels] == before == [1, 1]


def test_bad_situations_are_refused_with_the_reason() -> None:
    rng = np.random.default_rng(10)
    model = model_of("euclidean", {"a": 3, "b": 3}, 2, rng)
    good = Frame(np.eye(3), np.zeros(3))
    with pytest.raises(ValueError, match=r"unknown frame 'c'; the model knows \['a', 'b'\]"):
        model.adapt({"c": good})
    with pytest.raises(ValueError, match="at least one of the frames"):
        model.adapt({})
    with pytest.raises(ValueError, match="4 columns"):
        model.adapt({"a": Frame(np.zeros((3, 4)), np.zeros(3))})
    with pytest.raises(ValueError, match="maps to 2 dimensions"):
        model.adapt({"a": good, "b": Frame(np.zeros((2, 3)), np.zeros(2))})
    with pytest.raises(ValueError, match="varies with time"):
        model.adapt({"a": Frame(np.zeros((5, 3, 3)), np.zeros(3))})
    with pytest.raises(ValueError, match="weight"):
        model.adapt({"a": good}, weights={"a": 1.5})
    with pytest.raises(ValueError, match="weight"):
        model.adapt({"a": good}, weights={"a": float("nan")})
    with pytest.raises(ValueError, match="state"):
        model.adapt({"a": good}, state=[0.0, 0.0])
    pose = model_of("R1 x R3 x S3", {"a": 8}, 2, rng)
    with pytest.raises(ValueError, match="S3"):
        pose.adapt({"a": Frame(2.0 * np.eye(8), np.zeros(8))})
    for row, column in ((2, 5), (5, 2)):  # positions that depend on a quaternion, and a quaternion on positions
        mixed = np.eye(8)
        mixed[row, column] = 0.1
        with pytest.raises(ValueError, match="S3"):
            pose.adapt({"a": Frame(mixed, np.zeros(8))})
    with pytest.raises(ValueError, match="time as the first dimension"):
        Adapter(model_of("euclidean", {"a": 1}, 2, rng)).adapt_and_condition({"a": Frame([[1.0]], [0.0])}, [0.0])


def test_contradicting_orientations_give_finite_results_or_a_reason() -> None:
    rng = np.random.default_rng(11)
    model = model_of("R1 x R3 x S3", {"object": 8, "target": 8, "robot": 8}, 4, rng)
    adapter = Adapter(model)
    refused = 0
    for _ in range(200):
        frames = {n: Frame.from_pose(rng.normal(size=3), random_quaternion(rng)).with_time() for n in model.means_}
        try:
            mean, covariance, _ = adapter.adapt_and_condition(frames, [0.0])
        except ValueError as error:
            assert "contradict each other" in str(error)
            refused += 1
            continue
        assert np.all(np.isfinite(mean)) and np.linalg.eigvalsh(covariance[0]).min() > 0.0
    assert refused <= 2


def test_regression_matches_the_closed_form_of_one_component() -> None:
    rng = np.random.default_rng(12)
    S = random_covariance(rng, 3)
    mixture = GaussianMixture([1.0], [[0.0, 1.0, 2.0]], [S])
    g, c = mixture.condition([0], [0.7]), mixture.component(0).condition([0], [0.7])
    np.testing.assert_allclose(g.mean, c.mean)
    np.testing.assert_allclose(g.covariance, c.covariance)


def test_an_inverse_of_its_own_carries_the_precision() -> None:
    rng = np.random.default_rng(11)
    model = model_of("euclidean", {"a": 2, "b": 4}, 3, rng)
    seen = rng.normal(size=(2, 4))
    frames = {"a": Frame(rng.normal(size=(4, 2)), rng.normal(size=4), seen), "b": Frame(np.eye(4), rng.normal(size=4))}
    mixture = model.adapt(frames)
    for k in range(3):
        terms = [(frames["a"], seen), (frames["b"], np.eye(4))]
        H, h = np.zeros((4, 4)), np.zeros(4)
        for (frame, M), name in zip(terms, "ab", strict=True):
            precision = M.T @ np.linalg.inv(model.covariances_[name][k]) @ M
            H += precision
            h += precision @ (frame.A @ model.means_[name][k] + frame.b)
        np.testing.assert_allclose(mixture.means[k], np.linalg.solve(H, h), atol=1e-9)
        np.testing.assert_allclose(mixture.covariances[k], np.linalg.inv(H), atol=1e-9)
    adapter = Adapter(model)  # and not longer than it is given
    adapter.adapt(frames)
    plain = {"a": Frame(frames["a"].A, frames["a"].b), "b": frames["b"]}
    np.testing.assert_array_equal(adapter.adapt(plain).means, model.adapt(plain).means)


def test_an_inverse_of_its_own_belongs_to_euclidean_data() -> None:
    model = model_of("R1 x S3", {"a": 5}, 1, np.random.default_rng(12))
    with pytest.raises(ValueError, match="its own inverse"):
        model.adapt({"a": Frame(np.eye(5), np.zeros(5), np.eye(5))})


@pytest.mark.parametrize("use", [Adapter, RegressThenProduct, AdaptThenRegress])
def test_a_model_that_is_not_fitted_is_refused(use: Callable[[TPGMM], object]) -> None:
    with pytest.raises(ValueError, match="this TPGMM is not fitted, .*call fit or load first"):
        use(TPGMM())
