# SPDX-License-Identifier: Apache-2.0
from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.special import multigammaln

from tpgmm_core import TPGMM, Adapter
from tpgmm_core.common.types import Array
from tpgmm_core.learning.dirichlet import DirichletTPGMM
from workloads import pose_demonstrations


def groups(rng: np.random.Generator, K: int, N: int, dims: tuple[int, ...], noise: float = 0.5) -> dict[str, Array]:
    """K groups of samples with centres far apart in all frames."""
    group = rng.integers(K, size=N)
    return {
        f"frame_{j}": (10.0 * rng.permuted(np.arange(K))[group, None] + noise * rng.normal(size=(N, D)))
        for j, D in enumerate(dims)
    }


@settings(max_examples=25)
@given(
    seed=st.integers(0, 2**32 - 1),
    dims=st.lists(st.integers(1, 4), min_size=1, max_size=3),
    T=st.integers(1, 8),
    N=st.integers(10, 300),
    hidden=st.floats(0.0, 0.6),
    concentration=st.floats(0.01, 100.0),
)
def test_the_evidence_lower_bound_never_falls(
    seed: int, dims: list[int], T: int, N: int, hidden: float, concentration: float
) -> None:
    rng = np.random.default_rng(seed)
    X = groups(rng, 3, N, tuple(dims), noise=3.0)
    visible = {name: rng.random(N) >= hidden for name in X}
    for mask in visible.values():
        mask[:10] = True  # k-means asks for as many distinct samples as components
    model = DirichletTPGMM(T, concentration, tol=0.0, max_iter=60, init="kmeans", random_state=seed)
    model.fit_projected(X, visible)
    assert np.diff(model.objectives_).min(initial=0.0) > -1e-9
    assert model.weights_.sum() == pytest.approx(1.0) and len(model.weights_) == T
    assert all(np.linalg.eigvalsh(c).min() > 0.0 for c in model.covariances_.values())


def test_with_one_component_the_bound_is_the_evidence_of_the_conjugate_model() -> None:
    x = np.random.default_rng(0).normal(size=(40, 3)) @ np.diag([1.0, 2.0, 0.5])
    model = DirichletTPGMM(1, spread=0.7, mean_precision=2.5, reg_covar=1e-3, tol=0.0, max_iter=10)
    model.fit_projected({"frame": x})
    # Murphy (2007), "Conjugate Bayesian analysis of the Gaussian distribution", Eq. 266, prior mean at the mean
    N, n = x.shape
    Psi_0 = n * np.diag(0.7**2 * x.var(axis=0) + 1e-3)
    Psi = Psi_0 + N * np.cov(x.T, bias=True)
    evidence = (
        -0.5 * N * n * np.log(np.pi)
        + multigammaln(0.5 * (n + N), n)
        - multigammaln(0.5 * n, n)
        + 0.5 * n * np.linalg.slogdet(Psi_0)[1]
        - 0.5 * (n + N) * np.linalg.slogdet(Psi)[1]
        + 0.5 * n * np.log(2.5 / (2.5 + N))
    )
    assert N * model.objectives_[-1] == pytest.approx(evidence, abs=1e-9)
    np.testing.assert_allclose(model.covariances_["frame"][0], Psi / (n + N), rtol=1e-12)


@pytest.mark.parametrize("K", [1, 2, 4, 6])
def test_it_finds_the_number_of_groups_and_the_other_weights_vanish(K: int) -> None:
    rng = np.random.default_rng(K)
    X = groups(rng, K, 600, (2, 3))
    visible = {"frame_1": rng.random(600) > 0.3}
    model = DirichletTPGMM(12).fit_projected(X, visible)
    assert len(model.priors_) == K and model.converged_
    assert np.sort(model.weights_)[: 12 - K].sum() < 0.01
    assert model.priors_.sum() == pytest.approx(1.0)


def test_what_it_finds_is_a_model_that_adapts_and_can_be_saved(tmp_path: Path) -> None:
    demos = pose_demonstrations(4, n_samples=60)
    model = DirichletTPGMM(10, init="bins", manifold="R1 x R3 x S3").fit(demos)
    frames = {name: frame.at(0) for name, frame in demos[0].frames.items()}
    mean, covariance, _ = Adapter(model).adapt_and_condition(frames, np.array([0.3]))
    assert np.all(np.isfinite(mean)) and np.linalg.eigvalsh(covariance[0]).min() > 0.0
    assert model.score(demos) == pytest.approx(model.log_likelihood_, abs=1e-9)
    model.save(tmp_path / "found.tpgmm")
    loaded = TPGMM.load(tmp_path / "found.tpgmm")
    for name in model.frame_names_:
        np.testing.assert_array_equal(loaded.means_[name], model.means_[name])
    assert np.isfinite(TPGMM(len(model.priors_), init=model, manifold="R1 x R3 x S3").fit(demos).log_likelihood_)


def test_more_concentration_expects_more_components() -> None:
    x = np.random.default_rng(5).normal(size=(200, 2))
    few, many = (DirichletTPGMM(20, concentration=c, spread=0.3).fit_projected({"a": x}) for c in (1e-3, 1e3))
    assert len(few.priors_) <= len(many.priors_)


def test_bad_arguments_are_refused_with_the_reason() -> None:
    x = {"a": np.random.default_rng(0).normal(size=(30, 2))}
    with pytest.raises(ValueError, match="concentration is a finite number above 0"):
        DirichletTPGMM(concentration=0.0).fit_projected(x)
    with pytest.raises(ValueError, match="40 components need at least as many samples"):
        DirichletTPGMM(40).fit_projected(x)
    constant = {"a": np.column_stack([x["a"], np.ones(30)])}
    with pytest.raises(ValueError, match="dimension 2 of frame 'a' is constant"):
        DirichletTPGMM(3, reg_covar=0.0).fit_projected(constant)
    with pytest.raises(ValueError, match="not a fitted model"):
        DirichletTPGMM(2, init=TPGMM(2, init="bins").fit_projected(x)).fit_projected(x)  # type: ignore[arg-type]


def test_separate_groups_have_the_posterior_of_scikit_learn() -> None:
    mixture = pytest.importorskip("sklearn.mixture")
    rng = np.random.default_rng(6)
    x = np.array([[0.0, 0.0, 0.0], [50.0, 0.0, 0.0], [0.0, 80.0, 0.0]])[rng.integers(3, size=300)]
    x = x + rng.normal(size=(300, 3)) @ rng.normal(size=(3, 3))
    model = DirichletTPGMM(3, concentration=2.0, spread=0.2, mean_precision=0.5, reg_covar=0.0).fit_projected({"a": x})
    theirs = mixture.BayesianGaussianMixture(
        n_components=3, weight_concentration_prior=2.0, mean_precision_prior=0.5, degrees_of_freedom_prior=3.0,
        covariance_prior=3.0 * np.diag(0.2**2 * x.var(axis=0)), reg_covar=0.0, random_state=0,
    ).fit(x)  # fmt: skip
    ours, other = np.argsort(model.means_["a"] @ [1.0, 2.0, 0.0]), np.argsort(theirs.means_ @ [1.0, 2.0, 0.0])
    np.testing.assert_allclose(model.means_["a"][ours], theirs.means_[other], atol=1e-8)
    np.testing.assert_allclose(model.covariances_["a"][ours], theirs.covariances_[other], atol=1e-8)
