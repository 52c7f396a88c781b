# SPDX-License-Identifier: Apache-2.0
"""Movements that repeat: found in what was shown, learned over an angle, and gone through from rest to rest."""

from __future__ import annotations

from functools import cache
from pathlib import Path

import numpy as np
import pytest

from reaching import frames_at, place, reaching_demonstrations
from tpgmm_core import Demonstration
from tpgmm_core.choice.reproducing import reproduce
from tpgmm_core.geometry import quaternion
from tpgmm_core.geometry.manifold import POSE
from tpgmm_core.learning.cycles import TURN
from tpgmm_core.learning.periodic import PeriodicTPGMM
from tpgmm_core.retrieval.methods import PERIODIC, load_model, make_retrieval
from tpgmm_core.retrieval.recipe import Recipe
from tpgmm_core.retrieval.relevance import relevance
from wiping import PERIOD, ROBOT, wiping_demonstration, wiping_demonstrations, wiping_poses

MANIFOLD = "R1 x R3 x S3"
BEFORE = place(0.2, -0.25, 0.6)
SITUATION = frames_at(robot=ROBOT, object=BEFORE)
TICK = 0.005


@cache
def learned(method: str = "periodic") -> PeriodicTPGMM:
    return Recipe.of({"retrieval": method}).learn(wiping_demonstrations(), MANIFOLD)  # type: ignore[return-value]


def run(seconds: float, duration: float) -> tuple[np.ndarray, float]:
    """Means (T, 7) of the references at each TICK, and the last phase."""
    retrieval = make_retrieval(learned(), duration=duration)
    retrieval.start(0)
    references = [retrieval.step(round(1e9 * TICK) * i, SITUATION) for i in range(round(seconds / TICK) + 1)]
    return np.array([reference.gaussian.mean for reference in references]), references[-1].phase


def turned(path: np.ndarray) -> float:
    """How often a path goes round the middle of the wiped surface."""
    R = quaternion.rotation_matrix(BEFORE[3:])
    x, y, _ = ((path[:, :3] - BEFORE[:3]) @ R - [0.2, 0.0, 0.0]).T
    return float(np.ptp(np.unwrap(np.arctan2(y, x)))) / TURN


def test_what_is_wiped_before_an_object_elsewhere_is_known_to_some_millimetres() -> None:
    """Where other methods, for which the movement is one long way, are far off: demonstrations differ in their pace."""
    random = np.random.default_rng(11)
    errors = {"periodic": [], "promp": []}
    for _ in range(4):
        shown = wiping_demonstration(place(*random.uniform(-0.3, 0.3, 2), random.uniform(-0.8, 0.8)), random)
        for method, found in errors.items():
            path = reproduce(learned(method), shown)
            found.append(np.sqrt(np.mean(np.sum((path[:, :3] - shown.data[:, 1:4]) ** 2, axis=1))))
    assert np.mean(errors["periodic"]) < 0.008 and np.mean(errors["promp"]) > 5.0 * np.mean(errors["periodic"])


def test_the_period_is_that_of_all_cycles_also_where_time_was_stretched() -> None:
    shown = wiping_demonstrations()
    cycles = sum(d.times[-1] for d in shown) / learned().period_
    assert 3.0 * len(shown) <= learned().cycles_ <= cycles < 4.0 * len(shown)
    assert learned().period_ == pytest.approx(PERIOD, rel=0.15)
    mean = float(np.mean([d.times[-1] for d in shown]))
    stretched = [
        Demonstration(t, np.column_stack([t, d.data[:, 1:]]), d.frames)
        for d in shown
        for t in [d.times * (mean / d.times[-1])]
    ]
    again = Recipe.of({"retrieval": "periodic"}).learn(stretched, MANIFOLD)
    assert isinstance(again, PeriodicTPGMM) and again.period_ == pytest.approx(learned().period_, rel=5e-3)


