# SPDX-License-Identifier: Apache-2.0
from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from reaching import reaching_demonstrations
from tpgmm_core import TPGMM, Adapter, Demonstration, Frame, ModelFileError
from tpgmm_core.common.types import Array
from tpgmm_core.learning.estimation.em import expectation, fit_mixture
from tpgmm_core.learning.incremental.online import OnlineTPGMM
from tpgmm_core.learning.incremental.sufficient_statistics import SufficientStatistics, fit_cells
from workloads import W1, Workload, demonstrations, pose_demonstrations

SMALL = Workload("small", n_demonstrations=8, n_samples=60, n_frames=2, D=3, K=4)


def groups(rng: np.random.Generator, centres: Array, n: int = 30) -> Demonstration:
    """A demonstration that rests at one centre after the other; two frames, one turned and shifted."""
    data = np.repeat(centres, n, axis=0) + 0.1 * rng.normal(size=(n * len(centres), centres.shape[1]))
    turned = Frame(np.array([[0.0, -1.0], [1.0, 0.0]]), np.array([1.0, 2.0]))
    return Demonstration(np.arange(float(len(data))), data, {"a": Frame(np.eye(2), np.zeros(2)), "b": turned})


CENTRES = np.array([[0.0, 0.0], [10.0, 0.0], [10.0, 10.0]])


def assert_same_model(a: TPGMM, b: TPGMM, tolerance: float) -> None:
    np.testing.assert_allclose(a.priors_, b.priors_, rtol=0, atol=tolerance)
    for name in b.means_:
        np.testing.assert_allclose(a.means_[name], b.means_[name], rtol=0, atol=tolerance)
        np.testing.assert_allclose(a.covariances_[name], b.covariances_[name], rtol=0, atol=tolerance)


def test_with_one_component_the_model_is_that_of_all_demonstrations_at_once() -> None:
    demos = demonstrations(SMALL)
    online = OnlineTPGMM(1, growth_threshold=None)
    for demo in demos:
        online.partial_fit([demo])
    assert_same_model(online, TPGMM(1).fit(demos), 1e-10)
    assert online.cells_.n_samples == pytest.approx(8 * 60)
    assert online.retained_ == pytest.approx(online.score(demos), abs=1e-9)


def test_with_components_that_do_not_overlap_the_model_is_that_of_all_demonstrations_at_once() -> None:
    rng = np.random.default_rng(0)
    demos = [groups(rng, CENTRES) for _ in range(5)]
    online = OnlineTPGMM(3, init="bins")
    for demo in demos:
        online.partial_fit([demo])
    assert_same_model(online, TPGMM(3, init="bins", tol=0.0).fit(demos), 1e-9)


def test_from_the_same_start_cells_agree_with_batch_learning_to_a_twentieth_of_a_nat() -> None:
    """The stated bound, per sample of 12 dimensions, for movements whose components overlap."""
    demos = demonstrations(W1)
    start = TPGMM(W1.K, regularization="prior", max_iter=5).fit(demos)
    batch = TPGMM(W1.K, regularization="prior", init=start, max_iter=30).fit(demos)
    cells = SufficientStatistics.of(start._samples(demos)).coarser(5)
    emissions = replace(start.emissions_, prior_scatter=start.reg_covar * cells.n_samples / W1.K)
    online = fit_cells(cells, start.priors_, emissions, tol=0.0, max_iter=30)
    assert np.diff(online.objectives).min() > -1e-12
    assert online.log_likelihoods[0] == pytest.approx(batch.log_likelihoods_[0], abs=0.05)
    samples = start._samples(demos)
    log_likelihood = expectation(online.priors, online.emissions, samples)[1] / samples.n_samples
    assert log_likelihood == pytest.approx(batch.score(demos), abs=0.05)
    assert 0.0 < log_likelihood - online.log_likelihoods[-1] < 0.05


@pytest.mark.parametrize("seed", [0, 1])
def test_demonstrations_one_by_one_come_within_a_tenth_of_a_nat_of_all_at_once(seed: int) -> None:
    """Or better: batch learning ends in another maximum, which need not be the higher one."""
    demos = demonstrations(W1, seed)
    batch = TPGMM(W1.K, reg_covar=1e-3, regularization="prior").fit(demos)
    online = OnlineTPGMM(W1.K, reg_covar=1e-3, regularization="prior", growth_threshold=None).fit(demos[:4])
    for demo in demos[4:]:
        online.partial_fit([demo])
    assert online.score(demos) >= batch.score(demos) - 0.1
    assert online.score(demos) - 0.05 <= online.retained_ <= online.score(demos)


