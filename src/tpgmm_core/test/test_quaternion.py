# SPDX-License-Identifier: Apache-2.0
from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from random_problems import random_quaternion
from tpgmm_core.geometry import quaternion as qt

rng = np.random.default_rng(0)


def test_products_and_matrices_agree_with_scipy() -> None:
    p, q = random_quaternion(rng, 50), random_quaternion(rng, 50)
    product = (Rotation.from_quat(p) * Rotation.from_quat(q)).as_matrix()
    np.testing.assert_allclose(qt.rotation_matrix(qt.multiply(p, q)), product, atol=1e-12)
    np.testing.assert_allclose(np.einsum("nij,nj->ni", qt.left_matrix(p), q), qt.multiply(p, q), atol=1e-15)


def test_exp_and_log_invert_each_other_up_to_half_a_turn() -> None:
    w = rng.normal(size=(200, 3))
    w *= (rng.uniform(0.0, np.pi - 1e-6, 200) / np.linalg.norm(w, axis=1))[:, None]
    w[:20] *= 10.0 ** -np.arange(20)[:, None]
    np.testing.assert_allclose(qt.log(qt.exp(w)), w, rtol=1e-9, atol=1e-15)
    np.testing.assert_array_equal(qt.log([0.0, 0.0, 0.0, 1.0]), np.zeros(3))
    np.testing.assert_allclose(qt.exp(w), Rotation.from_rotvec(w).as_quat(), atol=1e-14)


def test_log_does_not_depend_on_the_sign() -> None:
    q = random_quaternion(rng, 100)
    np.testing.assert_array_equal(qt.log(q), qt.log(-q))
    assert np.all(qt.angle_between(q, -q) < 1e-7)


def test_from_matrix_inverts_rotation_matrix_also_for_half_turns() -> None:
    half_turns = np.concatenate([np.eye(4), qt.normalize([[1.0, 1.0, 0, 0], [0, 1.0, -1.0, 0], [1e-9, 1.0, 0, 1e-9]])])
    q = np.concatenate([random_quaternion(rng, 100), half_turns])
    back = qt.from_matrix(qt.rotation_matrix(q))
    np.testing.assert_allclose(np.abs(np.sum(q * back, axis=1)), 1.0, atol=1e-12)
    assert np.all(back[:, 3] >= 0.0)


@pytest.mark.parametrize("matrix", [np.diag([1.0, 1.0, -1.0]), 2.0 * np.eye(3), np.full((3, 3), np.nan)])
def test_from_matrix_refuses_what_is_no_rotation(matrix: np.ndarray) -> None:
    with pytest.raises(ValueError, match="not a rotation"):
        qt.from_matrix(matrix)


def test_continuous_removes_sign_jumps_and_keeps_orientations() -> None:
    path = qt.exp(np.linspace(0.0, 6.0, 40)[:, None] * [0.0, 0.6, 0.8])
    flipped = path * rng.choice([-1.0, 1.0], 40)[:, None]
    smooth = qt.continuous(flipped)
    assert np.all(np.sum(smooth[1:] * smooth[:-1], axis=1) > 0.0)
    np.testing.assert_array_equal(np.abs(smooth), np.abs(path))
    assert qt.continuous(np.empty((0, 4))).shape == (0, 4)
    np.testing.assert_array_equal(qt.continuous(path[:1]), path[:1])


def test_slerp_takes_the_shortest_way_at_constant_speed() -> None:
    p, q = random_quaternion(rng), random_quaternion(rng)
    q = -q if p @ q > 0 else q
    way = qt.slerp(p, q, np.linspace(0.0, 1.0, 11))
    steps = qt.angle_between(way[1:], way[:-1])
    np.testing.assert_allclose(steps, qt.angle_between(p, q) / 10.0, atol=1e-9)
    assert qt.angle_between(way[-1], q) < 1e-7


def test_a_zero_quaternion_is_refused() -> None:
    with pytest.raises(ValueError, match="norm"):
        qt.normalize([[0.0, 0.0, 0.0, 0.0]])


def test_roll_pitch_and_yaw_are_turns_about_fixed_axes() -> None:
    for q in random_quaternion(rng, 100):
        np.testing.assert_allclose(qt.roll_pitch_yaw(q), Rotation.from_quat(q).as_euler("xyz"), atol=1e-9)


@pytest.mark.parametrize("pitch", [-np.pi / 2, np.pi / 2])
@pytest.mark.parametrize("yaw", [-3.0, 0.0, 0.4])
def test_at_a_pitch_of_a_quarter_turn_the_roll_says_it_all(pitch: float, yaw: float) -> None:
    q = qt.multiply(qt.exp([0.0, 0.0, yaw]), qt.exp([0.0, pitch, 0.0]))
    angles = qt.roll_pitch_yaw(q)
    np.testing.assert_allclose(angles[1:], [pitch, 0.0], atol=1e-6)
    again = qt.multiply(qt.exp([0.0, angles[1], 0.0]), qt.exp([angles[0], 0.0, 0.0]))
    assert qt.angle_between(again, q) < 1e-6
