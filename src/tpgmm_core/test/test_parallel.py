# SPDX-License-Identifier: Apache-2.0
"""`Parallel`: two movements at the same time are one movement whose references are the products of theirs."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest

from tpgmm_core import TPGMM, Demonstration, Frame
from tpgmm_core.common.types import Array
from tpgmm_core.geometry.gaussian import Gaussian
from tpgmm_core.model.reference import Reference
from tpgmm_core.retrieval.continued import Continued
from tpgmm_core.retrieval.parallel import Parallel
from tpgmm_core.retrieval.regression import RegressThenProduct
from tpgmm_core.retrieval.reproduction import Reproduction

SECOND = 1_000_000_000
FRAMES = {"line": [0.0, 0.3], "pot": [0.5, 0.0]}
SITUATION = {name: Frame(np.eye(2), place).with_time() for name, place in FRAMES.items()}


@cache
def model(name: str, axis: int, duration: float) -> TPGMM:
    """From 0.5 before a frame to it along one axis; along the other one every demonstration goes elsewhere."""
    random, demonstrations = np.random.default_rng(axis), []
    times = np.linspace(0.0, duration, 40)
    for _ in range(6):
        place, data = random.uniform(-1.0, 1.0, 2), np.empty((40, 2))
        data[:, axis] = place[axis] - 0.5 * (1.0 - times / duration) + 0.002 * random.normal(size=40)
        data[:, 1 - axis] = random.uniform(-1.0, 1.0) + 0.002 * random.normal(size=40)
        frames = {name: Frame(np.eye(2), place).with_time()}
        demonstrations.append(Demonstration(times, np.column_stack([times, data]), frames))
    made = TPGMM(n_components=3, reg_covar=1e-6).fit(demonstrations)
    made.metadata_ = {"duration_s": duration}
    return made


def movement(name: str, axis: int, duration: float) -> Reproduction:
    return Reproduction(RegressThenProduct(model(name, axis, duration)), horizon_steps=2, horizon_time_step=0.01)


def both() -> Parallel:
    """Up to a line in 1 s, and along it to a pot in 2 s: each alone leaves the other axis free."""
    return Parallel([movement("line", 1, 1.0), movement("pot", 0, 2.0)])


def run(moving: Parallel | Reproduction | Continued, times: Array, frames: dict[str, Frame]) -> list[Reference]:
    moving.start(0, np.zeros(2))
    return [moving.step(round(t * SECOND), frames, np.zeros(2)) for t in times]


def test_each_step_is_the_product_of_what_the_movements_say_at_their_own_phases() -> None:
    times = np.arange(0.0, 2.5, 0.1)
    together = run(both(), times, SITUATION)
    line = run(movement("line", 1, 1.0), times, {"line": SITUATION["line"]})
    pot = run(movement("pot", 0, 2.0), times, {"pot": SITUATION["pot"]})
    for i, (one, a, b) in enumerate(zip(together, line, pot, strict=True)):
        expected = Gaussian.product([a.gaussian, b.gaussian])
        np.testing.assert_allclose(one.gaussian.mean, expected.mean, atol=1e-12)
        np.testing.assert_allclose(one.gaussian.covariance, expected.covariance, atol=1e-12)
        later = Gaussian.product([a.horizon[1], b.horizon[1]])
        np.testing.assert_allclose(one.horizon[1].mean, later.mean, atol=1e-12)
        assert a.phase == pytest.approx(min(1.0, times[i])) and one.phase == pytest.approx(min(1.0, times[i] / 2.0))
        assert one.activations.sum() == pytest.approx(1.0)


def test_both_are_done_where_each_alone_does_its_own_part_only() -> None:
    end = run(both(), np.arange(0.0, 2.5, 0.1), SITUATION)[-1].gaussian
    np.testing.assert_allclose(end.mean, [0.5, 0.3], atol=0.02)
    assert np.sqrt(np.diag(end.covariance)).max() < 0.05
    for name, axis, duration in (("line", 1, 1.0), ("pot", 0, 2.0)):
        alone = run(movement(name, axis, duration), np.arange(0.0, 2.5, 0.1), {name: SITUATION[name]})[-1].gaussian
        assert np.sqrt(alone.covariance[1 - axis, 1 - axis]) > 0.3, "the other axis is free"


def test_a_movement_whose_frame_is_not_known_does_not_count_and_comes_back() -> None:
    moving = both()
    moving.start(0)
    moving.step(0, SITUATION)
    only = moving.step(SECOND // 2, {"line": SITUATION["line"]})
    alone = run(movement("line", 1, 1.0), np.array([0.0, 0.5]), {"line": SITUATION["line"]})[-1]
    np.testing.assert_allclose(only.gaussian.mean, alone.gaussian.mean, atol=1e-12)
    assert only.frames == ("line",) and only.phase == 0.0, "what does not go on is not done"
    assert len(moving.mixture().priors) == len(only.activations) == 3
    again = moving.step(2 * SECOND, SITUATION)
    assert again.phase == pytest.approx(1.0) and len(moving.mixture().priors) == len(again.activations) == 6
    np.testing.assert_allclose(moving.mixture().priors.sum(), 1.0)


def test_it_can_be_taken_over_without_a_jump_and_paused() -> None:
    former = run(both(), np.arange(0.0, 1.01, 0.01), SITUATION)[-1]
    new = both()
    new.start(SECOND, phase=former.phase)
    assert [round(m.phase.value, 6) for m in new.movements if isinstance(m, Reproduction)] == [1.0, 0.5]
    moved = {**SITUATION, "pot": Frame(np.eye(2), [0.7, 0.0]).with_time()}
    first = Continued(new, former, SECOND, 0.15).step(round(1.001 * SECOND), moved)
    assert np.linalg.norm(first.gaussian.mean - former.gaussian.mean) < 0.002
    new.speed = 0.0
    assert new.speed == 0.0 and all(one.speed == 0.0 for one in new.movements)
    with pytest.raises(ValueError, match="the speed is nan"):
        new.speed = np.nan
    assert all(one.speed == 0.0 for one in new.movements)


def test_what_cannot_be_one_movement_is_refused() -> None:
    with pytest.raises(ValueError, match="at least one"):
        Parallel([])
    with pytest.raises(ValueError, match=r"movement 1 is on R2, movement 2 on R1"):
        Parallel([movement("line", 1, 1.0), Reproduction(_one_dimension())])
    moving = both()
    with pytest.raises(ValueError, match="no step yet"):
        moving.mixture()
    moving.start(0)
    for frames in ({}, {"cup": SITUATION["pot"]}):
        with pytest.raises(ValueError, match="expected frames of"):
            moving.step(0, frames)


def _one_dimension() -> TPGMM:
    times = np.linspace(0.0, 1.0, 20)
    frames = {"line": Frame(np.eye(2), np.zeros(2))}
    shown = [Demonstration(times, np.column_stack([times, times + shift]), frames) for shift in (0.0, 0.1, 0.2)]
    made = TPGMM(n_components=1, reg_covar=1e-4).fit(shown)
    made.metadata_ = {"duration_s": 1.0}
    return made