@pytest.mark.parametrize("strength", [0.0, 3.0])
@pytest.mark.parametrize("first", [1, 2])
def test_from_one_or_two_demonstrations_on_it_is_as_good_as_all_at_once(first: int, strength: float) -> None:
    """The stated bound, of a hand that reaches: an error a quarter larger, or a millimetre; no component is born."""
    shown = reaching_demonstrations(16)
    params = {"n_components": 4, "manifold": "R1 x R3 x S3", "reg_covar": 1e-5, "prior_strength": strength}
    online = OnlineTPGMM(**params).fit(shown[:first])  # type: ignore[arg-type]
    for n in range(first, 11):
        if n > first:
            online.partial_fit([shown[n - 1]])
        if n in (3, 5, 8, 10):
            batch = TPGMM(**params).fit(shown[:n])  # type: ignore[arg-type]
            assert error_of(online, shown[11:]) < 1.25 * error_of(batch, shown[11:]) + 1e-3
        assert len(online.priors_) == 4 and online.began_with_ == min(n, 8) and online.influence_ == 1.0


def error_of(model: TPGMM, left_out: tuple[Demonstration, ...]) -> float:
    """Root mean square of the position, m; situations that the model refuses count as if the hand had stayed."""
    squares = []
    for d in left_out:
        try:
            means, _, _ = Adapter(model).adapt_and_condition(d.frames, d.times)
        except ValueError:
            means = np.tile(d.data[:1, 1:], (len(d.times), 1))
        squares.append(np.sum((means[:, :3] - d.data[:, 1:4]) ** 2, axis=1).mean())
    return float(np.sqrt(np.mean(squares)))


def test_labels_are_a_start_for_the_first_demonstrations_alone() -> None:
    rng = np.random.default_rng(7)
    demos = [groups(rng, CENTRES) for _ in range(3)]
    online = OnlineTPGMM(3, init=np.repeat([0, 1, 2], 30)).fit(demos[:1])
    assert len(online.partial_fit([demos[1]]).priors_) >= 3 and online.began_with_ == 1


def test_what_so_few_agree_in_is_not_held_back_from() -> None:
    """Two demonstrations that are nearly the same claim to know everything; the third one counts all the same."""
    rng = np.random.default_rng(8)
    model = OnlineTPGMM(3, init="bins", max_loss=0.1).fit([groups(rng, CENTRES) for _ in range(2)])
    third = groups(rng, CENTRES + [3.0, 0.0])
    model.partial_fit([third])
    assert model.influence_ == 1.0 and model.began_with_ == 3
    np.testing.assert_allclose(model.means_["a"], CENTRES + [1.0, 0.0], atol=0.1)


@settings(max_examples=20)
@given(seed=st.integers(0, 2**32 - 1), K=st.integers(1, 4), hidden=st.floats(0.0, 0.5))
def test_the_objective_never_falls_and_the_old_are_as_likely_as_the_statistics_say(
    seed: int, K: int, hidden: float
) -> None:
    rng = np.random.default_rng(seed)

    def walk() -> Demonstration:
        data = np.cumsum(0.3 * rng.normal(size=(40, 2)), axis=0)
        frames = {name: Frame(rng.normal(size=(2, 2)) + 2.0 * np.eye(2), rng.normal(size=2)) for name in "ab"}
        return Demonstration(np.arange(40.0), data, frames, {"b": rng.random(40) >= hidden})

    demos = [walk() for _ in range(3)]
    model = OnlineTPGMM(
        K, init="bins", regularization="prior", reg_covar=1e-2, tol=0.0, max_iter=25, growth_threshold=None
    )
    for i, demo in enumerate(demos):
        model.partial_fit([demo])
        assert np.diff(model.objectives_).min() > -1e-9
        assert model.score(demos[: i + 1]) >= model.retained_ - 1e-9
        assert model.influence_ == 1.0


