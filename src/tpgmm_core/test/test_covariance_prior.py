# SPDX-License-Identifier: Apache-2.0
"""A prior of the covariances: few demonstrations are few observations, however many samples they have."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest

from tpgmm_core import TPGMM, Demonstration, Frame
from tpgmm_core.common.types import Array
from tpgmm_core.geometry.manifold import POSE
from tpgmm_core.learning.covariance.structure import STRUCTURES
from tpgmm_core.learning.estimation.covariance_prior import CovariancePrior
from tpgmm_core.learning.hidden_markov.hsmm import TPHSMM
from tpgmm_core.model.samples import Samples
from tpgmm_core.retrieval.recipe import Recipe
from tpgmm_core.retrieval.regression import AdaptThenRegress
from worlds import planar_demonstrations

OVER_POSES = "R1 x R3 x S3"
ROBOT = np.array([0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0])


def at(pose: Array) -> Frame:
    return Frame.from_pose(pose[:3], pose[3:]).with_time()


def about_z(angle: float) -> list[float]:
    return [0.0, 0.0, np.sin(0.5 * angle), np.cos(0.5 * angle)]


def reach(seed: int) -> Demonstration:
    """A hand goes from one place to 0.1 m above an object, and turns with it: 4 degrees of freedom, 1 mm of noise."""
    rng = np.random.default_rng(seed)
    u = np.linspace(0.0, 1.0, 80)
    place = [0.6, 0.0, 0.1] + rng.uniform(-0.2, 0.2, 3) * [1.0, 1.0, 0.2]
    yaw, start = rng.uniform(-0.8, 0.8), np.array([0.4, 0.3, 0.5])
    way = u**3 * (10.0 - 15.0 * u + 6.0 * u**2)
    positions = start + way[:, None] * (place + [0.0, 0.0, 0.1] - start) + 0.001 * rng.normal(size=(80, 3))
    data = np.column_stack([4.0 * u, positions, np.array([about_z(yaw * share) for share in way])])
    return Demonstration(4.0 * u, data, {"object": at(np.array([*place, *about_z(yaw)])), "robot": at(ROBOT)})


@cache
def learned(n: int, reg_covar: float, **settings: float) -> TPGMM:
    recipe = Recipe.of({"n_components": 5, "reg_covar": reg_covar, "max_iter": 60, **settings})
    return recipe.learn([reach(i) for i in range(n)], OVER_POSES)


@pytest.mark.parametrize("reg_covar", [1e-6, 1e-5, 1e-4])
@pytest.mark.parametrize("n", [5, 6, 8])
def test_no_situation_inside_the_demonstrated_range_is_refused_and_the_end_is_found(n: int, reg_covar: float) -> None:
    """Without the prior, 5 demonstrations and 1e-6: 9 of 12 refused; with 1e-5 up to 236 mm off, claiming 10 mm."""
    movement = AdaptThenRegress(learned(n, reg_covar))
    for seed in range(70, 82):
        shown = reach(seed)
        found = movement.retrieve(shown.frames, shown.times)
        assert np.linalg.norm(found[-1].mean[:3] - shown.data[-1, 1:4]) < 0.015
        steps = [POSE.log(gaussian.mean, x) for gaussian, x in zip(found, shown.data[:, 1:], strict=True)]
        inside = [d @ gaussian.precision @ d < 12.6 for d, gaussian in zip(steps, found, strict=True)]  # 95 % region
        assert np.mean(inside) > 0.7


def test_without_the_prior_the_same_demonstrations_are_refused() -> None:
    with pytest.raises(ValueError, match="contradict each other"):
        movement = AdaptThenRegress(learned(5, 1e-6, prior_strength=0.0))
        for seed in range(70, 82):
            movement.situate(reach(seed).frames)


def samples() -> Samples:
    return Samples.from_demonstrations(planar_demonstrations(), "euclidean")


def test_the_scale_keeps_the_motion_and_the_variances_and_forgets_the_other_correlations() -> None:
    data = samples()
    means = {name: x.mean(axis=0)[None] for name, x in data.X.items()}
    prior = CovariancePrior.of_data(data, means, np.ones((data.n_samples, 1)), strength=2.0)
    assert prior.count == pytest.approx(2.0 * data.n_samples / len(data.lengths))
    for name, x in data.X.items():
        S = np.cov(x, rowvar=False, bias=True)
        motion = np.outer(S[:, 0], S[:, 0]) / S[0, 0]
        expected = motion + np.diag(np.diag(S - motion))
        np.testing.assert_allclose(prior.scales[name][0], expected, atol=1e-9)
        np.testing.assert_allclose(np.diag(prior.scales[name][0]), np.diag(S), rtol=1e-9)


def test_the_m_step_is_that_of_as_many_more_samples_with_the_scatter_of_the_scale() -> None:
    """One component: EM has nothing to decide, and its covariance is the formula of the module."""
    data = samples()
    model = TPGMM(1, reg_covar=0.0, prior_strength=3.0).fit(planar_demonstrations())
    prior = CovariancePrior.of_data(data, model.means_, np.ones((data.n_samples, 1)), 3.0)
    N, c = data.n_samples, prior.count
    for name, x in data.X.items():
        S = np.cov(x, rowvar=False, bias=True)
        expected = (N * S + c * prior.scales[name][0]) / (N + c)
        np.testing.assert_allclose(model.covariances_[name][0], expected, rtol=1e-6, atol=1e-12)


def test_the_penalised_likelihood_never_falls() -> None:
    model = TPGMM(5, reg_covar=1e-6, regularization="prior", prior_strength=3.0, tol=0.0, max_iter=60)
    objectives = model.fit(planar_demonstrations()).objectives_
    assert np.diff(objectives).min() > -1e-9 and objectives[-1] - objectives[0] > 0.01


@pytest.mark.parametrize("structure", [name for name in STRUCTURES if name != "deep_mfa"])
def test_every_structure_takes_it(structure: str) -> None:
    """The full one by numpy instead of compiled, and the others nearer to the prior than without it."""
    plain, pulled = (
        TPGMM(3, reg_covar=1e-6, covariance=structure, prior_strength=strength).fit(planar_demonstrations())
        for strength in (0.0, 50.0)
    )
    assert np.all(np.isfinite(pulled.objectives_)) and pulled.log_likelihood_ < plain.log_likelihood_
    assert all(np.linalg.eigvalsh(S).min() > 0.0 for S in pulled.covariances_["goal"])


def test_a_semi_markov_model_and_one_that_divides_its_components_take_it_too() -> None:
    states = TPHSMM(3, prior_strength=3.0).fit(planar_demonstrations())
    assert states.log_likelihood_ < TPHSMM(3).fit(planar_demonstrations()).log_likelihood_
    deep = TPGMM(3, covariance="deep_mfa", prior_strength=3.0).fit(planar_demonstrations())
    assert np.isfinite(deep.log_likelihood_)


def test_of_several_starts_whose_priors_differ_the_likeliest_is_kept() -> None:
    several = TPGMM(4, reg_covar=1e-5, n_init=4, prior_strength=3.0).fit(planar_demonstrations())
    first = TPGMM(4, reg_covar=1e-5, prior_strength=3.0).fit(planar_demonstrations())
    assert several.log_likelihood_ >= first.log_likelihood_


def test_recipes_have_a_prior_models_by_themselves_have_none() -> None:
    assert learned(5, 1e-5).prior_strength == 3.0 and TPGMM().prior_strength == 0.0
    with pytest.raises(ValueError, match="prior_strength is a finite number from 0, got -1"):
        TPGMM(prior_strength=-1.0).fit(planar_demonstrations())
