# SPDX-License-Identifier: Apache-2.0
"""Covariance structures: likelihoods that never fall, parameters that come back, independent implementations."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.stats import multivariate_normal

from random_problems import random_covariance
from tpgmm_core import TPGMM, Demonstration, Frame, Manifold, ModelFileError
from tpgmm_core.common.types import Array
from tpgmm_core.geometry import quaternion
from tpgmm_core.learning.covariance.deep_mfa import divided
from tpgmm_core.learning.covariance.factor_analyzers import FactorAnalyzers, SubspaceCovariances
from tpgmm_core.learning.covariance.semi_tied import SemiTiedCovariances
from tpgmm_core.learning.covariance.structure import STRUCTURES, Covariances, Structure
from tpgmm_core.learning.covariance.structures import covariances_class
from tpgmm_core.learning.estimation.compiled_moments import CompiledMoments
from tpgmm_core.learning.estimation.em import expectation, fit_mixture
from tpgmm_core.learning.estimation.emissions import Emissions
from tpgmm_core.model.samples import Samples
from workloads import pose_demonstrations


def one_frame(X: Array) -> Samples:
    return Samples.from_projected({"world": X}, None, Manifold.euclidean(X.shape[1]))


SHALLOW = tuple(name for name in STRUCTURES if name != "deep_mfa")


def random_views(rng: np.random.Generator, dims: tuple[int, ...], N: int, K: int) -> dict[str, Array]:
    """Samples of K clusters, seen from frames of these dimensions."""
    labels = rng.integers(K, size=N)
    views = {}
    for j, D in enumerate(dims):
        centres = 2.0 * rng.normal(size=(K, D))
        roots = [np.linalg.cholesky(random_covariance(rng, D)) for _ in range(K)]
        noise = rng.normal(size=(N, D))
        views[f"frame_{j}"] = np.stack([centres[k] + roots[k] @ e for k, e in zip(labels, noise, strict=True)])
    return views


@pytest.mark.parametrize("structure", STRUCTURES)
@settings(max_examples=12)
@given(data=st.data())
def test_the_objective_never_falls(structure: str, data: st.DataObject) -> None:
    rng = np.random.default_rng(data.draw(st.integers(0, 2**32 - 1)))
    least = 3 if structure == "deep_mfa" else 1
    dims = tuple(data.draw(st.lists(st.integers(least, 6), min_size=1, max_size=3)))
    K, N = data.draw(st.integers(1, 4)), data.draw(st.integers(30, 150))
    X = random_views(rng, dims, N, data.draw(st.integers(1, 4)))
    share = data.draw(st.sampled_from([0.0, 0.3]))
    visible = {name: rng.uniform(size=N) >= share for name in X}
    reg_covar = data.draw(st.sampled_from([1e-6, 1e-2, 1.0]))
    model = TPGMM(
        K, init="kmeans", reg_covar=reg_covar, regularization="prior", tol=0.0, max_iter=25, covariance=structure,
        n_factors=data.draw(st.integers(2, 5)), covariance_options={"layers": ((2, 2), (2, 1))},
    ).fit_projected(X, visible)  # fmt: skip
    assert np.diff(model.objectives_).min(initial=0.0) > -1e-9 * max(1.0, np.abs(model.objectives_).max())
    assert np.all(np.isfinite(model.objectives_)) and np.all(model.priors_ >= 0.0)
    for covariances in model.covariances_.values():
        assert np.linalg.eigvalsh(covariances).min() > 0.0


@pytest.mark.parametrize("structure", ["full", "diag", "tied", "spherical"])
def test_with_one_identity_frame_it_is_the_mixture_of_scikit_learn(structure: str) -> None:
    mixture = pytest.importorskip("sklearn.mixture")
    rng = np.random.default_rng(4)
    X = random_views(rng, (4,), 400, 3)["frame_0"]
    start = TPGMM(3, init="kmeans", max_iter=1, covariance=structure, reg_covar=1e-3).fit_projected({"world": X})
    ours = TPGMM(3, init=start, tol=0.0, max_iter=60, covariance=structure, reg_covar=1e-3).fit_projected({"world": X})
    precisions = np.linalg.inv(start.covariances_["world"])
    given = {
        "full": precisions, "tied": precisions[0],
        "diag": np.diagonal(precisions, axis1=1, axis2=2), "spherical": precisions[:, 0, 0],
    }  # fmt: skip
    theirs = mixture.GaussianMixture(
        3, covariance_type=structure, tol=0.0, reg_covar=1e-3, max_iter=ours.n_iter_,
        weights_init=start.priors_ / start.priors_.sum(), means_init=start.means_["world"],
        precisions_init=given[structure],
    )  # fmt: skip
    with pytest.warns(match="converge"):
        theirs.fit(X)
    np.testing.assert_allclose(ours.priors_, theirs.weights_, atol=1e-8)
    np.testing.assert_allclose(ours.means_["world"], theirs.means_, atol=1e-8)
    expected = theirs.covariances_
    if structure in ("diag", "spherical"):
        expected = np.reshape(expected, (3, -1, 1)) * np.eye(4)
    np.testing.assert_allclose(ours.covariances_["world"], np.broadcast_to(expected, (3, 4, 4)), atol=1e-8)
    assert ours.score([Demonstration(np.arange(400.0), X, {"world": Frame(np.eye(4), np.zeros(4))})]) == pytest.approx(
        theirs.score(X), abs=1e-8
    )


def of_structure(name: str, K: int, n: int, seed: int, **settings: Any) -> Covariances:
    """Random covariances of a structure."""
    rng = np.random.default_rng(seed)
    structure = Structure(name, reg_covar=1e-6, **settings)
    if name == "semi_tied":
        return SemiTiedCovariances(structure, rng.normal(size=(n, n)), rng.uniform(0.1, 2.0, size=(K, n)))
    if name == "mfa":
        return FactorAnalyzers(
            structure, rng.normal(size=(K, n, structure.n_factors)), rng.uniform(0.05, 0.5, size=(K, n))
        )
    scatters = np.stack([random_covariance(rng, n) for _ in range(K)])
    if name == "deep_mfa":
        top = of_structure("mfa", 2 * K, 3, seed + 1, n_factors=1)
        first = of_structure("mfa", K, n, seed, n_factors=3)
        assert isinstance(first, FactorAnalyzers) and isinstance(top, FactorAnalyzers)
        return divided(first, structure, 2, top)
    return covariances_class(structure).start(structure, np.ones(K), scatters)


@pytest.mark.parametrize("name", STRUCTURES)
def test_densities_determinants_and_traces_are_those_of_the_dense_matrices(name: str) -> None:
    covariances = of_structure(name, 3, 7, 0, n_factors=2)
    K, n = covariances.shape
    d = np.random.default_rng(1).normal(size=(20, n))
    for k, S in enumerate(covariances.dense()):
        np.testing.assert_allclose(
            covariances.log_density(k, d), multivariate_normal(np.zeros(n), S).logpdf(d), rtol=1e-10, atol=1e-8
        )
        assert covariances.log_determinants[k] == pytest.approx(np.linalg.slogdet(S)[1], rel=1e-10)
        assert covariances.inverse_traces()[k] == pytest.approx(np.trace(np.linalg.inv(S)), rel=1e-9)
    for offset in (0.0, 1e5):  # far away, rounding forbids the shorter way
        means = offset * np.arange(K)[:, None] + np.random.default_rng(2).normal(size=(K, n))
        x = means[1] + d
        expected = [multivariate_normal(m, S).logpdf(x) for m, S in zip(means, covariances.dense(), strict=True)]
        np.testing.assert_allclose(covariances.log_densities(x, means).T, expected, rtol=1e-9, atol=1e-7)


def test_one_dimension_has_no_factors_and_is_learned_all_the_same() -> None:
    x = np.random.default_rng(0).normal(size=(50, 1))
    for name in SHALLOW:
        model = TPGMM(2, init="kmeans", covariance=name, max_iter=20).fit_projected({"a": x})
        frame = {"a": Frame(np.eye(1), np.zeros(1))}
        assert model.score([Demonstration(np.arange(50.0), x, frame)]) >= model.log_likelihood_ - 1e-6


@pytest.mark.parametrize("name", SHALLOW)
def test_parameters_of_the_model_that_made_the_samples_come_back(name: str) -> None:
    rng = np.random.default_rng(8)
    K, N = 3, 12000
    labels = rng.choice(K, size=N, p=[0.5, 0.3, 0.2])
    truth, X = {}, {}
    for frame, n in (("a", 5), ("b", 4)):
        truth[frame] = of_structure(name, K, n, n, n_factors=2)
        means = 6.0 * rng.normal(size=(K, n))
        roots = np.linalg.cholesky(truth[frame].dense())
        X[frame] = means[labels] + np.einsum("nij,nj->ni", roots[labels], rng.normal(size=(N, n)))
        X[frame][:50] += 1.0  # the start is not the truth itself
    model = TPGMM(
        K, init=labels, covariance=name, n_factors=2, reg_covar=1e-8, tol=1e-9, max_iter=500
    ).fit_projected(X)  # fmt: skip
    np.testing.assert_allclose(model.priors_, [0.5, 0.3, 0.2], atol=0.02)
    for frame in X:
        expected, found = truth[frame].dense(), model.covariances_[frame]
        scale = np.linalg.norm(expected, axis=(1, 2))
        assert np.max(np.linalg.norm(found - expected, axis=(1, 2)) / scale) < 0.12
        assert isinstance(model.emissions_.frames[frame], type(truth[frame]))


def test_the_scree_test_finds_each_components_own_dimension() -> None:
    rng = np.random.default_rng(0)
    parts = []
    for d in (1, 3, 2):
        axes = np.linalg.qr(rng.normal(size=(8, d)))[0]
        synergies = rng.normal(size=(600, d)) @ (2.0 * axes.T)
        parts.append(5.0 * rng.normal(size=8) + synergies + 0.1 * rng.normal(size=(600, 8)))
    labels = np.repeat(np.arange(3), 600)
    model = TPGMM(3, init=labels, covariance="hddc").fit_projected({"world": np.concatenate(parts)})
    frame = model.emissions_.frames["world"]
    assert isinstance(frame, SubspaceCovariances)
    np.testing.assert_array_equal(frame.dimensions, [1, 3, 2])


def test_factor_analyzers_with_all_factors_are_as_likely_as_full_covariances() -> None:
    X = random_views(np.random.default_rng(3), (4, 3), 300, 2)
    rules: dict[str, Any] = {"reg_covar": 1e-3, "tol": 1e-10, "max_iter": 3000}
    full = TPGMM(2, init="kmeans", **rules).fit_projected(X)
    for covariance in ("mfa", "mppca"):
        other = TPGMM(2, init="kmeans", covariance=covariance, n_factors=99, **rules).fit_projected(X)
        assert other.log_likelihood_ == pytest.approx(full.log_likelihood_, abs=1e-6)
        assert other.n_parameters_ == full.n_parameters_


def test_a_deeper_model_is_likelier_where_components_are_not_gaussian() -> None:
    rng = np.random.default_rng(5)
    side = rng.choice([-1.0, 1.0], size=800)
    loadings = rng.normal(size=(6, 2))
    X = {}
    for frame in ("a", "b"):
        z = np.column_stack([3.0 * side, np.zeros(800)]) + rng.normal(size=(800, 2)) * 0.3
        X[frame] = z @ loadings.T + 0.1 * rng.normal(size=(800, 6))
    shallow = TPGMM(1, init="bins", covariance="mfa", n_factors=2, max_iter=300).fit_projected(X)
    deep = TPGMM(1, init="bins", covariance="deep_mfa", n_factors=2, max_iter=300).fit_projected(X)
    assert len(deep.priors_) == 2 and deep.log_likelihood_ > shallow.log_likelihood_ + 1.0
    split = np.argmax(deep.emissions_.log_density(Samples.from_projected(X, None, "euclidean")), axis=1)
    assert abs(np.corrcoef(split, side)[0, 1]) > 0.99


def jacobian_rank(make: Callable[[Array], Array], size: int, seed: int = 0) -> int:
    """Rank of the derivative of a map from parameters: how many of them are free."""
    theta = np.random.default_rng(seed).uniform(0.5, 2.0, size=size)
    J = [(make(theta + 1e-5 * e) - make(theta - 1e-5 * e)).ravel() / 2e-5 for e in np.eye(size)]
    return int(np.linalg.matrix_rank(np.stack(J), tol=1e-7))


@pytest.mark.parametrize(("n", "d"), [(4, 1), (5, 2), (5, 4), (6, 3)])
def test_parameters_are_counted_as_the_rank_of_their_map_to_covariances(n: int, d: int) -> None:
    def factors(theta: Array) -> Array:
        return theta[: n * d].reshape(n, d) @ theta[: n * d].reshape(n, d).T

    def analyzers(theta: Array) -> Array:
        return factors(theta) + np.diag(theta[n * d :])

    def principal(theta: Array) -> Array:
        return factors(theta) + theta[-1] * np.eye(n)

    def semi_tied(theta: Array) -> Array:
        H, variances = theta[: n * n].reshape(n, n), theta[n * n :].reshape(-1, n)
        return (H * variances[:, None, :]) @ H.T

    assert of_structure("mfa", 1, n, 0, n_factors=d).n_parameters == jacobian_rank(analyzers, n * d + n)
    assert of_structure("mppca", 1, n, 0, n_factors=d).n_parameters == jacobian_rank(principal, n * d + 1)
    for K in (1, 2, 3):
        assert of_structure("semi_tied", K, n, 0).n_parameters == jacobian_rank(semi_tied, n * n + K * n)


def test_parameters_of_a_model_count_means_covariances_and_priors() -> None:
    X = random_views(np.random.default_rng(0), (4, 3), 200, 2)
    means, expected = 2 * 7, {"full": 2 * (10 + 6), "tied": 10 + 6, "diag": 2 * 7, "spherical": 2 * 2}
    for covariance, n in expected.items():
        model = TPGMM(2, init="bins", covariance=covariance, max_iter=2).fit_projected(X)
        assert model.n_parameters_ == 1 + means + n
    deep = TPGMM(2, init="bins", covariance="deep_mfa", n_factors=2, max_iter=2).fit_projected(X)
    # parents: means, loadings, noise; children: means and Lambda Lambda^T + Psi in 2 dimensions, in both frames
    assert deep.n_parameters_ == 3 + 2 * (4 + 7 + 4) + 2 * (3 + 5 + 3) + 2 * 4 * (2 + 3)


def test_a_deep_model_of_small_turns_is_that_of_vectors() -> None:
    rng, manifold = np.random.default_rng(2), Manifold.parse("R3 x S3")
    side = rng.choice([-1.0, 1.0], size=(400, 1))
    vectors = 1e-3 * (side * rng.normal(size=6) + 0.3 * rng.normal(size=(400, 2)) @ rng.normal(size=(2, 6)))
    vectors += 1e-4 * rng.normal(size=(400, 6))
    centre = np.array([0.3, 0.1, -0.2, *quaternion.exp([0.4, -0.9, 0.3])])
    settings = {"init": "bins", "covariance": "deep_mfa", "n_factors": 2, "reg_covar": 1e-12, "max_iter": 100}
    flat = TPGMM(1, **settings).fit_projected({"a": vectors})
    curved = TPGMM(1, manifold=manifold, **settings).fit_projected({"a": manifold.exp(centre, vectors)})
    assert len(curved.priors_) == 2
    assert curved.log_likelihood_ == pytest.approx(flat.log_likelihood_, abs=0.01)
    steps = manifold.log(centre, curved.means_["a"])
    np.testing.assert_allclose(steps, flat.means_["a"], atol=2e-5)


def test_a_deep_model_does_not_depend_on_how_the_hand_is_mounted_and_divides_what_turns_two_ways() -> None:
    rng, manifold = np.random.default_rng(4), Manifold.parse("R3 x S3")
    side = rng.choice([-1.0, 1.0], size=400)
    turns = np.outer(side, [0.2, 0.1, 0.0, 0.0, 0.5, 0.3]) + 0.03 * rng.normal(size=(400, 6))
    poses = manifold.exp(np.array([0.3, 0.1, -0.2, *quaternion.exp([0.4, -0.9, 0.3])]), turns)
    mounted = poses.copy()
    mounted[:, 3:] = quaternion.multiply(poses[:, 3:], quaternion.exp([1.0, -0.7, 2.0]))
    found = []
    for X in (poses, mounted):
        shallow, deep = (
            TPGMM(1, manifold=manifold, init="bins", covariance=name, n_factors=2, max_iter=100).fit_projected({"a": X})
            for name in ("mfa", "deep_mfa")
        )
        assert deep.log_likelihood_ > shallow.log_likelihood_ + 1.0
        densities = deep.emissions_.log_density(Samples.from_projected({"a": X}, None, manifold))
        assert abs(np.corrcoef(np.argmax(densities, axis=1), side)[0, 1]) > 0.99
        found.append(deep.log_likelihood_)
    assert found[0] == pytest.approx(found[1], abs=1e-6)


@pytest.mark.parametrize("name", STRUCTURES)
def test_poses_are_learned_and_meet_new_frames(name: str) -> None:
    demos = pose_demonstrations(8, n_samples=40)
    model = TPGMM(3, manifold="R1 x R3 x S3", covariance=name, n_factors=3, reg_covar=1e-4).fit(demos)
    assert model.objectives_[-1] > model.objectives_[0]
    new = pose_demonstrations(1, n_samples=50, seed=9)[0]
    reached = model.adapt(new.frames).condition([0], [1.0]).mean
    assert np.linalg.norm(reached[3:]) == pytest.approx(1.0) and np.isfinite(model.score([new]))
    if name not in ("tied", "spherical"):  # which cannot trust one frame in the beginning and another in the end
        assert Manifold.parse("R3 x S3").distance(reached, new.data[-1, 1:]) < 0.15


def test_deep_models_refuse_frames_without_factors() -> None:
    with pytest.raises(ValueError, match="too few dimensions"):
        TPGMM(2, covariance="deep_mfa").fit_projected({"a": np.arange(20.0)[:, None]})
    with pytest.raises(ValueError, match="layer by layer"):
        Emissions.from_labels(Structure("deep_mfa"), one_frame(np.eye(4)), np.zeros(4, dtype=np.intp))


@pytest.mark.parametrize(
    "arguments",
    [
        {"covariance": "ful"},
        {"covariance": "mfa", "n_factors": 0},
        {"covariance": "hddc", "covariance_options": {"scree_threshold": 1.5}},
        {"covariance": "deep_mfa", "covariance_options": {"layers": ((2,),)}},
        {"covariance": "mfa", "covariance_options": {"rank": 3}},
    ],
)
def test_settings_out_of_range_are_refused(arguments: dict[str, Any]) -> None:
    with pytest.raises(ValueError, match="got"):
        TPGMM(2, **arguments).fit_projected({"a": np.random.default_rng(0).normal(size=(30, 3))})


@pytest.mark.parametrize("name", STRUCTURES)
def test_model_files_hold_every_structure(name: str, tmp_path: Path) -> None:
    options = {"layers": ((2, 1), (2, 1))} if name == "deep_mfa" else None
    X = random_views(np.random.default_rng(1), (4, 3), 120, 2)
    model = TPGMM(2, init="bins", covariance=name, n_factors=2, covariance_options=options).fit_projected(X)
    model.save(tmp_path / "m.tpgmm")
    loaded = TPGMM.load(tmp_path / "m.tpgmm")
    assert loaded.get_params() == model.get_params()
    assert loaded.n_parameters_ == model.n_parameters_
    frames = {name: Frame(np.eye(4, x.shape[1]), np.zeros(4)) for name, x in X.items()}
    np.testing.assert_allclose(loaded.adapt(frames).covariances, model.adapt(frames).covariances, rtol=1e-12)
    for frame, covariances in model.emissions_.frames.items():
        assert loaded.emissions_.frames[frame].structure.name == name
        for key, array in covariances.arrays().items():
            np.testing.assert_array_equal(loaded.emissions_.frames[frame].arrays()[key], array)
    if name != "deep_mfa":
        again = TPGMM(2, init=loaded, covariance=name, n_factors=2, max_iter=5).fit_projected(X)
        assert again.log_likelihoods_[0] >= model.log_likelihood_ - 1e-9


@pytest.mark.parametrize(("name", "key"), [("mfa", "noise"), ("semi_tied", "transform"), ("deep_mfa", "latent_noise")])
def test_a_damaged_structure_is_one_clear_error(name: str, key: str, tmp_path: Path) -> None:
    X = random_views(np.random.default_rng(1), (4,), 60, 2)
    path = tmp_path / "m.tpgmm"
    TPGMM(2, init="bins", covariance=name, n_factors=2).fit_projected(X).save(path)
    with np.load(path) as archive:
        arrays = dict(archive)
    for value in (None, -arrays[f"frame_0_{key}"][:1], np.zeros((1, 1)), np.full((2, 4), np.nan)):
        broken = {k: v for k, v in arrays.items() if k != f"frame_0_{key}"}
        if value is not None:
            broken[f"frame_0_{key}"] = value
        with open(path, "wb") as stream:
            np.savez(stream, **broken)
        with pytest.raises(ModelFileError):
            TPGMM.load(path)


@pytest.mark.parametrize("name", ["full", "mfa", "semi_tied"])
@pytest.mark.parametrize("is_pose", [False, True])
def test_compiled_and_chunked_moments_agree(name: str, is_pose: bool, monkeypatch: pytest.MonkeyPatch) -> None:
    rng = np.random.default_rng(2)
    if is_pose:
        samples = Samples.from_demonstrations(pose_demonstrations(2, n_samples=60), "R1 x R3 x S3")
    else:
        samples = Samples.from_projected(random_views(rng, (5, 3), 120, 2), None, "euclidean")
    visible = rng.uniform(size=samples.seen.shape) < 0.8
    samples = replace(samples, seen=visible)
    labels = np.arange(120) * 3 // 120
    emissions = Emissions.from_labels(Structure(name, n_factors=2), samples, labels)
    priors = np.bincount(labels) / 120.0
    monkeypatch.setattr("tpgmm_core.learning.estimation.emissions.CHUNK_NUMBERS", 100)
    log_likelihood, counts, moments = CompiledMoments(samples, priors, emissions)(priors, emissions)
    responsibilities, expected = expectation(priors, emissions, samples)
    assert log_likelihood == pytest.approx(expected, rel=1e-10)
    np.testing.assert_allclose(counts, responsibilities.sum(axis=0), rtol=1e-10)
    for frame, moment in emissions.moments(samples, responsibilities).items():
        for key in ("counts", "means", "scatters"):
            np.testing.assert_allclose(getattr(moments[frame], key), getattr(moment, key), rtol=1e-7, atol=1e-10)


def test_many_dimensions_are_learned_without_dense_inverses(monkeypatch: pytest.MonkeyPatch) -> None:
    """200 dimensions, 5 factors: after the start nothing larger than the factors is factorised or solved."""
    rng = np.random.default_rng(0)
    X = random_low_rank(rng, 600, 200, 5)
    samples = Samples.from_projected({"a": X, "b": X[:, ::-1].copy()}, None, "euclidean")
    labels = np.repeat(np.arange(2), 300)
    emissions = Emissions.from_labels(Structure("mfa", n_factors=5), samples, labels)
    for function in ("inv", "solve", "cholesky", "eigh", "svd", "slogdet"):
        original = getattr(np.linalg, function)

        def checked(a: Array, *rest: Any, original: Any = original, **options: Any) -> Any:
            assert np.shape(a)[-1] <= 5, "a dense matrix was decomposed"
            return original(a, *rest, **options)

        monkeypatch.setattr(np.linalg, function, checked)
    estimate = fit_mixture(samples, np.array([0.5, 0.5]), emissions, tol=1e-4, max_iter=20)
    assert np.diff(estimate.objectives).min() > -1e-6 and np.isfinite(estimate.objectives[-1])


def random_low_rank(rng: np.random.Generator, N: int, D: int, d: int) -> Array:
    """Two halves of samples, each in a subspace of d dimensions, with noise."""
    halves = [rng.normal(size=D) + rng.normal(size=(N // 2, d)) @ rng.normal(size=(d, D)) for _ in range(2)]
    return np.concatenate(halves) + 0.3 * rng.normal(size=(N, D))
