# SPDX-License-Identifier: Apache-2.0
from __future__ import annotations

import itertools
import json
from pathlib import Path

import numpy as np
import pytest

from tpgmm_core import TPGMM, Demonstration, Frame, GaussianMixture
from tpgmm_core.learning.covariance.structure import Structure
from tpgmm_core.learning.criteria import aic, bic
from tpgmm_core.learning.dirichlet import DirichletTPGMM
from tpgmm_core.learning.estimation.emissions import Emissions
from tpgmm_core.learning.held_out import leave_one_out
from tpgmm_core.learning.selection import select_model
from tpgmm_core.model.samples import Samples
from workloads import pose_demonstrations


def via_points(n_demonstrations: int, n_samples: int = 60, seed: int = 0) -> list[Demonstration]:
    """From rest at one of two objects to rest at the other: three clear parts, in the plane over time."""
    rng = np.random.default_rng(seed)
    times = np.linspace(0.0, 1.0, n_samples)
    share = np.clip(3.0 * times - 1.0, 0.0, 1.0)[:, None]
    result = []
    for _ in range(n_demonstrations):
        a, b = rng.normal(size=(2, 2))
        path = (1.0 - share) * a + share * b + 0.02 * rng.normal(size=(n_samples, 2))
        frames = {name: Frame(np.eye(2), p).with_time() for name, p in (("from", a), ("to", b))}
        result.append(Demonstration(times, np.column_stack([times, path]), frames))
    return result


# K = 3 components, frames of 4 and 6 dimensions, d = 2 factors: covariance parameters by hand
@pytest.mark.parametrize(
    ("structure", "by_hand"),
    [
        (Structure("full"), 3 * 10 + 3 * 21),
        (Structure("diag"), 3 * 4 + 3 * 6),
        (Structure("spherical"), 3 + 3),
        (Structure("tied"), 10 + 21),
        # loadings up to a rotation: 4 * 2 - 1 and 6 * 2 - 1; then the noise
        (Structure("mfa", n_factors=2), 3 * (7 + 4 - 1) + 3 * (11 + 6)),
        (Structure("mppca", n_factors=2), 3 * (7 + 1) + 3 * (11 + 1)),
        # a basis up to the scale of its rows, and a diagonal for each component
        (Structure("semi_tied"), (4 * 3 + 3 * 4) + (6 * 5 + 3 * 6)),
    ],
    ids=lambda value: value.name if isinstance(value, Structure) else "",
)
def test_parameters_are_counted_as_by_hand(structure: Structure, by_hand: int) -> None:
    rng = np.random.default_rng(0)
    samples = Samples.from_projected({"a": rng.normal(size=(90, 4)), "b": rng.normal(size=(90, 6))}, None, "euclidean")
    emissions = Emissions.from_labels(structure, samples, np.repeat(np.arange(3), 30))
    # four dimensions hold a full covariance of 10 numbers, where 7 + 4 of two factors would be 11
    assert emissions.n_parameters == by_hand + 3 * (4 + 6)


def test_each_component_of_the_parsimonious_family_counts_its_own_dimensions() -> None:
    rng = np.random.default_rng(1)
    spreads = np.array([[9.0, 0.1, 0.1, 0.1, 0.1], [9.0, 8.0, 7.0, 0.1, 0.1]])
    x = rng.normal(size=(400, 5)) * np.repeat(spreads, 200, axis=0)
    samples = Samples.from_projected({"a": x}, None, "euclidean")
    emissions = Emissions.from_labels(Structure("hddc"), samples, np.repeat([0, 1], 200))
    # d = 1: 5 loadings; d = 3: 15 less the 3 of rotations; one noise each; and the means
    assert emissions.n_parameters == (5 + 1) + (12 + 1) + 2 * 5


