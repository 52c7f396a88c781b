# SPDX-License-Identifier: Apache-2.0
"""Coverage on what was left out, the scale that mends it, and references that are scaled by it."""

from __future__ import annotations

from functools import cache
from pathlib import Path

import numpy as np
import pytest

from reaching import frames_at, place, reaching_demonstrations
from tpgmm_core import TPGMM, Frame
from tpgmm_core.choice.calibration import Calibration, coverage, squared_distances
from tpgmm_core.choice.reproducing import reproduce, reproduce_gaussians
from tpgmm_core.geometry.manifold import POSE
from tpgmm_core.retrieval.calibrated import Calibrated, covariance_scale, scale_key
from tpgmm_core.retrieval.methods import METHODS, load_model, make_retrieval
from tpgmm_core.retrieval.recipe import Recipe

OVER_POSES = "R1 x R3 x S3"
SITUATION = frames_at(start=place(0.02, -0.03, 0.2), object=place(0.5, 0.02, -0.2))


@cache
def learned(method: str) -> TPGMM:
    recipe = Recipe.of({"n_components": 4, "reg_covar": 1e-5, "retrieval": method})
    return recipe.learn(reaching_demonstrations(), OVER_POSES)


def scaled(method: str, scale: float) -> TPGMM:
    model = Recipe.of({"n_components": 4, "reg_covar": 1e-5, "retrieval": method}).learn(
        reaching_demonstrations(), OVER_POSES
    )
    model.metadata_[scale_key(method)] = scale
    return model


@pytest.mark.parametrize("factor", [1.0, 4.0])
def test_covariances_that_are_too_small_by_a_factor_are_scaled_by_it(factor: float) -> None:
    rng = np.random.default_rng(0)
    distances = [factor * np.sum(rng.normal(size=(length, 6)) ** 2, axis=1) for length in (2000, 3000, 1500)]
    found = Calibration.of(distances, 6)
    assert found.scale == pytest.approx(factor, rel=0.05)
    for level in (0.5, 0.9, 0.95):
        assert found.scaled_coverage[level] == pytest.approx(level, abs=0.02)
        assert abs(found.coverage[level] - level) < 0.02 or factor != 1.0
    assert factor == 1.0 or found.coverage[0.9] < 0.5


def test_each_demonstration_counts_alike_however_many_samples_it_has() -> None:
    inside, outside = np.zeros(10), np.full(1000, 1e6)
    assert coverage([inside, outside], 3)[0.9] == 0.5


def test_a_scale_is_tested_on_what_it_was_not_made_of() -> None:
    """One demonstration far off: the others' scale says nothing of it, so that it stays outside."""
    rng = np.random.default_rng(1)
    near = [np.sum(rng.normal(size=(500, 3)) ** 2, axis=1) for _ in range(3)]
    found = Calibration.of([*near, np.full(500, 1e4)], 3)
    assert found.scale > 100.0 and found.scaled_coverage[0.95] == pytest.approx(0.75, abs=0.02)


def test_samples_in_which_no_frame_was_seen_are_left_out() -> None:
    distances = np.array([np.nan, 0.1, 0.2, np.nan])
    assert coverage([distances[1:3]], 3) == Calibration.of([distances], 3).coverage
    with pytest.raises(ValueError, match="at least one demonstration"):
        Calibration.of([np.full(3, np.nan)], 3)


@pytest.mark.parametrize("method", METHODS)
def test_every_method_says_how_exact_it_is_on_what_it_has_not_seen(method: str) -> None:
    """Distances are those of the means that are reproduced, and calibrated ones lie in their regions."""
    model, new = learned(method), reaching_demonstrations(9)[6:]
    np.testing.assert_array_equal(reproduce_gaussians(model, new[0])[0], reproduce(model, new[0]))
    distances = [squared_distances(model, shown, POSE) for shown in new]
    assert all(np.isfinite(d).all() and d.shape == (60,) for d in distances)
    found = Calibration.of(distances, 6)
    assert coverage([d / found.scale for d in distances], 6)[0.9] == pytest.approx(0.9, abs=0.02)


@pytest.mark.parametrize("method", METHODS)
def test_references_of_every_method_are_scaled_as_the_model_file_says(method: str, tmp_path: Path) -> None:
    scaled(method, 4.0).save(tmp_path / "model.tpgmm")
    calibrated, plain = make_retrieval(load_model(tmp_path / "model.tpgmm")), make_retrieval(learned(method))
    assert isinstance(calibrated, Calibrated) and not isinstance(plain, Calibrated)
    state = place(0.02, -0.03, 0.2)
    for retrieval in (calibrated, plain):
        retrieval.start(0, state)
    for i in range(1, 40):
        one, other = (r.step(20_000_000 * i, SITUATION, state) for r in (calibrated, plain))
        for a, b in zip((one.gaussian, *one.horizon), (other.gaussian, *other.horizon), strict=True):
            np.testing.assert_array_equal(a.mean, b.mean)
            np.testing.assert_allclose(a.covariance, 4.0 * b.covariance, rtol=1e-12)
    for a, b in zip(calibrated.horizon(3, 0.1), plain.horizon(3, 0.1), strict=True):
        np.testing.assert_allclose(a.covariance, 4.0 * b.covariance, rtol=1e-12)
    calibrated.speed = 0.5
    assert plain.speed == 1.0 and calibrated.speed == 0.5 and calibrated.duration == plain.duration
    assert calibrated.frame_names == plain.frame_names and calibrated.manifold == plain.manifold


def test_what_no_frame_constrains_stays_free() -> None:
    model = TPGMM(3, reg_covar=1e-5).fit_projected({"f": np.random.default_rng(0).normal(size=(60, 3))})
    model.metadata_ = {"duration_s": 1.0, scale_key("adapt_regress"): 0.01}
    retrieval = make_retrieval(model)
    retrieval.start(0, np.zeros(2))
    only_x = {"f": Frame([[1.0, 0.0], [0.0, 0.0]], [0.0, 0.0]).with_time()}
    assert retrieval.step(10_000_000, only_x, np.zeros(2)).gaussian.covariance[1, 1] >= 0.9e6


@pytest.mark.parametrize("scale", [0.0, -1.0, "much", float("inf")])
def test_a_scale_that_is_none_is_refused(scale: object) -> None:
    model = TPGMM()
    model.metadata_ = {scale_key("dmp"): scale}  # type: ignore[dict-item]
    with pytest.raises(ValueError, match=r"covariance_scale\.dmp = .*expected a number above 0"):
        covariance_scale(model, "dmp")
