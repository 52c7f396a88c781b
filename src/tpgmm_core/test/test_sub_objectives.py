# SPDX-License-Identifier: Apache-2.0
"""The inverse optimal control reading: sub-objectives of the frames and their shares."""

import numpy as np
import pytest

from reaching import DURATION, frames_at, place, reaching_model
from tpgmm_core import TPGMM, Demonstration, Frame
from tpgmm_core.retrieval.sub_objectives import SubObjectives, sub_objectives

TIMES = np.linspace(0.0, DURATION, 21)


def reaching_objectives() -> SubObjectives:
    situation = frames_at(start=place(0.05, -0.05, 0.2), object=place(0.45, 0.1, -0.3))
    return sub_objectives(reaching_model(), TIMES, situation)


def test_shares_are_between_0_and_1_and_add_up() -> None:
    shares = reaching_objectives().shares
    assert shares.shape == (21, 2, 6)
    assert (shares >= 0.0).all() and (shares <= 1.0).all()
    np.testing.assert_allclose(shares.sum(axis=1), 1.0, rtol=1e-9)


def test_a_reach_is_about_the_start_first_and_about_the_object_in_the_end() -> None:
    objectives = reaching_objectives()
    start, goal = (objectives.weights(slice(0, 2))[:, objectives.frames.index(name)] for name in ("start", "object"))
    assert start[0] > 0.9 and goal[-1] > 0.9


def test_the_movement_minimises_the_sum_of_the_sub_objectives() -> None:
    """Eq. (3), on planar data: precisions and costs are those of the frames' own Gaussians."""
    rng = np.random.default_rng(0)
    demonstrations = []
    for _ in range(6):
        a, b = rng.normal(size=2), rng.normal(size=2)
        u = np.linspace(0.0, 1.0, 50)
        path = a + u[:, None] * (b - a) + 0.02 * rng.normal(size=(50, 2))
        frames = {name: Frame(np.eye(2), origin).with_time() for name, origin in (("a", a), ("b", b))}
        demonstrations.append(Demonstration(u, np.column_stack([u, path]), frames))
    model = TPGMM(3, reg_covar=1e-4).fit(demonstrations)
    objectives = sub_objectives(model, [0.0, 0.4, 1.0], demonstrations[0].frames)
    np.testing.assert_allclose(
        np.linalg.inv(objectives.precisions.sum(axis=1)), objectives.covariances, rtol=1e-6, atol=1e-9
    )
    # at the minimum, a step costs the same for any sign: no gradient is left
    step = np.array([0.01, -0.02])

    def total(t: int, x: np.ndarray) -> float:
        result = 0.0
        for j, name in enumerate(objectives.frames):
            one = sub_objectives(model, [[0.0, 0.4, 1.0][t]], {name: demonstrations[0].frames[name]})
            e = x - one.means[0]
            result += e @ objectives.precisions[t, j] @ e
        return float(result)

    for t in range(3):
        x = objectives.means[t]
        assert total(t, x + step) == pytest.approx(total(t, x - step), rel=1e-6)
        assert objectives.costs[t].sum() == pytest.approx(total(t, x), rel=1e-6)


def test_a_frame_alone_has_all_of_the_objective_and_no_conflict() -> None:
    objectives = sub_objectives(reaching_model(), TIMES, frames_at(object=place(0.45, 0.1, -0.3)))
    np.testing.assert_allclose(objectives.weights(), 1.0, rtol=1e-9)
    np.testing.assert_allclose(objectives.costs, 0.0, atol=1e-9)