def test_a_quaternion_counts_three_dimensions() -> None:
    demos = pose_demonstrations(2, n_samples=30)
    model = TPGMM(4, manifold="R1 x R3 x S3").fit(demos)
    n, P, K = 7, 3, 4
    assert model.n_parameters_ == K - 1 + P * K * (n + n * (n + 1) // 2)


def test_the_criteria_are_their_definitions() -> None:
    assert bic(-100.0, 7, 50) == pytest.approx(200.0 + 7 * np.log(50))
    assert aic(-100.0, 7) == 214.0
    with pytest.raises(ValueError, match="at least one sample"):
        bic(-1.0, 1, 0)


def test_leave_one_out_is_the_score_under_a_model_of_the_others() -> None:
    demos = via_points(4)
    estimator = TPGMM(3)
    told: list[tuple[int, int]] = []
    held_out = leave_one_out(estimator, demos, progress=lambda done, of: told.append((done, of)))
    by_hand = [TPGMM(3).fit(demos[:i] + demos[i + 1 :]).score([demos[i]]) for i in range(4)]
    np.testing.assert_allclose(held_out.per_demonstration, by_hand)
    assert told == [(1, 4), (2, 4), (3, 4), (4, 4)] and not hasattr(estimator, "priors_")


def test_longer_demonstrations_count_more_per_sample() -> None:
    demos = via_points(3)
    demos[0] = Demonstration(demos[0].times[::2], demos[0].data[::2], demos[0].frames)
    held_out = leave_one_out(TPGMM(3), demos)
    np.testing.assert_array_equal(held_out.lengths, [30, 60, 60])
    assert held_out.per_sample == pytest.approx(np.dot(held_out.per_demonstration, [0.2, 0.4, 0.4]))


def test_a_score_is_the_log_likelihood_of_what_was_seen() -> None:
    demos = via_points(3)
    model = TPGMM(3).fit(demos)
    assert model.score(demos) == pytest.approx(TPGMM(3, init=model).fit(demos).log_likelihoods_[0], abs=1e-12)
    hidden = {"from": np.zeros(60, dtype=bool)}
    blind = Demonstration(demos[0].times, demos[0].data, demos[0].frames, hidden)
    alone = Demonstration(demos[0].times, demos[0].data, {"to": demos[0].frames["to"]})
    view = GaussianMixture(model.priors_, model.means_["to"], model.covariances_["to"])
    assert model.score([blind]) == pytest.approx(view.log_density(blind.projected()["to"]).mean())
    with pytest.raises(ValueError, match="the model has frames"):
        model.score([alone])
    with pytest.raises(ValueError, match="not fitted"):
        TPGMM().score(demos)


def test_leave_one_out_chooses_what_generalises_where_bic_goes_on() -> None:
    demos = via_points(5)
    candidates = [TPGMM(K, reg_covar=1e-5) for K in (1, 3, 6, 10)]
    table = select_model(candidates, demos)
    by_k = {row.n_components: row for row in table.rows}
    assert table.best.n_components in (3, 6)
    assert by_k[1].held_out < by_k[3].held_out  # type: ignore[operator]
    fit = [row.log_likelihood for row in table.rows]
    assert fit == sorted(fit)  # what was seen fits ever better


def test_the_table_is_printed_saved_and_plotted(tmp_path: Path) -> None:
    demos = via_points(3)
    candidates = {"three": TPGMM(3), "too many": TPGMM(500), "found": DirichletTPGMM(6, init="bins")}
    told: list[tuple[int, int]] = []
    ticks = itertools.count()
    table = select_model(
        candidates, demos, progress=lambda done, of: told.append((done, of)), clock=lambda: float(next(ticks))
    )
    text = str(table)
    assert "DirichletTPGMM" in text and "*" in text and "500 components need" in text
    assert told[-1] == (12, 12) and [done for done, _ in told] == sorted(done for done, _ in told)
    values = json.loads(json.dumps(table.to_dict(), allow_nan=False))
    assert values["best"] == table.best.name and values["rows"][1]["bic"] is None
    assert values["rows"][0]["fit_time_s"] == 1.0
    table.save(tmp_path / "report.json")
    assert json.loads((tmp_path / "report.json").read_text()) == values
    table.plot(tmp_path / "table.png")
    assert (tmp_path / "table.png").stat().st_size > 5000


@pytest.mark.parametrize("criterion", ["bic", "aic"])
def test_information_criteria_need_one_fit_each(criterion: str) -> None:
    demos = via_points(3)
    table = select_model([TPGMM(K) for K in (1, 2, 3)], demos, criterion=criterion)
    assert all(row.held_out is None for row in table.rows)
    best = min(table.rows, key=lambda row: getattr(row, criterion))
    assert table.best is best
    N = 180
    row = table.rows[1]
    assert row.bic - row.aic == pytest.approx(row.n_parameters * (np.log(N) - 2.0))


def test_what_cannot_be_selected_is_refused_with_the_reason() -> None:
    demos = via_points(2)
    with pytest.raises(ValueError, match="the criterion is one of leave-one-out, bic, aic"):
        select_model([TPGMM()], demos, criterion="mdl")
    with pytest.raises(ValueError, match="needs more demonstrations than 1"):
        select_model([TPGMM()], demos[:1])
    with pytest.raises(ValueError, match="at least one candidate"):
        select_model([], demos)
    with pytest.raises(ValueError, match="give a mapping"):
        select_model([TPGMM(3), TPGMM(3, init="bins")], demos)
    with pytest.raises(ValueError, match="no candidate could be fitted"):
        _ = select_model([TPGMM(500)], demos).best
    with pytest.raises(ValueError, match="at least two demonstrations"):
        leave_one_out(TPGMM(), demos[:1])