@pytest.mark.parametrize("covariance", ["full", "diag", "mfa", "semi_tied"])
def test_cells_of_one_sample_are_the_samples(covariance: str) -> None:
    demos = demonstrations(SMALL)
    model = TPGMM(4, covariance=covariance, max_iter=3).fit(demos)
    samples = model._samples(demos)
    cells = SufficientStatistics.of(samples)
    assert cells.bound(model.priors_, model.emissions_) == pytest.approx(model.score(demos) * 480, rel=1e-10)
    a = fit_mixture(samples, model.priors_, model.emissions_, tol=0.0, max_iter=5)
    b = fit_cells(cells, model.priors_, model.emissions_, tol=0.0, max_iter=5)
    np.testing.assert_allclose(a.log_likelihoods, b.log_likelihoods, rtol=1e-9)
    np.testing.assert_allclose(a.emissions.covariances["frame_1"], b.emissions.covariances["frame_1"], atol=1e-9)


def test_coarser_cells_keep_the_moments_of_their_samples() -> None:
    rng = np.random.default_rng(6)
    demos = [groups(rng, CENTRES), groups(rng, CENTRES, n=7)]
    mask = rng.random(21) > 0.5
    demos[1] = Demonstration(demos[1].times, demos[1].data, demos[1].frames, {"b": mask})
    samples = OnlineTPGMM(1).fit(demos)._samples(demos)
    cells = SufficientStatistics.of(samples).coarser(2).coarser(3)
    assert len(cells.counts) == 15 + 4
    np.testing.assert_array_equal(cells.counts[-4:], [6, 6, 6, 3])
    np.testing.assert_array_equal(cells.demonstrations, np.repeat([0, 1], [15, 4]))
    seen = samples.X["b"][90:96][mask[:6]]
    np.testing.assert_allclose(cells.frames["b"].counts[15], len(seen))
    np.testing.assert_allclose(cells.frames["b"].means[15], seen.mean(axis=0))
    np.testing.assert_allclose(cells.frames["b"].scatters[15], np.cov(seen.T, bias=True))


def test_memory_stays_bounded() -> None:
    demos = demonstrations(SMALL)
    model = OnlineTPGMM(4, cell_size=2, max_cells=60)
    for demo in demos:
        model.partial_fit([demo])
        assert len(model.cells_.counts) <= 60
        assert model.score(demos[: model.cells_.demonstrations[-1] + 1]) >= model.retained_ - 1e-9
    assert model.cells_.n_samples == pytest.approx(480)


@pytest.mark.parametrize("max_loss", [0.01, 0.1, 1.0])
def test_contradicting_demonstrations_cost_what_was_learned_no_more_than_stated(max_loss: float) -> None:
    rng = np.random.default_rng(1)
    demos = [groups(rng, CENTRES) for _ in range(4)]
    model = OnlineTPGMM(3, init="bins", growth_threshold=None, max_loss=max_loss).fit(demos)
    before = model.score(demos)
    free = OnlineTPGMM(3, init="bins", growth_threshold=None).fit(demos)
    contradiction = groups(rng, CENTRES + [3.0, 0.0], n=60)
    model.partial_fit([contradiction])
    free.partial_fit([contradiction])
    assert free.score(demos) < before - 1.0 and free.influence_ == 1.0
    assert model.score(demos) >= before - max_loss - 1e-6
    assert 0.0 < model.influence_ < 1.0
    assert model.score([contradiction]) > OnlineTPGMM(3, init="bins").fit(demos).score([contradiction])


def test_what_fits_is_taken_in_whole_and_costs_next_to_nothing() -> None:
    rng = np.random.default_rng(5)
    demos = [groups(rng, CENTRES) for _ in range(8)]
    model = OnlineTPGMM(3, init="bins", max_loss=0.1).fit(demos)
    before = model.score(demos)
    model.partial_fit([groups(rng, CENTRES), groups(rng, CENTRES)])
    assert model.influence_ == 1.0 and len(model.priors_) == 3
    assert model.score(demos) >= before - 0.01


def test_a_component_grows_where_the_data_ask_for_one() -> None:
    rng = np.random.default_rng(2)
    demos = [groups(rng, CENTRES) for _ in range(4)]
    new = [groups(rng, np.vstack([CENTRES, [[0.0, 10.0], [-10.0, 5.0]]])) for _ in range(2)]
    model = OnlineTPGMM(3, init="bins").fit(demos)
    before = model.score(demos)
    model.partial_fit(new)
    assert len(model.priors_) == 5 and model.means_["b"].shape == (5, 2)
    found = model.means_["a"][3:]
    for centre in ([0.0, 10.0], [-10.0, 5.0]):
        assert np.linalg.norm(found - centre, axis=1).min() < 0.1
    # what was learned pays for new components with its priors alone
    assert model.score(demos) >= before + np.log(4 * 90 / (4 * 90 + 2 * 150)) - 0.05
    assert_same_model(model, TPGMM(5, init=model, tol=0.0).fit(demos + new), 1e-6)
    again = model.partial_fit([groups(rng, CENTRES)])
    assert len(again.priors_) == 5


