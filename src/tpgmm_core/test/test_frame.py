# SPDX-License-Identifier: Apache-2.0
from __future__ import annotations

import numpy as np
import pytest

from random_problems import random_quaternion
from tpgmm_core import Demonstration, Frame
from tpgmm_core.geometry import quaternion

rng = np.random.default_rng(3)


def test_project_inverts_the_map_for_scalings_and_reflections() -> None:
    A = np.sqrt(0.1) * np.diag([1.0, -1.0]) + 0.05 * rng.normal(size=(2, 2))
    frame = Frame(A, rng.normal(size=2))
    x = rng.normal(size=(9, 2))
    np.testing.assert_allclose(frame.project(x @ A.T + frame.b), x, atol=1e-12)


def test_project_follows_a_frame_that_moves() -> None:
    A, b = rng.normal(size=(6, 3, 3)), rng.normal(size=(6, 3))
    frame = Frame(A, b)
    x = rng.normal(size=(6, 3))
    xi = np.einsum("tij,tj->ti", A, x) + b
    np.testing.assert_allclose(frame.project(xi), x, atol=1e-9)
    np.testing.assert_allclose(frame.at(4).project(xi[4]), x[4], atol=1e-9)
    assert frame.is_time_varying and not frame.at(4).is_time_varying


def test_project_through_a_rectangular_matrix_is_the_least_squares_solution() -> None:
    A, b = rng.normal(size=(4, 2)), rng.normal(size=4)
    xi = rng.normal(size=(5, 4))
    expected = np.linalg.lstsq(A, (xi - b).T, rcond=None)[0].T
    np.testing.assert_allclose(Frame(A, b).project(xi), expected, atol=1e-12)


def test_a_pose_frame_composes_poses() -> None:
    p, q = rng.normal(size=(5, 3)), random_quaternion(rng, 5)
    frame = Frame.from_pose(p, q)
    x = np.concatenate([rng.normal(size=(5, 3)), random_quaternion(rng, 5)], axis=1)
    xi = np.einsum("tij,tj->ti", frame.A, x) + frame.b
    np.testing.assert_allclose(xi[:, :3], np.einsum("tij,tj->ti", quaternion.rotation_matrix(q), x[:, :3]) + p)
    np.testing.assert_allclose(xi[:, 3:], quaternion.multiply(q, x[:, 3:]))
    np.testing.assert_allclose(frame.project(xi), x, atol=1e-12)
    with_time = frame.with_time()
    np.testing.assert_allclose(
        with_time.project(np.insert(xi, 0, 7.0, axis=1)), np.insert(x, 0, 7.0, axis=1), atol=1e-12
    )


def test_a_constant_part_is_repeated_when_the_other_part_moves() -> None:
    frame = Frame(np.eye(2), np.zeros((5, 2)))
    assert frame.A.shape == (5, 2, 2)


@pytest.mark.parametrize(
    ("A", "b"),
    [
        (np.eye(2), np.zeros(3)),
        (np.eye(2)[0], np.zeros(2)),
        (np.zeros((4, 2, 2)), np.zeros((5, 2))),
        (np.full((2, 2), np.nan), np.zeros(2)),
        (np.eye(2), [0.0, np.inf]),
    ],
)
def test_bad_frames_are_refused(A: np.ndarray, b: np.ndarray) -> None:
    with pytest.raises(ValueError):
        Frame(A, b)


def demonstration(**changes: object) -> Demonstration:
    arguments: dict = {
        "times": np.arange(4.0),
        "data": np.zeros((4, 2)),
        "frames": {"object": Frame(np.eye(2), [1, 2])},
    }
    return Demonstration(**{**arguments, **changes})


def test_a_demonstration_projects_its_data_and_knows_who_saw_what() -> None:
    mask = np.array([True, False, True, True])
    demo = demonstration(visible={"object": mask})
    np.testing.assert_allclose(demo.projected()["object"], np.broadcast_to([-1.0, -2.0], (4, 2)))
    np.testing.assert_array_equal(demo.is_visible("object"), mask)
    assert demonstration().is_visible("object").all()


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"times": np.zeros(4)}, "increase"),
        ({"times": np.arange(3.0)}, "shape"),
        ({"times": [0.0, 1.0, np.nan, 2.0]}, "finite"),
        ({"data": np.full((4, 2), np.nan)}, "finite"),
        ({"frames": {}}, "at least one frame"),
        ({"frames": {"object": Frame(np.eye(3), np.zeros(3))}}, "3 dimensions"),
        ({"frames": {"object": Frame(np.eye(2), np.zeros((5, 2)))}}, "5 time steps"),
        ({"visible": {"objekt": np.ones(4, bool)}}, "objekt"),
        ({"visible": {"object": np.ones(3, bool)}}, "mask"),
        ({"visible": {"object": np.ones(4)}}, "mask"),
    ],
)
def test_bad_demonstrations_are_refused_with_the_reason(changes: dict, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        demonstration(**changes)


def test_an_inverse_of_its_own_takes_the_place_of_the_pseudo_inverse() -> None:
    rng = np.random.default_rng(0)
    A, b, inverse = rng.normal(size=(4, 3, 2)), rng.normal(size=(4, 3)), rng.normal(size=(4, 2, 3))
    frame, xi = Frame(A, b, inverse), rng.normal(size=(4, 3))
    np.testing.assert_allclose(frame.project(xi), np.einsum("tij,tj->ti", inverse, xi - b))
    np.testing.assert_allclose(frame.at(2).project(xi[2]), inverse[2] @ (xi[2] - b[2]))
    with_time = frame.with_time().project(np.column_stack([np.arange(4.0), xi]))
    np.testing.assert_allclose(with_time, np.column_stack([np.arange(4.0), frame.project(xi)]))
    with pytest.raises(ValueError, match="transposed shape"):
        Frame(A, b, A)


def test_stacked_frames_see_what_lies_side_by_side_as_each_alone() -> None:
    rng = np.random.default_rng(5)
    left = Frame.from_pose(rng.normal(size=3), random_quaternion(rng))
    moving = Frame.from_pose(rng.normal(size=(4, 3)), random_quaternion(rng, 4))
    poses = np.concatenate([rng.normal(size=(4, 3)), random_quaternion(rng, 4)], axis=1)
    both = Frame.stacked([left, moving])
    assert both.is_time_varying and both.A.shape == (4, 14, 14)
    seen = both.project(np.concatenate([poses, poses[::-1]], axis=1))
    np.testing.assert_allclose(seen[:, :7], left.project(poses), atol=1e-12)
    np.testing.assert_allclose(seen[:, 7:], moving.project(poses[::-1]), atol=1e-12)
    damped = Frame(np.eye(2), np.zeros(2), 0.5 * np.eye(2))
    np.testing.assert_allclose(Frame.stacked([damped, left]).project(np.ones(9))[:2], 0.5)
    for bad in ([], [moving, Frame(np.eye(2), np.zeros((3, 2)))]):
        with pytest.raises(ValueError, match="stacked"):
            Frame.stacked(bad)
