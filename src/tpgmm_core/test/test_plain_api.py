# SPDX-License-Identifier: Apache-2.0
"""`model.adapt(frames).condition(dims, values)`: the same as the equations, at once, and never stale."""

from __future__ import annotations

import copy
import pickle
import threading

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import plain_api
from numpy_tpgmm import NumpyTPGMM, condition_on_first
from numpy_tpgmm import adapt as numpy_adapt
from random_problems import random_covariance, random_quaternion, random_rotation
from tpgmm_core import TPGMM, Adapter, Frame, Gaussian, GaussianMixture, Gaussians, Manifold
from tpgmm_core.geometry import kernels_condition
from tpgmm_core.learning.dirichlet import DirichletTPGMM
from tpgmm_core.learning.endpoints import EndpointTPGMM
from tpgmm_core.learning.hidden_markov.hmm import TPHMM
from tpgmm_core.learning.hidden_markov.hsmm import TPHSMM
from tpgmm_core.learning.incremental.online import OnlineTPGMM
from tpgmm_core.model.adaptation import UNCONSTRAINED_VARIANCE
from workloads import W1, W2, Workload, demonstrations, pose_demonstrations

SPACES = {
    "R4": [[0], [2, 0], [1, 3], [3]],
    "R1 x R3 x S3": [[0], [0, 2], [4, 5, 6, 7], [1, 0, 4, 5, 6, 7], [0, 1, 2, 3]],
    "S3 x R1 x S3": [[4], [0, 1, 2, 3], [5, 6, 7, 8, 4], [4, 0, 1, 2, 3]],
}


def random_mixture(rng: np.random.Generator, manifold: Manifold, K: int, spread: float = 0.5) -> GaussianMixture:
    """Components that overlap, around a random point."""
    centre = rng.normal(size=manifold.dim)
    for s in manifold.spheres:
        centre[s.ambient] = random_quaternion(rng)
    n = manifold.tangent_dim
    means = manifold.exp(np.tile(centre, (K, 1)), spread * rng.normal(size=(K, n)) / np.sqrt(n))
    covariances = np.stack([random_covariance(rng, n, 0.3) + 0.01 * np.eye(n) for _ in range(K)])
    return GaussianMixture(rng.dirichlet(np.ones(K)), means, covariances, manifold)