def test_a_few_outliers_found_no_component() -> None:
    rng = np.random.default_rng(3)
    model = OnlineTPGMM(3, init="bins").fit([groups(rng, CENTRES) for _ in range(4)])
    spoilt = groups(rng, CENTRES)
    spoilt.data[[5, 50]] += 30.0
    assert len(model.partial_fit([spoilt]).priors_) == 3


def test_poses_are_taken_in_up_to_the_curvature_of_the_sphere() -> None:
    demos = pose_demonstrations(10, n_samples=60)
    params = {"manifold": "R1 x R3 x S3", "reg_covar": 1e-3}
    batch = TPGMM(4, **params).fit(demos)  # type: ignore[arg-type]
    online = OnlineTPGMM(4, **params, growth_threshold=None).fit(demos[:5])  # type: ignore[arg-type]
    for demo in demos[5:]:
        online.partial_fit([demo])
    assert online.score(demos) >= batch.score(demos) - 0.2
    assert online.score(demos) >= online.retained_


def test_frames_that_were_not_seen_are_left_out_of_the_statistics() -> None:
    rng = np.random.default_rng(4)
    model = OnlineTPGMM(3, init="bins").fit([groups(rng, CENTRES) for _ in range(3)])
    before = model.means_["b"]
    demo = groups(rng, CENTRES)
    hidden = Demonstration(demo.times, demo.data, demo.frames, {"b": np.zeros(len(demo.times), dtype=bool)})
    model.partial_fit([hidden])
    np.testing.assert_allclose(model.means_["b"], before, atol=1e-9)
    assert model.cells_.n_samples == pytest.approx(360.0)


def test_bad_parameters_and_foreign_demonstrations_are_refused() -> None:
    demos = demonstrations(SMALL)
    for params in ({"max_loss": 0.0}, {"growth_threshold": -1.0}):
        with pytest.raises(ValueError, match=next(iter(params))):
            OnlineTPGMM(2, **params).fit(demos)  # type: ignore[arg-type]
    model = OnlineTPGMM(2).fit(demos)
    other = Demonstration(demos[0].times, demos[0].data, {"elsewhere": demos[0].frames["frame_0"]})
    with pytest.raises(ValueError, match="elsewhere"):
        model.partial_fit([other])


@pytest.mark.parametrize("covariance", ["full", "mppca"])
def test_learning_goes_on_from_a_model_file(covariance: str, tmp_path: Path) -> None:
    demos = demonstrations(SMALL)
    model = OnlineTPGMM(4, covariance=covariance, reg_covar=1e-3, growth_threshold=None).fit(demos[:6])
    model.save(tmp_path / "m.tpgmm")
    loaded = OnlineTPGMM.load(tmp_path / "m.tpgmm")
    assert loaded.get_params() == model.get_params()
    assert loaded.retained_ == pytest.approx(model.retained_, rel=1e-12)
    for each in (model, loaded):
        each.partial_fit(demos[6:])
    assert_same_model(loaded, model, 1e-12)
    TPGMM(4).fit(demos).save(tmp_path / "other.tpgmm")
    with pytest.raises(ModelFileError, match="holds a model of the kind TPGMM"):
        OnlineTPGMM.load(tmp_path / "other.tpgmm")


@pytest.mark.parametrize("covariance", ["diag", "spherical", "tied", "mfa", "mppca", "hddc", "semi_tied"])
def test_every_structure_can_go_on(covariance: str) -> None:
    demos = demonstrations(SMALL)
    model = OnlineTPGMM(
        4, covariance=covariance, reg_covar=1e-3, regularization="prior", growth_threshold=None, tol=0.0, max_iter=20
    ).fit(demos[:5])
    before = model.score(demos[5:])
    model.partial_fit(demos[5:])
    assert np.diff(model.objectives_).min() > -1e-9
    assert model.score(demos[5:]) > before
    with pytest.raises(ValueError, match="deep_mfa"):
        OnlineTPGMM(2, covariance="deep_mfa").fit(demos)
