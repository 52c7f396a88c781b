# SPDX-License-Identifier: Apache-2.0
from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.io import loadmat
from scipy.special import logsumexp
from scipy.stats import multivariate_normal

import numpy_tpgmm
from tpgmm_core import TPGMM, Demonstration, Frame, Manifold
from tpgmm_core.learning.estimation.compiled_em import PARTS_OF_A_THREAD
from tpgmm_core.learning.estimation.kernels_expectation import PART
from workloads import W1, W2, demonstrations, pose_demonstrations, projected

DATA02 = Path(__file__).parents[4] / "shared" / "data" / "pbdlib" / "Data02.mat"


def clusters(rng: np.random.Generator, N: int = 90, dims: tuple[int, ...] = (2, 3)) -> dict[str, np.ndarray]:
    """Three groups, seen from frames of different dimensions; time first."""
    group = np.sort(rng.integers(3, size=N))
    return {
        f"frame_{j}": np.column_stack(
            [np.linspace(0.0, 1.0, N), 3.0 * rng.normal(size=(3, D - 1))[group] + 0.3 * rng.normal(size=(N, D - 1))]
        )
        for j, D in enumerate(dims)
    }


def brute_force(model: TPGMM, X: dict[str, np.ndarray], seen: dict[str, np.ndarray]) -> tuple[float, np.ndarray]:
    """Mean log-likelihood and responsibilities (K, N), sample by sample and frame by frame."""
    N = len(next(iter(X.values())))
    log_joint = np.repeat(np.log(model.priors_)[:, None], N, axis=1)
    for name, x in X.items():
        for k in range(len(model.priors_)):
            density = multivariate_normal(model.means_[name][k], model.covariances_[name][k])
            log_joint[k, seen[name]] += density.logpdf(x[seen[name]])
    total = logsumexp(log_joint, axis=0)
    return float(total.mean()), np.exp(log_joint - total)


@pytest.mark.skipif(not DATA02.exists(), reason="pbdlib's Data02.mat is not in ../shared/data/pbdlib")
def test_reference_values_on_data02_are_met_to_all_digits() -> None:
    data = loadmat(DATA02)["Data"]
    model = TPGMM(n_components=3).fit_projected({"first": data[:, 0].T, "second": data[:, 1].T})
    assert model.n_iter_ == 8 and model.converged_
    np.testing.assert_allclose(model.log_likelihoods_[[0, -1]], [-2.704023, -2.471765], rtol=0, atol=5e-7)
    np.testing.assert_allclose(model.priors_, [0.40023, 0.25428, 0.34549], rtol=0, atol=5e-6)
    means = [[0.424341, -0.024678, 0.551346], [1.035234, 0.771874, 2.241621], [1.655415, 2.380758, 3.156574]]
    np.testing.assert_allclose(model.means_["first"], means, rtol=0, atol=5e-7)


@pytest.mark.skipif(not DATA02.exists(), reason="pbdlib's Data02.mat is not in ../shared/data/pbdlib")
def test_demonstrations_with_scaled_and_reflected_frames_give_the_projected_data() -> None:
    content = loadmat(DATA02, simplify_cells=True)
    demos = []
    for s in content["s"]:
        data = np.asarray(s["Data"], dtype=float)
        data = (data if data.shape[0] == 3 else data[:3]).T
        frames = {}
        for name, p in zip(("first", "second"), np.atleast_1d(s["p"]), strict=True):
            A, b = np.asarray(p["A"], dtype=float), np.asarray(p["b"], dtype=float).ravel()
            frames[name] = Frame(A, b) if len(b) == 3 else Frame(A, b).with_time()
        demos.append(Demonstration(data[:, 0], data, frames))
    views = np.concatenate([demo.projected()["second"] for demo in demos])
    np.testing.assert_allclose(views, content["Data"][:, 1].T, atol=1e-9)
    assert TPGMM().fit(demos).log_likelihood_ == pytest.approx(-2.471765, abs=5e-7)