@settings(max_examples=60)
@given(seed=st.integers(0, 2**32 - 1), space=st.sampled_from(sorted(SPACES)), K=st.integers(1, 7), T=st.integers(1, 70))
def test_regression_of_any_dimensions_is_that_of_the_equations(seed: int, space: str, K: int, T: int) -> None:
    rng, manifold = np.random.default_rng(seed), Manifold.parse(space)
    dims = SPACES[space][rng.integers(len(SPACES[space]))]
    mixture = random_mixture(rng, manifold, K)
    values = manifold.exp(mixture.means[rng.integers(K, size=T)], 0.3 * rng.normal(size=(T, manifold.tangent_dim)))
    values = values[:, dims]
    several = mixture.condition(dims, values)
    assert isinstance(several, Gaussians) and len(several) == T
    for t in {0, T // 2, T - 1}:
        mean, covariance = plain_api.condition(mixture, dims, values[t])
        one = mixture.condition(dims, values[t])
        for g in (one, several[t]):
            assert isinstance(g, Gaussian)
            assert np.abs(g.manifold.log(mean, g.mean)).max() < 1e-12 * max(1.0, np.abs(mean).max())
            np.testing.assert_allclose(g.covariance, covariance, rtol=0.0, atol=1e-11 * np.abs(covariance).max())
            np.testing.assert_array_equal(g.covariance, g.covariance.T)


def random_model(rng: np.random.Generator, dims: dict[str, int], K: int) -> TPGMM:
    model = TPGMM(K)
    model.frame_names_, model.manifold_ = tuple(dims), Manifold.euclidean(max(dims.values()))
    model.priors_ = rng.dirichlet(np.ones(K))
    model.means_ = {name: 0.5 * rng.normal(size=(K, D)) for name, D in dims.items()}
    model.covariances_ = {
        name: np.stack([random_covariance(rng, D, 0.3) + 0.02 * np.eye(D) for _ in range(K)])
        for name, D in dims.items()
    }
    return model


def random_frame(rng: np.random.Generator, D: int, D_j: int) -> Frame:
    """A turn, a scaling, a reflection or any of these, or a rectangular map; some with an inverse of their own."""
    b = rng.normal(size=D)
    if D_j != D:
        A = random_rotation(rng, max(D, D_j))[:D, :D_j] * rng.uniform(0.5, 2.0)
        return Frame(A, b, np.linalg.pinv(A) * rng.uniform(0.5, 1.0) if rng.random() < 0.3 else None)
    flip = np.diag(rng.choice([-1.0, 1.0], D))
    scale = np.diag(rng.uniform(0.5, 2.0, D)) if rng.random() < 0.5 else np.eye(D)
    A = random_rotation(rng, D) @ flip @ scale
    return Frame(A, b, np.linalg.inv(A) * rng.uniform(0.5, 1.0) if rng.random() < 0.3 else None)


@settings(max_examples=60)
@given(seed=st.integers(0, 2**32 - 1), D=st.integers(2, 5), P=st.integers(1, 4), K=st.integers(1, 8))
def test_the_plain_api_is_the_equations_for_any_frames(seed: int, D: int, P: int, K: int) -> None:
    rng = np.random.default_rng(seed)
    dims = {f"f{j}": D if j == 0 else int(rng.choice([D, D, max(1, D - 1), D + 1])) for j in range(P)}
    model = random_model(rng, dims, K)
    for _ in range(2):  # the second call is the one that finds something prepared
        seen = [name for name in dims if name == "f0" or rng.random() < 0.7]
        frames = {name: random_frame(rng, D, dims[name]) for name in seen}
        weights = {name: float(rng.uniform(0.2, 1.0)) for name in seen if rng.random() < 0.5}
        state = rng.normal(size=D)
        mixture = model.adapt(frames, state, weights)
        means, covariances = plain_api.adapt(model, frames, weights, state, 1.0 / UNCONSTRAINED_VARIANCE)
        scale = np.abs(covariances).max()
        np.testing.assert_allclose(mixture.means, means, rtol=0.0, atol=1e-10 * max(1.0, np.abs(means).max()))
        np.testing.assert_allclose(mixture.covariances, covariances, rtol=0.0, atol=1e-10 * scale)
        value = mixture.means[0, :1] + 0.1
        mean, covariance = plain_api.condition(mixture, [0], value)
        g = mixture.condition([0], value)
        assert isinstance(g, Gaussian)
        np.testing.assert_allclose(g.mean, mean, rtol=0.0, atol=1e-11 * max(1.0, np.abs(mixture.means).max()))
        np.testing.assert_allclose(g.covariance, covariance, rtol=0.0, atol=1e-10 * max(1.0, np.abs(covariance).max()))


@pytest.mark.parametrize("work", [W1, W2])
def test_the_benchmarks_work_has_the_values_of_plain_numpy(work: Workload) -> None:
    model = TPGMM(work.K, reg_covar=1e-5, max_iter=5).fit(demonstrations(work))
    plain = NumpyTPGMM(model.priors_, list(model.means_.values()), list(model.covariances_.values()))
    times = np.linspace(0.0, 2.0, 200)
    for seed in (1, 2):
        frames = demonstrations(work, seed)[0].frames
        means, covariances = numpy_adapt(plain, [(frame.A, frame.b) for frame in frames.values()])
        several = model.adapt(frames).condition([0], times[:, None])
        for i in (0, 63, 64, 199):
            mean, covariance, _ = condition_on_first(plain.priors, means, covariances, times[i])
            one = model.adapt(frames).condition([0], [times[i]])
            for g in (one, several[i]):
                np.testing.assert_allclose(g.mean, mean, rtol=0.0, atol=1e-12)
                np.testing.assert_allclose(g.covariance, covariance, rtol=0.0, atol=1e-12)


def test_as_many_times_as_anybody_likes_are_the_same_as_one_by_one() -> None:
    """More than are taken side by side, for which the arrays lie otherwise in memory than those of one."""
    mixture = random_mixture(np.random.default_rng(6), Manifold.euclidean(5), 6)
    values = np.linspace(-2.0, 2.0, 601)[:, None]
    several = mixture.condition([0], values)
    assert several.mean.shape == (601, 4) and several.covariance.shape == (601, 4, 4)
    for t in (0, 17, 255, 256, 400, 511, 512, 600):
        one, other = mixture.condition([0], values[t]), several[t]
        np.testing.assert_allclose(other.mean, one.mean, rtol=1e-12, atol=1e-14)
        np.testing.assert_allclose(other.covariance, one.covariance, rtol=1e-12, atol=1e-14)
        np.testing.assert_array_equal(other.covariance, other.covariance.T)
        for array in (other.mean, other.covariance):
            assert array.flags.c_contiguous and not array.flags.writeable and array.base is None


def learned(rng: np.random.Generator) -> tuple[TPGMM, dict[str, Frame]]:
    return random_model(rng, {"a": 3, "b": 3}, 4), {name: random_frame(rng, 3, 3) for name in ("a", "b")}


def assert_fresh(model: TPGMM, frames: dict[str, Frame]) -> None:
    """What the model says is what an adapter that was made now says."""
    found, expected = model.adapt(frames), Adapter(model).adapt(frames)
    np.testing.assert_array_equal(found.priors, expected.priors)
    np.testing.assert_array_equal(found.means, expected.means)
    np.testing.assert_array_equal(found.covariances, expected.covariances)


def numbers(mixture: GaussianMixture) -> np.ndarray:
    return np.concatenate([mixture.means.ravel(), mixture.covariances.ravel()])


def test_whatever_is_changed_by_hand_counts_at_once() -> None:
    rng = np.random.default_rng(0)
    model, frames = learned(rng)
    before = model.adapt(frames)
    kept = before.means.copy()
    seen = [numbers(before)]
    for change in (
        lambda: model.means_.update(a=model.means_["a"] + 0.1),
        lambda: model.means_["b"].__iadd__(0.1),
        lambda: model.means_["b"].__setitem__((3, 2), 7.0),
        lambda: model.covariances_["a"].__imul__(2.0),
        lambda: model.covariances_["b"][2].__imul__(3.0),
        lambda: setattr(model, "covariances_", {name: 1.5 * C for name, C in model.covariances_.items()}),
        lambda: setattr(model, "means_", {name: mean[:, ::-1].copy() for name, mean in model.means_.items()}),
    ):
        change()
        assert_fresh(model, frames)
        assert np.abs(numbers(model.adapt(frames)) - seen[-1]).max() > 1e-3
        seen.append(numbers(model.adapt(frames)))
    np.testing.assert_array_equal(before.means, kept)
    model.priors_[:] = [0.7, 0.1, 0.1, 0.1]
    np.testing.assert_array_equal(model.adapt(frames).priors, [0.7, 0.1, 0.1, 0.1])
    model.frame_names_ = ("a",)
    assert_fresh(model, {"a": frames["a"]})
    with pytest.raises(ValueError, match="unknown frame 'b'"):
        model.adapt(frames)
    model.covariances_["a"][1] *= -1.0
    with pytest.raises(ValueError, match="'a' are not positive definite"):
        model.adapt({"a": frames["a"]})


def test_a_mixture_shares_nothing_with_the_model_or_with_others() -> None:
    model, frames = learned(np.random.default_rng(1))
    one, two = model.adapt(frames), model.adapt(frames)
    for array in (one.priors, one.means, one.covariances):
        array[:] = 0.0
    assert_fresh(model, frames)
    assert two.priors.sum() == pytest.approx(1.0) and np.abs(two.means).max() > 0.0
    kept = two.means.copy()
    model.adapt({"a": frames["a"]})
    np.testing.assert_array_equal(two.means, kept)


ESTIMATORS = [
    TPGMM(4), TPGMM(4, covariance="mfa", reg_covar=1e-3), DirichletTPGMM(4, max_iter=20), TPHMM(4), TPHSMM(4),
    EndpointTPGMM(4), OnlineTPGMM(4),
]  # fmt: skip


@pytest.mark.parametrize("estimator", ESTIMATORS, ids=repr)
def test_copies_pickles_and_other_fits_leave_nothing_stale_behind(estimator: TPGMM) -> None:
    demos = demonstrations(Workload("small", 4, 30, 2, 3, 4))
    others = demonstrations(Workload("small", 4, 30, 2, 3, 4), seed=9)
    frames = demos[0].frames
    model = copy.deepcopy(estimator).fit(demos)
    size = len(pickle.dumps(model))
    before = model.adapt(frames).condition([0], [1.0])
    assert len(pickle.dumps(model)) == size and set(copy.copy(model).__dict__) == set(
        pickle.loads(pickle.dumps(model)).__dict__
    )
    for other in (copy.copy(model), copy.deepcopy(model), pickle.loads(pickle.dumps(model))):
        np.testing.assert_array_equal(other.adapt(frames).condition([0], [1.0]).mean, before.mean)
        other.means_ = {name: mean + 1.0 for name, mean in other.means_.items()}
        assert_fresh(other, frames)
        np.testing.assert_array_equal(model.adapt(frames).condition([0], [1.0]).mean, before.mean)
    model.fit(others)
    assert_fresh(model, frames)
    fresh = copy.deepcopy(estimator).fit(others)
    np.testing.assert_array_equal(model.adapt(frames).means, fresh.adapt(frames).means)
    assert np.abs(model.adapt(frames).condition([0], [1.0]).mean - before.mean).max() > 1e-6
    assert model.score(others) == fresh.score(others) and model.n_parameters_ == fresh.n_parameters_


def test_means_set_by_hand_reach_the_likelihood_and_the_file_of_a_structured_model(tmp_path: object) -> None:
    demos = demonstrations(Workload("small", 4, 30, 2, 3, 4))
    model = TPGMM(4, covariance="diag", reg_covar=1e-3).fit(demos)
    score, n_parameters = model.score(demos), model.n_parameters_
    name = model.frame_names_[0]
    model.covariances_[name] = 4.0 * model.covariances_[name]
    assert model.score(demos) < score - 0.1 and model.n_parameters_ > n_parameters
    path = f"{tmp_path}/changed.tpgmm"
    model.save(path)
    loaded = TPGMM.load(path)
    np.testing.assert_array_equal(loaded.covariances_[name], model.covariances_[name])
    assert loaded.score(demos) == pytest.approx(model.score(demos), rel=1e-12)


def test_threads_that_adapt_at_once_do_not_mix() -> None:
    rng = np.random.default_rng(2)
    model, _ = learned(rng)
    situations = [{name: random_frame(rng, 3, 3) for name in ("a", "b")} for _ in range(6)]
    expected = [Adapter(model).adapt(frames) for frames in situations]
    wrong: list[int] = []

    def work(i: int) -> None:
        for _ in range(2000):
            mixture = model.adapt(situations[i])
            if not np.array_equal(mixture.means, expected[i].means):
                wrong.append(i)

    threads = [threading.Thread(target=work, args=(i,)) for i in range(len(situations))]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert not wrong


def test_a_call_that_is_refused_leaves_the_next_one_right() -> None:
    model, frames = learned(np.random.default_rng(3))
    with pytest.raises(ValueError, match="weight"):
        model.adapt(frames, weights={"a": 2.0})
    assert_fresh(model, frames)
    with pytest.raises(ValueError, match="not fitted"):
        TPGMM().adapt(frames)


def test_several_gaussians_are_a_sequence() -> None:
    mixture = random_mixture(np.random.default_rng(4), Manifold.parse("R1 x R3 x S3"), 3)
    several = mixture.condition([0], np.linspace(-1.0, 1.0, 7)[:, None])
    assert isinstance(several, Gaussians) and several.mean.shape == (7, 7) and several.covariance.shape == (7, 6, 6)
    assert len(several) == len(list(several)) == 7 and len(several[2:4]) == 2
    np.testing.assert_array_equal(several[2:4][1].mean, several[3].mean)
    np.testing.assert_array_equal(several[-1].mean, several.mean[-1])
    assert len(mixture.condition([0], np.zeros((0, 1)))) == 0
    with pytest.raises(ValueError, match="read-only"):
        several.mean[0] = 0.0


def test_values_that_do_not_fit_are_refused() -> None:
    mixture = random_mixture(np.random.default_rng(5), Manifold.parse("R1 x R3 x S3"), 3)
    for dims, values, message in (
        ([0], np.zeros(200), r"values\[:, None\]"),
        ([0, 1], [0.0], r"shape \(2,\)"),
        ([0], [np.nan], "finite"),
        ([0], [1e300], "far"),
        ([5], [0.0], "split a quaternion"),
        ([0, 0], [0.0, 0.0], "distinct"),
        (range(8), np.zeros(8), "distinct"),
        ([8], [0.0], "0 to 7"),
    ):
        with pytest.raises(ValueError, match=message):
            mixture.condition(dims, values)
    flat = GaussianMixture([1.0], np.zeros((1, 2)), np.diag([0.0, 1.0])[None])
    with pytest.raises(ValueError, match="component 0 is not positive definite"):
        flat.condition([0], [0.0])


def test_no_way_of_calling_compiles_anew() -> None:
    model = TPGMM(4, manifold="R1 x R3 x S3", max_iter=2).fit(pose_demonstrations(2, 20))
    frames = pose_demonstrations(1)[0].frames
    mixture = model.adapt(frames)
    mixture.condition([0], [0.5])
    before = len(kernels_condition.condition.signatures)
    strided = GaussianMixture(
        mixture.priors, mixture.means[:, ::-1][:, ::-1], np.asfortranarray(mixture.covariances), mixture.manifold
    )
    frozen = GaussianMixture(
        *(a.copy() for a in (mixture.priors, mixture.means, mixture.covariances)), mixture.manifold
    )
    for array in (frozen.priors, frozen.means, frozen.covariances):
        array.setflags(write=False)
    values = np.broadcast_to(np.float32(0.5), (3, 1))
    for other in (mixture, strided, frozen):
        np.testing.assert_array_equal(other.condition([0], values).mean, mixture.condition((0,), [[0.5]] * 3).mean)
        np.testing.assert_array_equal(
            other.condition(np.array([0]), np.array([1, 2])[:1]).mean, mixture.condition([0], [1.0]).mean
        )
    assert len(kernels_condition.condition.signatures) == before == 1
    flat = [GaussianMixture(m.priors, m.means[:, :4], m.covariances[:, :4, :4]) for m in (mixture, strided, frozen)]
    for other in flat:
        np.testing.assert_array_equal(
            other.condition(np.array([0]), np.float32([0.5])).mean, flat[0].condition((0,), [0.5]).mean
        )
    assert len(kernels_condition.condition_one.signatures) == 1