def test_place_velocity_and_covariance_are_the_same_after_a_turn() -> None:
    course = PERIODIC.course(learned())
    assert course is not None
    course.situate(SITUATION)
    step = 1e-5
    means, covariances, _ = course.at(np.array([TURN - step, TURN, TURN + step, 0.0, 5.0 * TURN + step]))
    before, after = POSE.log(means[0], means[1]) / step, POSE.log(means[1], means[2]) / step
    # between steps of the phase covariances are mixed evenly, so that velocities change a little at each of them
    np.testing.assert_allclose(after, before, atol=1e-3 * np.abs(before).max())
    np.testing.assert_allclose(means[3], means[1], atol=1e-12)
    np.testing.assert_allclose(means[4], means[2], atol=1e-12)
    np.testing.assert_allclose(covariances[2], covariances[0], rtol=1e-3, atol=1e-3 * covariances[0].max())


@pytest.mark.parametrize(("periods", "cycles"), [(1.25, 1), (2.2, 1), (2.3, 2), (4.9, 4), (0.5, 1)])
def test_a_duration_is_that_of_whole_cycles_from_rest_to_rest(periods: float, cycles: int) -> None:
    period = learned().period_
    path, phase = run(periods * period + 0.5, periods * period)
    assert phase == 1.0 and turned(path) == pytest.approx(cycles, abs=0.01)
    np.testing.assert_allclose(path[-1], path[0], atol=1e-9)
    velocities = np.diff(path[:, :3], axis=0) / TICK
    speeds = np.linalg.norm(velocities, axis=1)
    end = round(periods * period / TICK)
    assert max(speeds[0], speeds[end - 1]) < 0.02 * speeds.max() and (speeds[end + 1 :] < 1e-9).all()
    # A circle goes round with 0.1 m and TURN / period; no faster than demonstrated where there is time for a cycle
    usual = 0.1 * TURN / period
    assert speeds.max() < 1.3 * usual * (1.0 if periods > 1.2 else 5.0)
    largest = np.linalg.norm(np.diff(velocities, axis=0), axis=1).max() / TICK
    assert largest < 2.0 * usual**2 / 0.1 * (1.0 if periods > 1.2 else 25.0), "no jump of the velocity"


def test_a_saved_model_does_the_same(tmp_path: Path) -> None:
    learned().save(tmp_path / "wipe.tpgmm")
    model = load_model(tmp_path / "wipe.tpgmm")
    assert isinstance(model, PeriodicTPGMM) and (model.period_, model.cycles_) == (
        learned().period_,
        learned().cycles_,
    )
    shown = wiping_demonstrations()[0]
    np.testing.assert_array_equal(reproduce(model, shown), reproduce(learned(), shown))


def test_the_object_says_where_to_wipe() -> None:
    shares = relevance(learned(), 4).shares
    assert shares["object"].min() > 0.9


def test_the_mean_path_is_the_one_that_was_wiped() -> None:
    course = PERIODIC.course(learned())
    assert course is not None
    course.situate(SITUATION)
    found = course.at(np.linspace(0.0, TURN, 50))[0]
    true = wiping_poses(BEFORE, np.linspace(0.0, TURN, 200))
    nearest = np.linalg.norm(found[:, None, :3] - true[None, :, :3], axis=2).min(axis=1)
    assert nearest.max() < 0.005


def test_what_does_not_repeat_is_refused_and_so_is_what_needs_an_end() -> None:
    with pytest.raises(ValueError, match="demonstration 0: the movement does not repeat itself.*two cycles"):
        Recipe.of({"retrieval": "periodic"}).learn(reaching_demonstrations(), MANIFOLD)
    with pytest.raises(ValueError, match="'state' is for adapt_regress.*periodic estimates the phase itself"):
        make_retrieval(learned(), phase="state")
    with pytest.raises(ValueError, match="periodic cannot meet constraints exactly"):
        Recipe.of({"retrieval": "periodic", "exact": "object at 1"}).learn(wiping_demonstrations(), MANIFOLD)
    with pytest.raises(ValueError, match=r"adapt_regress needs a model of \[time, data\].*choose periodic"):
        make_retrieval(learned(), "adapt_regress")