def test_em_takes_the_same_course_as_plain_numpy() -> None:
    demos = demonstrations(W1)
    X = projected(demos)
    times = np.concatenate([demo.times for demo in demos])
    plain = numpy_tpgmm.fit(list(X.values()), times, W1.K, 1e-5, max_iter=30)
    model = TPGMM(W1.K, reg_covar=1e-5, max_iter=30).fit(demos)
    np.testing.assert_allclose(model.log_likelihoods_, plain.log_likelihoods, rtol=0, atol=1e-9)
    for j, name in enumerate(X):
        np.testing.assert_allclose(model.means_[name], plain.means[j], rtol=0, atol=1e-9)
        np.testing.assert_allclose(model.covariances_[name], plain.covariances[j], rtol=0, atol=1e-9)


@settings(max_examples=25)
@given(
    seed=st.integers(0, 2**32 - 1),
    dims=st.lists(st.integers(2, 4), min_size=1, max_size=3),
    K=st.integers(1, 4),
    N=st.integers(12, 400),
    hidden=st.floats(0.0, 0.6),
)
def test_the_penalised_objective_never_falls(seed: int, dims: list[int], K: int, N: int, hidden: float) -> None:
    rng = np.random.default_rng(seed)
    X = clusters(rng, N, tuple(dims))
    visible = {name: rng.random(N) >= hidden for name in X}
    for mask in visible.values():
        mask[0] = True
    settings = {"init": "kmeans", "regularization": "prior", "reg_covar": 1e-3, "tol": 0.0, "max_iter": 40}
    model = TPGMM(K, **settings).fit_projected(X, visible)
    assert np.diff(model.objectives_).min(initial=0.0) > -1e-9
    for name in X:
        assert np.all(np.isfinite(model.means_[name]))
        assert np.linalg.eigvalsh(model.covariances_[name]).min() > 0.0
    assert model.priors_.sum() == pytest.approx(1.0) and np.all(model.priors_ >= 0.0)


def test_a_frame_that_is_not_seen_is_no_factor_and_the_prior_counts_once() -> None:
    rng = np.random.default_rng(5)
    X = clusters(rng)
    visible = {name: rng.random(90) > 0.4 for name in X}
    start = TPGMM(init="kmeans").fit_projected(X)
    model = TPGMM(init=start, max_iter=1, reg_covar=0.0).fit_projected(X, visible)
    log_likelihood, r = brute_force(start, X, visible)
    assert model.log_likelihoods_[0] == pytest.approx(log_likelihood, abs=1e-9)
    np.testing.assert_allclose(model.priors_, r.mean(axis=1), atol=1e-9)
    for name, x in X.items():
        w = r[:, visible[name]]
        w = w / w.sum(axis=1, keepdims=True)
        means = w @ x[visible[name]]
        np.testing.assert_allclose(model.means_[name], means, atol=1e-9)
        for k in range(3):
            d = x[visible[name]] - means[k]
            np.testing.assert_allclose(model.covariances_[name][k], (w[k, :, None] * d).T @ d, atol=1e-9)


def test_what_a_hidden_sample_holds_does_not_matter() -> None:
    X = clusters(np.random.default_rng(6))
    mask = np.ones(90, dtype=bool)
    mask[20:40] = False
    spoilt = {**X, "frame_1": X["frame_1"].copy()}
    spoilt["frame_1"][~mask] = np.nan
    for init in ("time", "bins", "kmeans"):
        a = TPGMM(init=init).fit_projected(X, {"frame_1": mask})
        b = TPGMM(init=init).fit_projected(spoilt, {"frame_1": mask})
        np.testing.assert_array_equal(a.means_["frame_1"], b.means_["frame_1"])
        np.testing.assert_array_equal(a.covariances_["frame_1"], b.covariances_["frame_1"])


@pytest.mark.parametrize("spoilt_by", [np.nan, 0.0, 1e200])
def test_what_a_hidden_pose_holds_does_not_matter(spoilt_by: float) -> None:
    shown = [d.data for d in pose_demonstrations(4, n_samples=60)]
    X = {name: np.concatenate(shown) for name in ("a", "b")}
    mask = np.ones(len(X["a"]), dtype=bool)
    mask[70:110] = False
    spoilt = {**X, "b": np.where(mask[:, None], X["b"], spoilt_by)}
    for init in ("time", "kmeans"):
        one, other = (
            TPGMM(init=init, manifold="R1 x R3 x S3").fit_projected(views, {"b": mask}) for views in (X, spoilt)
        )
        for name in X:
            np.testing.assert_array_equal(one.means_[name], other.means_[name])
            np.testing.assert_array_equal(one.covariances_[name], other.covariances_[name])


