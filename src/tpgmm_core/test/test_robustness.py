# SPDX-License-Identifier: Apache-2.0
"""Data that learning stumbles over: a good model or a clear error, never NaN."""

from __future__ import annotations

import warnings
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tpgmm_core import TPGMM, Demonstration, Frame
from tpgmm_core.learning.covariance.structure import STRUCTURES
from tpgmm_core.learning.dirichlet import DirichletTPGMM
from tpgmm_core.learning.dp_means import DPMeans
from workloads import pose_demonstrations


@st.composite
def awkward_demonstrations(draw: st.DrawFn) -> list[Demonstration]:
    """One to four demonstrations of 1 to 60 samples in the plane over time; dimensions that are constant or
    copies of others, samples that repeat, frames that are hidden, units from millimetres to kilometres."""
    rng = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    kind = draw(st.sampled_from(["smooth", "constant dimension", "copied dimension", "all alike", "few distinct"]))
    unit = draw(st.sampled_from([1e-3, 1.0, 1e3]))
    hidden = draw(st.sampled_from([0.0, 0.5]))
    demonstrations = []
    for T in draw(st.lists(st.integers(1, 60), min_size=1, max_size=4)):
        times = np.linspace(0.0, draw(st.floats(0.5, 2.0)), T) if T > 1 else np.zeros(1)
        path = np.column_stack([np.sin(3.0 * times), np.cos(2.0 * times)]) + 0.01 * rng.normal(size=(T, 2))
        if kind == "constant dimension":
            path[:, 1] = 0.3
        elif kind == "copied dimension":
            path[:, 1] = path[:, 0]
        elif kind == "all alike":
            path[:] = 0.7
        elif kind == "few distinct":
            path = np.repeat(path[:2], (T + 1) // 2, axis=0)[:T] if T > 1 else path
        angle = rng.uniform(-np.pi, np.pi)
        R = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
        frames = {
            "robot": Frame(np.eye(2), np.zeros(2)).with_time(),
            "object": Frame(R, unit * rng.normal(size=2)).with_time(),
        }
        visible = {"object": rng.random(T) >= hidden}
        demonstrations.append(Demonstration(times, np.column_stack([times, unit * path]), frames, visible))
    return demonstrations


def assert_good(model: TPGMM) -> None:
    assert np.isfinite(model.log_likelihood_) and np.all(np.isfinite(model.objectives_))
    assert model.priors_.sum() == pytest.approx(1.0) and np.all(model.priors_ >= 0.0)
    for name in model.frame_names_:
        assert np.all(np.isfinite(model.means_[name]))
        assert np.all(np.isfinite(model.covariances_[name]))
        np.linalg.cholesky(model.covariances_[name])


def fit_or_refuse(model: TPGMM, demonstrations: list[Demonstration]) -> bool:
    """Whether it was fitted; what it refuses must say why in words. No warning on the way."""
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        try:
            model.fit(demonstrations)
        except ValueError as error:
            reasons = ("component", "samples", "reg_covar", "never seen", "constant")
            assert any(reason in str(error) for reason in reasons), error
            return False
    assert_good(model)
    return True


@settings(max_examples=150)
@given(
    demonstrations=awkward_demonstrations(),
    K=st.integers(1, 12),
    init=st.sampled_from(["time", "bins", "kmeans"]),
    regularization=st.sampled_from(["add", "prior"]),
    reg_covar=st.sampled_from([0.0, 1e-8, 1e-4]),
    n_init=st.sampled_from([1, 3]),
)
def test_a_good_model_or_a_clear_error(demonstrations: list[Demonstration], **params: Any) -> None:
    params["n_components"] = params.pop("K")
    fit_or_refuse(TPGMM(**params, max_iter=30), demonstrations)


@settings(max_examples=100)
@given(
    demonstrations=awkward_demonstrations(),
    K=st.integers(1, 6),
    covariance=st.sampled_from([name for name in STRUCTURES if name != "full"]),
    regularization=st.sampled_from(["add", "prior"]),
    reg_covar=st.sampled_from([0.0, 1e-8, 1e-4]),
)
def test_a_good_model_or_a_clear_error_with_every_structure(demonstrations: list[Demonstration], **params: Any) -> None:
    params["n_components"] = params.pop("K")
    fit_or_refuse(TPGMM(**params, init="bins", max_iter=15), demonstrations)


@settings(max_examples=60)
@given(
    demonstrations=awkward_demonstrations(),
    T=st.integers(1, 12),
    init=st.sampled_from(["bins", "kmeans"]),
    reg_covar=st.sampled_from([0.0, 1e-8, 1e-4]),
)
def test_a_good_dirichlet_process_or_a_clear_error(
    demonstrations: list[Demonstration], T: int, init: str, reg_covar: float
) -> None:
    fit_or_refuse(DirichletTPGMM(T, init=init, reg_covar=reg_covar, max_iter=40), demonstrations)


@settings(max_examples=60)
@given(demonstrations=awkward_demonstrations(), subspaces=st.booleans())
def test_good_clusters_or_a_clear_error(demonstrations: list[Demonstration], subspaces: bool) -> None:
    clusters = DPMeans(0.5, 1.0 if subspaces else None)
    try:
        clusters.fit(demonstrations)
    except ValueError as error:
        assert "never seen" in str(error)
        return
    assert np.all(np.isfinite(clusters.costs_)) and clusters.converged_
    fit_or_refuse(TPGMM(clusters.n_components_, init=clusters.labels_, max_iter=10), demonstrations)


@pytest.mark.parametrize("init", ["time", "bins", "kmeans"])
def test_regularised_data_without_spread_is_learned(init: str) -> None:
    """A dimension that never changes is no error where reg_covar gives it a variance."""
    times = np.linspace(0.0, 1.0, 50)
    data = np.column_stack([times, np.sin(times), np.full(50, 0.2)])
    demonstration = Demonstration(times, data, {"robot": Frame(np.eye(3), np.zeros(3))})
    model = TPGMM(3, init=init, reg_covar=1e-6).fit([demonstration])
    assert_good(model)
    assert model.covariances_["robot"][:, 2, 2] == pytest.approx(1e-6, rel=1e-6)
    with pytest.raises(ValueError, match="give a larger reg_covar"):
        TPGMM(3, init=init, reg_covar=0.0).fit([demonstration])


def test_one_demonstration_and_demonstrations_of_different_length_are_learned() -> None:
    long, short = pose_demonstrations(2, n_samples=120)
    short = Demonstration(short.times[::5], short.data[::5], short.frames)
    for init in ("time", "bins", "kmeans"):
        for demonstrations in ([long], [long, short]):
            assert_good(TPGMM(4, init=init, manifold="R1 x R3 x S3", reg_covar=1e-5).fit(demonstrations))


def test_restarts_are_never_worse_than_the_first_start_and_are_repeatable() -> None:
    rng = np.random.default_rng(0)
    x = np.concatenate([c + 0.1 * rng.normal(size=(40, 2)) for c in 5.0 * rng.normal(size=(6, 2))])
    X = {"a": x[rng.permutation(240)]}  # so that equal bins say nothing
    once = TPGMM(6, init="bins", random_state=1).fit_projected(X)
    several = [TPGMM(6, init="bins", random_state=1, n_init=8).fit_projected(X) for _ in range(2)]
    assert several[0].objectives_[-1] > once.objectives_[-1]
    np.testing.assert_array_equal(several[0].means_["a"], several[1].means_["a"])


def test_labels_start_em_and_are_checked() -> None:
    X = {"a": np.random.default_rng(0).normal(size=(30, 2))}
    labels = np.repeat([0, 1, -1], 10)
    model = TPGMM(2, init=labels, max_iter=1, reg_covar=0.0).fit_projected(X)
    assert len(model.priors_) == 2
    with pytest.raises(ValueError, match="labels are integers"):
        TPGMM(2, init=labels[:5]).fit_projected(X)
    with pytest.raises(ValueError, match="labels are integers"):
        TPGMM(1, init=labels).fit_projected(X)
    with pytest.raises(ValueError, match="component 2 has no samples"):
        TPGMM(3, init=labels).fit_projected(X)
