# SPDX-License-Identifier: Apache-2.0
from __future__ import annotations

import numpy as np
import pytest

from random_problems import random_covariance
from tpgmm_core import GaussianMixture, Manifold

rng = np.random.default_rng(0)


def mixture(K: int = 3, D: int = 4) -> GaussianMixture:
    covariances = np.stack([random_covariance(rng, D, 0.5) for _ in range(K)])
    return GaussianMixture(rng.dirichlet(np.ones(K)), rng.normal(size=(K, D)), covariances)


@pytest.mark.parametrize("several", [False, True])
def test_regression_has_the_moments_of_the_conditional_mixture(several: bool) -> None:
    """Its covariance is that within the components, and that of their means about the common one: the spread."""
    random = np.random.default_rng(4)
    covariances = np.stack([random_covariance(random, 4, 1.0) for _ in range(3)])
    m = GaussianMixture([0.3, 0.3, 0.4], 2.0 * random.normal(size=(3, 4)), covariances)
    given = m.priors @ m.means[:, [1, 3]]
    h = m.responsibilities([1, 3], given)
    parts = [m.component(k).condition([1, 3], given) for k in range(3)]
    mean = sum(w * p.mean for w, p in zip(h, parts, strict=True))
    within = sum(w * p.covariance for w, p in zip(h, parts, strict=True))
    spread = sum(w * np.outer(p.mean - mean, p.mean - mean) for w, p in zip(h, parts, strict=True))
    assert np.trace(spread) > 0.1 * np.trace(within)
    found = m.condition([1, 3], given)
    found_mean, found_covariance = found.mean, found.covariance
    if several:
        both = m.condition([1, 3], np.array([[0.1, 0.5], given]))
        found_mean, found_covariance = both.mean[1], both.covariance[1]
    np.testing.assert_allclose(found_mean, mean, rtol=1e-10, atol=1e-12)
    np.testing.assert_allclose(found_covariance, within + spread, rtol=1e-10, atol=1e-12)


def test_responsibilities_are_bayes_rule_also_far_away() -> None:
    m = mixture()
    x = rng.normal(size=(5, 2))
    h = m.responsibilities([0, 2], x)
    densities = [m.priors[k] * np.exp(m.component(k).marginal([0, 2]).log_density(x)) for k in range(3)]
    np.testing.assert_allclose(h, np.array(densities) / np.sum(densities, axis=0))
    np.testing.assert_allclose(m.responsibilities([0, 2], [1e6, -1e6]).sum(), 1.0)


def test_log_density_adds_up_over_the_components() -> None:
    m = mixture()
    x = rng.normal(size=(6, 4))
    total = sum(m.priors[k] * np.exp(m.component(k).log_density(x)) for k in range(3))
    np.testing.assert_allclose(m.log_density(x), np.log(total))


def test_regression_between_orientations_lies_on_the_shortest_way() -> None:
    manifold = Manifold.parse("R1 x S3")
    turn = np.array([0.0, 0.0, np.sin(0.5), np.cos(0.5)])  # 1 rad about z
    means = np.array([[0.0, 0.0, 0.0, 0.0, 1.0], [1.0, *-turn]])
    m = GaussianMixture([0.5, 0.5], means, 0.1 * np.tile(np.eye(4), (2, 1, 1)), manifold)
    g = m.condition([0], [0.5])
    half = np.array([0.0, 0.0, np.sin(0.25), np.cos(0.25)])
    assert Manifold.parse("S3").distance(g.mean, half) < 1e-9
    np.testing.assert_allclose(np.diag(g.covariance), [0.1, 0.1, 0.1 + 0.25], atol=1e-9)


def test_bad_mixtures_are_refused() -> None:
    with pytest.raises(ValueError, match="priors"):
        GaussianMixture([0.5], np.zeros((2, 3)), np.zeros((2, 3, 3)))
    with pytest.raises(ValueError, match="means"):
        GaussianMixture([0.5], np.zeros(3), np.zeros((1, 3, 3)))