def test_joint_kmeans_finds_groups_and_is_repeatable() -> None:
    X = clusters(np.random.default_rng(7), N=300)
    a, b = (TPGMM(init="kmeans", random_state=3).fit_projected(X) for _ in range(2))
    np.testing.assert_array_equal(a.log_likelihoods_, b.log_likelihoods_)
    assert a.log_likelihood_ >= TPGMM(init="bins").fit_projected(X).log_likelihood_ - 1e-6


def test_poses_are_learned_whatever_the_signs_of_their_quaternions() -> None:
    demos = pose_demonstrations(4, n_samples=60)
    flip = np.r_[np.ones(4), -np.ones(4)]
    flipped = [Demonstration(d.times, d.data * flip, d.frames) for d in demos]
    model = TPGMM(4, manifold="R1 x R3 x S3", regularization="prior").fit(demos)
    other = TPGMM(4, manifold="R1 x R3 x S3", regularization="prior").fit(flipped)
    assert np.diff(model.objectives_).min() > -1e-6
    np.testing.assert_allclose(model.log_likelihoods_, other.log_likelihoods_, atol=1e-9)
    for name in model.frame_names_:
        assert model.manifold_.distance(model.means_[name], other.means_[name]).max() < 1e-9
        np.testing.assert_allclose(np.linalg.norm(model.means_[name][:, 4:], axis=1), 1.0)


def test_on_a_narrow_cloud_the_sphere_is_learned_like_its_tangent_space() -> None:
    rng = np.random.default_rng(8)
    S3 = Manifold.parse("S3")
    base = np.array([0.5, 0.5, 0.5, 0.5])
    v = 1e-5 * rng.normal(size=(200, 3)) @ np.diag([1.0, 2.0, 3.0])
    on_sphere = TPGMM(1, init="bins", manifold="S3", reg_covar=0.0).fit_projected({"f": S3.exp(base, v)})
    flat = TPGMM(1, init="bins", reg_covar=0.0).fit_projected({"f": v})
    np.testing.assert_allclose(on_sphere.covariances_["f"], flat.covariances_["f"], rtol=1e-4, atol=1e-14)
    np.testing.assert_allclose(S3.log(base, on_sphere.means_["f"][0]), flat.means_["f"][0], atol=1e-10)


def test_moving_the_world_does_not_change_the_model() -> None:
    demos = pose_demonstrations(3, n_samples=50)
    rng = np.random.default_rng(9)
    q = rng.normal(size=4)
    world = Frame.from_pose(rng.normal(size=3), q / np.linalg.norm(q)).with_time()
    moved = [
        Demonstration(
            d.times,
            d.data @ world.A.T + world.b,
            {name: Frame(world.A @ f.A, world.A @ f.b + world.b) for name, f in d.frames.items()},
        )
        for d in demos
    ]
    a, b = (TPGMM(3, manifold="R1 x R3 x S3").fit(d) for d in (demos, moved))
    for name in a.frame_names_:
        assert a.manifold_.distance(a.means_[name], b.means_[name]).max() < 1e-9


def test_duplicated_data_and_too_many_components_stay_finite() -> None:
    point = np.tile([[0.0, 1.0], [1.0, 2.0]], (20, 1))
    model = TPGMM(2, init="kmeans").fit_projected({"a": point, "b": -point})
    assert np.isfinite(model.log_likelihood_)
    X = clusters(np.random.default_rng(10), N=30)
    model = TPGMM(20, init="kmeans", max_iter=200).fit_projected(X)
    assert all(np.all(np.isfinite(c)) for c in model.covariances_.values()) and np.all(model.priors_ >= 0.0)


def test_fit_tells_its_progress() -> None:
    told: list[tuple[int, float]] = []
    model = TPGMM().fit_projected(clusters(np.random.default_rng(0)), progress=lambda i, ll: told.append((i, ll)))
    assert [i for i, _ in told] == list(range(1, model.n_iter_ + 1))
    assert told[-1][1] == model.log_likelihood_


