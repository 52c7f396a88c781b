# SPDX-License-Identifier: Apache-2.0
from __future__ import annotations

from functools import cache

import numpy as np
import pytest

from random_problems import random_covariance
from reaching import DURATION, frames_at, place, reaching_model
from tpgmm_core import TPGMM, Demonstration, Frame, Gaussian, GaussianMixture
from tpgmm_core.geometry import quaternion
from tpgmm_core.retrieval.frames import without_time
from tpgmm_core.retrieval.regression import AdaptThenRegress, RegressThenProduct
from worlds import planar_demonstrations, planar_frame, planar_situation

ORDERS = (AdaptThenRegress, RegressThenProduct)
Order = type[AdaptThenRegress] | type[RegressThenProduct]
TIMES = np.linspace(0.0, DURATION, 9)


@cache
def planar_model(K: int = 4) -> TPGMM:
    return TPGMM(K, reg_covar=1e-5).fit(planar_demonstrations())


def reaching_situation() -> dict[str, Frame]:
    return frames_at(start=place(0.1, 0.2, 0.3), object=place(0.6, -0.2, -0.8))


def test_the_orders_agree_for_one_component() -> None:
    first, second = (order(planar_model(1)).retrieve(planar_situation(), TIMES) for order in ORDERS)
    for g, h in zip(first, second, strict=True):
        np.testing.assert_allclose(g.mean, h.mean, atol=1e-9)
        np.testing.assert_allclose(g.covariance, h.covariance, atol=1e-9)


def test_adapting_first_is_the_regression_of_the_adapted_mixture() -> None:
    for model, frames in ((planar_model(), planar_situation()), (reaching_model(), reaching_situation())):
        mixture = model.adapt(frames)
        for t, g in zip(TIMES, AdaptThenRegress(model).retrieve(frames, TIMES), strict=True):
            expected = mixture.condition([0], [t])
            np.testing.assert_allclose(g.manifold.log(expected.mean, g.mean), 0.0, atol=1e-9)
            np.testing.assert_allclose(g.covariance, expected.covariance, atol=1e-9)


def test_regressing_first_is_the_product_of_what_each_frame_expects() -> None:
    for model, frames in ((planar_model(), planar_situation()), (reaching_model(), reaching_situation())):
        views = {
            name: GaussianMixture(model.priors_, model.means_[name], model.covariances_[name], model.manifold_)
            for name in frames
        }
        for t, g in zip(TIMES, RegressThenProduct(model).retrieve(frames, TIMES), strict=True):
            seen = {name: view.condition([0], [t]) for name, view in views.items()}
            expected = Gaussian.product([seen[n].transform(f) for n, f in without_time(frames).items()])
            np.testing.assert_allclose(g.manifold.log(expected.mean, g.mean), 0.0, atol=1e-8)
            np.testing.assert_allclose(g.covariance, expected.covariance, rtol=1e-6, atol=1e-9)


@pytest.mark.parametrize("order", ORDERS)
def test_the_movement_starts_and_ends_where_the_frames_are(order: Order) -> None:
    movement = order(reaching_model()).retrieve(reaching_situation(), TIMES)
    for g, target in ((movement[0], place(0.1, 0.2, 0.3)), (movement[-1], place(0.6, -0.2, -0.8))):
        assert np.linalg.norm(g.mean[:3] - target[:3]) < 0.03
        assert quaternion.angle_between(g.mean[3:], target[3:]) < 0.05
        assert np.linalg.eigvalsh(g.covariance).min() > 0.0


@pytest.mark.parametrize("order", ORDERS)
def test_what_no_frame_constrains_stays_where_the_robot_is(order: Order) -> None:
    frames = {"goal": Frame([[1.0, 0.0], [0.0, 0.0]], [0.4, 0.0]).with_time()}
    for g in order(planar_model()).retrieve(frames, TIMES, state=[7.0, -3.0]):
        assert g.mean[1] == pytest.approx(-3.0, abs=1e-6)
        assert g.covariance[0, 0] < 1.0 < 1e5 < g.covariance[1, 1]


