# SPDX-License-Identifier: Apache-2.0
"""Constraints that movements meet exactly: at their end, on the way, of any function of time."""

from __future__ import annotations

from functools import cache
from pathlib import Path

import numpy as np
import pytest

from reaching import DURATION, frames_at, place, reaching_demonstrations
from tpgmm_core import TPGMM
from tpgmm_core.choice.reproducing import reproduce
from tpgmm_core.geometry.manifold import POSE
from tpgmm_core.retrieval.exact import Constrained, Constraint, constraints_of, parsed
from tpgmm_core.retrieval.interface import TimeParametrized
from tpgmm_core.retrieval.methods import METHODS, load_model, make_retrieval
from tpgmm_core.retrieval.recipe import Recipe
from worlds import moved, random_world

FUNCTIONS_OF_TIME = [name for name, method in METHODS.items() if method.time_parametrized is not None]
SITUATION = frames_at(start=place(0.02, -0.03, 0.2), object=place(0.9, 0.4, -0.9))
"""Far from what was demonstrated, so that the frames contradict each other."""
HAND = place(0.35, 0.05, 0.1)


@cache
def learned(method: str, exact: str | None = "object at 1") -> TPGMM:
    settings = {"n_components": 4, "reg_covar": 1e-5, "retrieval": method}
    settings |= {} if exact is None else {"exact": exact}
    return Recipe.of(settings).learn(reaching_demonstrations(8), "R1 x R3 x S3")


def course_of(method: str, exact: str | None = "object at 1") -> TimeParametrized:
    course = METHODS[method].course(learned(method, exact))
    assert course is not None
    return course


@pytest.mark.parametrize("method", FUNCTIONS_OF_TIME)
def test_a_movement_ends_exactly_where_the_frame_alone_says(method: str) -> None:
    free, bound = course_of(method, None), course_of(method)
    end = np.array([DURATION])
    free.situate({"object": SITUATION["object"]})
    alone = free.at(end)[0][0]
    for course in (free, bound):
        course.situate(SITUATION)
    means, covariances, _ = bound.at(end)
    np.testing.assert_allclose(POSE.log(alone, means[0]), 0.0, atol=1e-6)
    assert np.linalg.eigvalsh(covariances[0]).max() < 1.1e-8
    times = np.linspace(0.0, 0.5 * DURATION, 20)  # five widths away
    np.testing.assert_allclose(POSE.log(free.at(times)[0], bound.at(times)[0]), 0.0, atol=1e-5)
    times = np.linspace(0.0, DURATION, 400)
    speeds = [np.abs(np.diff(c.at(times)[0][:, :3], axis=0)).max() for c in (free, bound)]
    assert speeds[1] < 3.0 * speeds[0]  # no jump


def test_several_constraints_are_met_at_once_and_a_point_may_be_any() -> None:
    point = (0.1, -0.2, 0.3, 0.0, 0.0, 0.0, 1.0)
    course = Constrained(
        course_of("time_steps", None),
        [Constraint("start", 0.0), Constraint("object", 0.5, point), Constraint("object", 0.6)],
    )
    course.situate(SITUATION)
    means, covariances, _ = course.at(DURATION * np.array([0.0, 0.5, 0.6, 1.0]))
    frame = SITUATION["object"]
    np.testing.assert_allclose(means[1], frame.A[1:, 1:] @ point + frame.b[1:], atol=1e-9)
    assert np.linalg.eigvalsh(covariances[:3]).max() < 1.1e-8 < 1e-6 < np.linalg.eigvalsh(covariances[3]).max()


@pytest.mark.parametrize("method", ["adapt_regress", "time_steps"])
def test_a_constraint_moves_with_the_world(method: str) -> None:
    world, times = random_world(7, np.random.default_rng(0)), np.linspace(0.0, DURATION, 20)
    course = course_of(method, "object at 1, start at 0.3")
    course.situate(SITUATION)
    means, covariances, _ = course.at(times)
    course.situate(moved(world, SITUATION))
    there, wider, _ = course.at(times)
    turn = POSE.tangent_map(world.A)
    np.testing.assert_allclose(POSE.log(means @ world.A.T + world.b, there), 0.0, atol=1e-9)
    np.testing.assert_allclose(turn @ covariances @ turn.T, wider, rtol=1e-6, atol=1e-13)


def test_a_frame_that_is_not_known_binds_nothing() -> None:
    free, bound = course_of("time_steps", None), course_of("time_steps")
    for course in (free, bound):
        course.situate({"start": SITUATION["start"]})
    np.testing.assert_array_equal(free.at(np.array([DURATION]))[0], bound.at(np.array([DURATION]))[0])
    bound.situate(SITUATION, weights={"object": 0.0})
    free.situate(SITUATION, weights={"object": 0.0})
    np.testing.assert_array_equal(free.at(np.array([DURATION]))[0], bound.at(np.array([DURATION]))[0])


def test_a_loop_ends_exactly_and_without_a_jump_though_the_object_moves(tmp_path: Path) -> None:
    learned("promp").save(tmp_path / "model.tpgmm")
    model = load_model(tmp_path / "model.tpgmm")
    assert constraints_of(model) == (Constraint("object", 1.0),)
    retrieval, path = make_retrieval(model), []
    late = frames_at(start=place(0.02, -0.03, 0.2), object=place(0.9, 0.3, -0.9))
    retrieval.start(0, HAND)
    for i in range(1, 500):
        path.append(retrieval.step(i * 10_000_000, SITUATION if i < 180 else late, HAND).gaussian.mean)
    assert np.linalg.norm(np.diff(path, axis=0)[:, :3], axis=1).max() < 0.03
    free = course_of("promp", None)
    free.situate({"object": late["object"]})
    np.testing.assert_allclose(POSE.log(free.at(np.array([DURATION]))[0][0], path[-1]), 0.0, atol=1e-4)
    shown = reaching_demonstrations(8)[0]
    assert np.abs(POSE.log(reproduce(model, shown)[-1], shown.data[-1, 1:])).max() < 0.01


@pytest.mark.parametrize(
    ("text", "complaint"),
    [
        ("object", "expected frames and phases, such as 'target at 1"),
        ("object at 2", "the phase of a constraint is 0 to 1"),
        ("object at soon", "could not convert"),
        ("object at 1, start at 1", "two constraints have the same phase"),
        (5, "expected frames and phases"),
    ],
)
def test_a_text_that_says_no_constraints_is_refused(text: object, complaint: str) -> None:
    with pytest.raises(ValueError, match=complaint):
        parsed(text)


def test_what_cannot_be_met_is_refused_with_the_reason() -> None:
    with pytest.raises(ValueError, match="dmp cannot meet constraints exactly .*choose a function of time, adapt"):
        learned("dmp")
    with pytest.raises(ValueError, match="exact names moon; the model has the frames start, object"):
        learned("time_steps", "moon at 1")
    with pytest.raises(ValueError, match="exact names frame 'moon'"):
        Constrained(course_of("time_steps", None), [Constraint("moon", 1.0)])
    with pytest.raises(ValueError, match="has 7 numbers, the constraint has 2"):
        Constrained(course_of("time_steps", None), [Constraint("object", 1.0, (0.0, 1.0))])
