# SPDX-License-Identifier: Apache-2.0
"""The inverse optimal control reading: sub-objectives of the frames and their shares."""

import json

import numpy as np
import pytest
from scipy.optimize import minimize

from reaching import DURATION, frames_at, place, reaching_demonstrations, reaching_model
from tpgmm_core import TPGMM, Demonstration, Frame
from tpgmm_core.geometry.manifold import POSE
from tpgmm_core.retrieval.regression import RegressThenProduct
from tpgmm_core.retrieval.sub_objectives import SubObjectives, quadratic_costs, sub_objectives

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


def test_a_solver_that_knows_the_exported_costs_and_the_objects_alone_finds_the_movement() -> None:
    """JSON in, quaternions in plain numpy, scipy's minimiser: nothing of the project takes part."""
    places = {"start": place(0.05, -0.05, 0.2), "object": place(0.45, 0.1, -0.3)}
    times = [0.0, 0.8, DURATION]
    text = json.dumps(quadratic_costs(reaching_model(), times), allow_nan=False)
    costs = json.loads(text)
    assert costs["manifold"] == "R3 x S3" and list(costs["frames"]) == ["start", "object"]

    def times_conjugate(q: np.ndarray, p: np.ndarray) -> np.ndarray:  # conj(q) p, as x, y, z, w
        return np.array([*(q[3] * p[:3] - p[3] * q[:3] - np.cross(q[:3], p[:3])), q @ p])

    def turn(p: np.ndarray, q: np.ndarray) -> np.ndarray:  # rotation vector of p conj(q), in fixed axes
        v, w = q[3] * p[:3] - p[3] * q[:3] - np.cross(p[:3], q[:3]), p @ q
        v, w = (v, w) if w >= 0.0 else (-v, -w)
        sine = np.linalg.norm(v)
        return 2.0 * np.arctan2(sine, w) * v / sine if sine > 1e-12 else 2.0 * v

    def total(x: np.ndarray, t: int) -> float:
        x = np.concatenate([x[:3], x[3:] / np.linalg.norm(x[3:])])
        cost = 0.0
        for name, terms in costs["frames"].items():
            b, q = places[name][:3], places[name][3:]
            away = np.array([*(x[:3] - b), 0.0])  # seen from the frame: conj(q) (x - b) q
            seen = times_conjugate(times_conjugate(q, away) * [-1.0, -1.0, -1.0, 1.0], q)[:3]
            target = np.array(terms["targets"][t])
            e = np.concatenate([seen - target[:3], turn(times_conjugate(q, x[3:]), target[3:])])
            cost += e @ np.array(terms["precisions"][t]) @ e
        return float(cost)

    expected = RegressThenProduct(reaching_model()).retrieve(frames_at(**places), times)
    for t, gaussian in enumerate(expected):
        near = POSE.exp(gaussian.mean, [0.02, -0.01, 0.02, 0.05, 0.0, -0.05])
        found = minimize(total, near, args=(t,), method="BFGS", options={"gtol": 1e-6}).x
        found[3:] /= np.linalg.norm(found[3:])
        assert total(near, t) > 2.0 * total(found, t)
        np.testing.assert_allclose(POSE.log(gaussian.mean, found), 0.0, atol=2e-4)


def test_a_model_without_time_has_no_costs_over_time() -> None:
    model = TPGMM(4, reg_covar=1e-5, manifold="R1 x R3 x S3").fit(reaching_demonstrations())
    model.dimensions_ = ("x", *[f"d{i}" for i in range(7)])
    with pytest.raises(ValueError, match="need a model over time; this one is over x, d0"):
        quadratic_costs(model, [0.0])