def test_views_of_fewer_dimensions_are_regressed_too() -> None:
    """One frame sees a part of the data only: D_j differs from frame to frame."""
    rng = np.random.default_rng(2)
    t = np.linspace(0.0, 1.0, 50)
    whole = np.column_stack([t, np.sin(t), t**2]) + 0.01 * rng.normal(size=(50, 3))
    model = TPGMM(2).fit_projected({"whole": whole, "part": whole[:, :2]})
    frames = {
        "whole": planar_frame(0.0, 0.0, 0.0).with_time(),
        "part": Frame([[1.0], [0.0]], [0.0, 0.0]).with_time(),
    }
    for order in ORDERS:
        for g, x in zip(order(model).retrieve(frames, t), whole, strict=True):
            np.testing.assert_allclose(g.mean, x[1:], atol=0.1)


def test_bad_input_is_refused_with_the_reason() -> None:
    for order in ORDERS:
        with pytest.raises(ValueError, match="times"):
            order(planar_model()).retrieve(planar_situation(), [np.nan])
        with pytest.raises(ValueError, match="first dimension"):
            order(TPGMM(1).fit_projected({"f": random_covariance(np.random.default_rng(0), 5)[:, :1]}))
        with pytest.raises(ValueError, match="with_time"):
            order(planar_model()).retrieve({"goal": Frame(2.0 * np.eye(3), np.zeros(3))}, TIMES)
        with pytest.raises(ValueError, match="unknown frame"):
            order(planar_model()).retrieve({"moon": planar_frame(0.0, 0.0, 0.0).with_time()}, TIMES)
        with pytest.raises(ValueError, match="at least one"):
            order(planar_model()).retrieve({}, TIMES)


def test_activations_are_the_mean_over_the_frames_by_their_weights() -> None:
    model, frames = planar_model(), planar_situation()
    weights = {"start": 0.2, "goal": 0.7}
    method = RegressThenProduct(model)
    method.situate(frames, weights=weights)
    for t in (0.3, 0.7):
        shares = []
        for name, weight in weights.items():
            variances = model.covariances_[name][:, 0, 0]
            density = (
                model.priors_ * np.exp(-0.5 * (t - model.means_[name][:, 0]) ** 2 / variances) / np.sqrt(variances)
            )
            shares.append(weight * density / density.sum())
        expected = np.sum(shares, axis=0) / sum(weights.values())
        np.testing.assert_allclose(method.at(np.array([t]))[2], expected, rtol=1e-9)


@pytest.mark.parametrize("order", ORDERS)
def test_a_frame_that_shifts_time_is_refused(order: Order) -> None:
    frames = planar_situation()
    shifted = Frame(frames["goal"].A, frames["goal"].b + [0.1, 0.0, 0.0])
    with pytest.raises(ValueError, match="time"):
        order(planar_model()).retrieve({**frames, "goal": shifted}, TIMES)


def test_a_point_in_the_middle_of_the_movement_moves_with_its_own_frame() -> None:
    rng, s = np.random.default_rng(3), np.linspace(0.0, 1.0, 60)

    def situation() -> dict[str, np.ndarray]:
        return {
            "start": rng.normal(scale=0.1, size=2),
            "via": [0.5, 0.3] + rng.normal(scale=0.1, size=2),
            "goal": [1.0, 0.0] + rng.normal(scale=0.1, size=2),
        }

    def frames(places: dict[str, np.ndarray]) -> dict[str, Frame]:
        return {name: Frame(np.eye(2), place).with_time() for name, place in places.items()}

    def demonstrate(places: dict[str, np.ndarray]) -> Demonstration:
        corners = np.stack(list(places.values()))
        path = np.stack(
            [np.interp(s, [0.0, 0.2, 0.4, 0.6, 0.8, 1.0], corners[[0, 0, 1, 1, 2, 2], k]) for k in (0, 1)], 1
        )
        path += 1e-3 * rng.normal(size=path.shape)
        return Demonstration(s, np.column_stack([s, path]), frames(places))

    model = TPGMM(5, reg_covar=1e-5, init="time").fit([demonstrate(situation()) for _ in range(8)])
    for shift in ([0.0, 0.0], [0.2, -0.3], [-0.2, 0.4]):
        new = situation()
        new["via"] = np.array([0.5, 0.3]) + shift
        begin, middle, end = (g.mean for g in RegressThenProduct(model).retrieve(frames(new), [0.1, 0.5, 0.9]))
        np.testing.assert_allclose([begin, middle, end], list(new.values()), atol=0.02)
