# SPDX-License-Identifier: Apache-2.0
"""The models that Section 2 of the paper sets itself apart from: each does what it is meant to, and no more."""

from __future__ import annotations

import numpy as np
import pytest

from random_problems import POSE
from reaching import demonstrate, place, reaching_demonstrations
from tpgmm_core import TPGMM, Demonstration, Frame
from tpgmm_core.choice.baselines import BASELINES, Learner, TaskParameters, parametric, per_demonstration, per_frame
from tpgmm_core.choice.reproducing import reproduce
from tpgmm_core.common.types import Array
from tpgmm_core.geometry.manifold import Manifold
from tpgmm_core.model.derived_frames import with_frames

SPACE = Manifold.parse("R1 x R3 x S3")
LEARNER = Learner(SPACE, 4, 1e-5)
SHOWN = reaching_demonstrations(8)


def rmse(path: Array, shown: Demonstration) -> float:
    return float(np.sqrt(np.mean(np.sum((path[:, :3] - shown.data[:, 1:4]) ** 2, axis=1))))


def test_one_model_per_demonstration_says_in_its_situation_what_was_shown_there() -> None:
    predict = per_demonstration(SHOWN, Learner(SPACE, 8, 1e-6))
    others = [rmse(predict(SHOWN[0]), other) for other in SHOWN[1:]]
    assert rmse(predict(SHOWN[0]), SHOWN[0]) < 0.5 * min(others)
    far = per_demonstration([SHOWN[0], SHOWN[0], SHOWN[1]], LEARNER)  # the width is 0: the nearest one alone
    np.testing.assert_allclose(far(SHOWN[1]), per_demonstration([SHOWN[1], SHOWN[1]], LEARNER)(SHOWN[1]), atol=1e-9)


def test_one_model_per_frame_is_for_one_frame_the_task_parameterized_model() -> None:
    alone = [with_frames(demonstration, ("object",)) for demonstration in SHOWN]
    model = TPGMM(4, reg_covar=1e-5, manifold=SPACE).fit(alone)
    model.metadata_ = {"duration_s": 2.0}
    path = per_frame(alone, LEARNER)(alone[0])
    np.testing.assert_allclose(POSE.log(reproduce(model, alone[0]), path), 0.0, atol=1e-9)


def test_one_model_per_frame_leaves_out_what_is_not_seen() -> None:
    hidden = Demonstration(
        SHOWN[0].times, SHOWN[0].data, SHOWN[0].frames, {"object": SHOWN[0].times < 1.0, "start": SHOWN[0].times < 1.5}
    )
    predict = per_frame(SHOWN, LEARNER)
    path = predict(hidden)
    whole, start = predict(SHOWN[0]), predict(with_frames(SHOWN[0], ("start",)))
    early, late, never = hidden.times < 1.0, (hidden.times >= 1.0) & (hidden.times < 1.5), hidden.times >= 1.5
    np.testing.assert_allclose(path[early], whole[early], atol=1e-12)
    np.testing.assert_allclose(path[late], start[late], atol=1e-12)
    np.testing.assert_array_equal(path[never], np.tile(path[late][-1], (never.sum(), 1)))


def linear(goal: float) -> Demonstration:
    """A line from 0 to a goal, which is the origin of a frame: affine in the task parameter at each time."""
    times = np.linspace(0.0, 1.0, 40)
    frames = {"goal": Frame(np.eye(1), [goal]).with_time()}
    return Demonstration(times, np.column_stack([times, goal * times]), frames)


def test_a_parametric_model_is_affine_in_the_task_parameters() -> None:
    shown = [linear(goal) for goal in (0.5, 0.8, 1.0, 1.3, 1.5, 2.0)]
    predict = parametric(shown, Learner(Manifold.parse("R1 x R1"), 1, 1e-9))
    np.testing.assert_allclose(TaskParameters(shown, Manifold.parse("R1")).shown.std(axis=0), 1.0)
    ends = np.array([predict(linear(goal))[-1, 0] for goal in (0.7, 1.1, 1.5, 1.9)])
    np.testing.assert_allclose(np.diff(ends), ends[1] - ends[0], rtol=1e-6)
    several = parametric(shown, Learner(Manifold.parse("R1 x R1"), 4, 1e-9))
    for goal in (0.6, 1.2, 1.8):
        assert abs(several(linear(goal))[-1, 0] - goal) < 0.1


@pytest.mark.parametrize("name", BASELINES)
def test_where_nothing_like_it_was_shown_frames_lead_farther_than_any_of_them(name: str) -> None:
    """The paper's reason: both frames far away, and turned by 2 rad."""
    world = Frame.from_pose([3.0, -2.0, 0.5], [0.0, 0.0, np.sin(1.0), np.cos(1.0)])

    def moved(pose: Array) -> Array:
        return world.A @ pose + world.b

    start, goal = moved(place(0.05, 0.02, 0.1)), moved(place(0.55, -0.05, 0.3))
    there = demonstrate(start, goal, np.random.default_rng(5))
    model = TPGMM(4, reg_covar=1e-5, manifold=SPACE).fit(SHOWN)
    model.metadata_ = {"duration_s": 2.0}
    ours, theirs = rmse(reproduce(model, there), there), rmse(BASELINES[name](SHOWN, LEARNER)(there), there)
    assert ours < 0.05
    if name == "P models, product":
        assert theirs < 0.1  # frames too; what is lost is which components belong together
    else:
        assert theirs > 0.5