def test_the_estimator_follows_scikit_learn() -> None:
    model = TPGMM(n_components=5, init="kmeans")
    assert model.get_params()["n_components"] == 5 and model.get_params()["reg_covar"] == 1e-4
    assert model.set_params(tol=0.1) is model and model.tol == 0.1
    assert repr(model) == "TPGMM(n_components=5, init='kmeans', tol=0.1)"
    with pytest.raises(ValueError, match="no parameter 'components'"):
        model.set_params(components=3)
    assert not any(name.endswith("_") and not name.startswith("_") for name in vars(model))
    assert model.set_params(n_components=3).fit_projected(clusters(np.random.default_rng(0))) is model
    TPGMM(n_components=-1)  # the constructor stores, fit checks


@pytest.mark.parametrize(
    ("params", "message"),
    [
        ({"n_components": 0}, "n_components"),
        ({"n_components": 2.5}, "n_components"),
        ({"n_components": 1000}, "1000 components"),
        ({"init": "random"}, "init"),
        ({"reg_covar": -1.0}, "reg_covar"),
        ({"tol": np.nan}, "tol"),
        ({"max_iter": 0}, "max_iter"),
        ({"regularization": "none"}, "regularization"),
        ({"manifold": "R7"}, "R7"),
        ({"init": TPGMM()}, "not fitted"),
    ],
)
def test_bad_parameters_are_refused_by_fit(params: dict[str, Any], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        TPGMM(**params).fit_projected(clusters(np.random.default_rng(0)))


def test_bad_data_is_refused_with_the_reason() -> None:
    X = clusters(np.random.default_rng(0))
    nan = {**X, "frame_1": np.full((90, 3), np.nan)}
    with pytest.raises(ValueError, match="'frame_1' must be finite"):
        TPGMM().fit_projected(nan)
    with pytest.raises(ValueError, match="never seen"):
        TPGMM().fit_projected(X, {"frame_1": np.zeros(90, dtype=bool)})
    with pytest.raises(ValueError, match="'frame_1' has"):
        TPGMM().fit_projected({**X, "frame_1": X["frame_1"][:50]})
    with pytest.raises(ValueError, match="bool mask"):
        TPGMM().fit_projected(X, {"frame_9": np.ones(90, dtype=bool)})
    with pytest.raises(ValueError, match="at least one"):
        TPGMM().fit([])
    gap = {"a": np.r_[np.linspace(0.0, 0.1, 30), np.linspace(0.9, 1.0, 30)][:, None]}
    with pytest.raises(ValueError, match="time bin"):
        TPGMM(n_components=5).fit_projected(gap)
    with pytest.raises(ValueError, match="not fitted"):
        TPGMM().save("never.tpgmm")


def test_demonstrations_must_agree_in_frames_and_dimensions() -> None:
    def demo(names: tuple[str, ...], D: int) -> Demonstration:
        return Demonstration(np.arange(9.0), np.zeros((9, D)), {n: Frame(np.eye(D), np.zeros(D)) for n in names})

    with pytest.raises(ValueError, match="demonstration 1 has the frames"):
        TPGMM().fit([demo(("a", "b"), 2), demo(("a",), 2)])
    with pytest.raises(ValueError, match="demonstration 1 has 3 dimensions"):
        TPGMM().fit([demo(("a",), 2), demo(("a",), 3)])


@pytest.mark.parametrize("regularization", ["add", "prior"])
@pytest.mark.parametrize("poses", [False, True])
def test_the_number_of_threads_changes_no_bit(poses: bool, regularization: str) -> None:
    rng = np.random.default_rng(5)
    demos = pose_demonstrations(20, 650) if poses else demonstrations(W2)
    X = projected(demos)
    N = len(next(iter(X.values())))
    assert N > 2 * PARTS_OF_A_THREAD * PART, "enough for several threads"
    seen = {name: rng.random(N) > 0.1 for name in X}
    settings = {"manifold": "R1 x R3 x S3"} if poses else {}

    def learned(n_threads: int) -> TPGMM:
        model = TPGMM(4, n_threads=n_threads, regularization=regularization, max_iter=6, **settings)
        return model.fit_projected(X, seen)

    one = learned(1)
    for n_threads in (2, 3, 64):
        other = learned(n_threads)
        np.testing.assert_array_equal(other.log_likelihoods_, one.log_likelihoods_)
        for name, means in one.means_.items():
            np.testing.assert_array_equal(other.means_[name], means)
            np.testing.assert_array_equal(other.covariances_[name], one.covariances_[name])
