# SPDX-License-Identifier: Apache-2.0
"""Which skill is shown: by its beginning, with frames missing, and when it is none; where the hand goes; segments."""

from __future__ import annotations

import time
from collections.abc import Mapping

import numpy as np
import pytest
from scipy.stats import multivariate_normal

from drawings import SAMPLES, SHAPES, drawn, skills, stretched
from reaching import demonstrate, frames_at, place, reaching_demonstrations
from tpgmm_core import TPGMM, Demonstration, Frame
from tpgmm_core.common.types import Array
from tpgmm_core.geometry import quaternion
from tpgmm_core.geometry.manifold import Manifold
from tpgmm_core.recognition.recognizer import UNKNOWN, Recognition, RecognitionConfig, Recognizer
from tpgmm_core.recognition.segmentation import Segment, segment
from tpgmm_core.recognition.skill import Skill, SkillFilter
from tpgmm_core.retrieval.recipe import Recipe
from worlds import moved, planar_frame, random_world


def watch(
    recognizer: Recognizer,
    shown: Demonstration,
    share: float = 1.0,
    known: Mapping[str, Frame] | None = None,
) -> list[Recognition]:
    """What is known after each sample of a share of a movement."""
    recognizer.start()
    n = max(1, round(share * len(shown.times)))
    frames = shown.frames if known is None else known
    return [
        recognizer.step(round(1e9 * t), x, frames) for t, x in zip(shown.times[:n], shown.data[:n, 1:], strict=True)
    ]


def confusion(recognizer: Recognizer, share: float, names: tuple[str, ...] = ("start", "goal")) -> Array:
    """Counts (6, 7) of held-out drawings: rows are what was drawn, columns what was found, unknown at last."""
    rng = np.random.default_rng(100)
    counts = np.zeros((len(SHAPES), len(SHAPES) + 1), dtype=int)
    for i, shape in enumerate(SHAPES):
        for _ in range(5):
            shown = drawn(shape, rng)
            found = watch(recognizer, shown, share, {name: shown.frames[name] for name in names})[-1]
            counts[i, [*SHAPES, UNKNOWN].index(found.most_probable)] += 1
    return counts


def test_drawings_that_were_not_seen_are_told_apart_and_the_beginning_says_less() -> None:
    recognizer = Recognizer(skills())
    whole, half = confusion(recognizer, 1.0), confusion(recognizer, 0.5)
    assert np.trace(whole) >= 29, whole
    assert np.trace(half) >= 24, half


@pytest.mark.parametrize("name", ["start", "goal"])
def test_one_frame_is_enough(name: str) -> None:
    counts = confusion(Recognizer(skills()), 1.0, (name,))
    assert np.trace(counts) >= 25, counts


def test_probabilities_begin_with_the_prior_and_become_sure() -> None:
    priors = dict(zip(SHAPES, (1.0, 2.0, 1.0, 1.0, 4.0, 1.0), strict=True))
    weighed = [Skill(skill.name, skill.course, skill.scale, priors[skill.name]) for skill in skills()]
    recognizer = Recognizer(weighed, RecognitionConfig(unknown_prior=0.2))
    before = recognizer.recognition().probabilities
    assert before["loop"] == pytest.approx(0.8 * 0.4) and before[UNKNOWN] == pytest.approx(0.2)
    found = watch(recognizer, drawn("wave", np.random.default_rng(7)))
    sure = [one.probabilities["wave"] for one in found]
    assert sure[-1] > 0.95 and sure[0] < 0.5
    assert all(abs(sum(one.probabilities.values()) - 1.0) < 1e-9 for one in found)
    phases = np.array([one.phases["wave"] for one in found])
    np.testing.assert_allclose(phases[10:], np.linspace(0.0, 1.0, SAMPLES)[10:], atol=0.12)


def test_what_is_found_does_not_depend_on_how_often_the_hand_is_seen() -> None:
    shown = drawn("arc", np.random.default_rng(11), noise=0.0)
    recognizer, ends = Recognizer(skills()), []
    for n in (60, 240, 960):
        times = np.linspace(0.0, shown.times[-1], n)
        path = np.column_stack([np.interp(times, shown.times, x) for x in shown.data[:, 1:].T])
        data = Demonstration(times, np.column_stack([times, path]), shown.frames)
        recognizer.start()
        for t, x in zip(times[: n // 2], data.data[:, 1:], strict=False):
            recognizer.step(round(1e9 * t), x, shown.frames)
        ends.append(recognizer._log_posterior - recognizer._log_posterior[1])
    for odds in (ends[0], ends[1]):  # logarithms, against the right one
        assert (odds[[0, 2, 3, 4, 5, 6]] < -5.0).all()
        np.testing.assert_allclose(odds, ends[2], rtol=0.15, atol=1.0)


def test_after_a_pause_and_where_time_jumps_back_another_movement_begins() -> None:
    recognizer, rng = Recognizer(skills(), RecognitionConfig(pause=1.0)), np.random.default_rng(12)
    wave, line = drawn("wave", rng), drawn("line", rng)
    fresh = watch(recognizer, line, 0.3)
    for offset in (-20.0, 20.0):
        assert watch(recognizer, wave)[-1].most_probable == "wave"
        for t, x, first in zip(line.times, line.data[:, 1:], fresh, strict=False):
            found = recognizer.step(round(1e9 * (t + offset)), x, line.frames)
            assert found.probabilities == pytest.approx(first.probabilities, abs=1e-6)


def test_covariances_are_scaled_as_a_skill_says() -> None:
    frames = drawn("arc", np.random.default_rng(0)).frames
    plain, wide = (SkillFilter(Skill("arc", skills()[1].course, scale), 10, 1.0) for scale in (1.0, 4.0))
    for one in (plain, wide):
        one.situate(frames, np.zeros(2), None)
    np.testing.assert_allclose(wide.covariances, 4.0 * plain.covariances, rtol=1e-12)
    np.testing.assert_array_equal(wide.means, plain.means)
    point = plain.means[3] + [0.01, 0.02]
    difference = plain.log_densities(plain.means[3], 1.0)[3] - plain.log_densities(point, 1.0)[3]
    scaled = wide.log_densities(wide.means[3], 1.0)[3] - wide.log_densities(point, 1.0)[3]
    assert 4.0 * scaled == pytest.approx(difference)
    expected = multivariate_normal(plain.means[3], plain.covariances[3]).logpdf(point)
    assert plain.log_densities(point, 0.5)[3] == pytest.approx(0.5 * expected)


def test_moving_the_world_changes_nothing() -> None:
    shown, world = drawn("hook", np.random.default_rng(3)), random_world(2, np.random.default_rng(4))
    there = Demonstration(
        shown.times,
        np.column_stack([shown.times, shown.data[:, 1:] @ world.A.T + world.b]),
        moved(world, shown.frames),
    )
    recognizer = Recognizer(skills())
    for here, elsewhere in zip(watch(recognizer, shown), watch(recognizer, there), strict=True):
        np.testing.assert_allclose(list(here.probabilities.values()), list(elsewhere.probabilities.values()), atol=1e-6)


def test_what_is_none_of_the_skills_is_unknown() -> None:
    recognizer, rng, hits = Recognizer(skills()), np.random.default_rng(5), 0
    for _ in range(10):
        shown = drawn("line", rng)
        s = np.linspace(0.0, 1.0, SAMPLES)
        frame = shown.frames["start"]
        away = np.column_stack([0.5 * np.sin(5.0 * np.pi * s), -0.8 * s * (1.0 + rng.uniform())]) @ frame.A[1:, 1:].T
        strange = Demonstration(shown.times, np.column_stack([shown.times, frame.b[1:] + away]), shown.frames)
        hits += watch(recognizer, strange)[-1].most_probable == UNKNOWN
    assert hits == 10
    assert watch(Recognizer(skills(), RecognitionConfig(unknown_prior=0.0)), strange)[-1].probabilities[UNKNOWN] == 0.0


def test_a_skill_whose_frames_are_not_known_is_as_probable_as_before() -> None:
    both = [skills()[0], Skill("elsewhere", Skill.of_model("other", other_model()).course)]
    recognizer = Recognizer(both, RecognitionConfig(unknown_prior=0.2))
    shown = drawn("line", np.random.default_rng(8))
    found = watch(recognizer, shown)[-1].probabilities
    assert found["elsewhere"] == pytest.approx(0.4, abs=1e-9)
    assert found["line"] > 0.55 and recognizer.predict(0.1) is not None
    recognizer.start()
    blind = recognizer.step(0, [0.0, 0.0], {"nowhere": planar_frame(0.0, 0.0, 0.0).with_time()})
    assert blind.probabilities == pytest.approx({"line": 0.4, "elsewhere": 0.4, UNKNOWN: 0.2})
    assert recognizer.predict(0.1) is None


def other_model() -> TPGMM:
    rng = np.random.default_rng(1)
    shown = []
    for _ in range(3):
        one = stretched(drawn("arc", rng))
        shown.append(Demonstration(one.times, one.data, {"cup": one.frames["start"]}))
    return Recipe.of({"n_components": 4}).learn(shown, Manifold.parse("R1 x R2"))


def test_where_the_hand_goes_is_predicted_with_its_uncertainty() -> None:
    recognizer, rng = Recognizer(skills()), np.random.default_rng(21)
    squared, errors, spreads = [], [], []
    for shape in SHAPES:
        for _ in range(3):
            shown = drawn(shape, rng)
            watch(recognizer, shown, 0.6)
            n = round(0.6 * SAMPLES) - 1
            for ahead in (3, 6, 12):
                guess = recognizer.predict(float(shown.times[n + ahead] - shown.times[n]))
                assert guess is not None
                e = shown.data[n + ahead, 1:] - guess.mean
                squared.append(float(e @ np.linalg.solve(guess.covariance, e)))
                errors.append(np.linalg.norm(e))
                spreads.append(np.sqrt(np.trace(guess.covariance)))
            end = recognizer.predict(np.inf)
            assert end is not None
            length = np.linalg.norm(shown.frames["goal"].b - shown.frames["start"].b)
            assert np.linalg.norm(end.mean - shown.data[-1, 1:]) < 0.15 * length
    standing = [np.linalg.norm(shown.data[-1, 1:] - shown.data[n, 1:])]
    assert np.median(errors) < 0.15 and min(standing) > 0.3
    inside = float(np.mean(np.array(squared) < 5.99))  # of the 95 % region in two dimensions
    assert 0.8 <= inside <= 1.0, inside
    assert np.median(spreads) < 0.5


def test_a_recording_of_several_skills_is_taken_apart() -> None:
    rng = np.random.default_rng(31)
    order = ("wave", "line", "hook", "loop")
    parts = [drawn(shape, rng, 0.002) for shape in order]
    N = len(parts) * SAMPLES
    times = np.concatenate([part.times + 3.0 * i for i, part in enumerate(parts)])
    data = np.column_stack([times, np.concatenate([part.data[:, 1:] for part in parts])])
    frames = {
        name: Frame(
            np.concatenate([np.tile(part.frames[name].A, (SAMPLES, 1, 1)) for part in parts]),
            np.concatenate([np.tile(part.frames[name].b, (SAMPLES, 1)) for part in parts]),
        )
        for name in ("start", "goal")
    }
    found = segment(skills(), Demonstration(times, data, frames))
    assert [one.name for one in found] == list(order)
    assert found[0].first == 0 and found[-1].end == N
    assert all(a.end == b.first for a, b in zip(found, found[1:], strict=False))
    np.testing.assert_allclose([one.first for one in found], SAMPLES * np.arange(4), atol=5)


def test_in_a_recording_what_is_strange_is_unknown() -> None:
    rng = np.random.default_rng(33)
    first = drawn("arc", rng, 0.002)
    away = first.data[-1, 1:] + np.linspace(0.0, 3.0, SAMPLES)[:, None] * [1.0, -2.0]
    times = np.concatenate([first.times, first.times + 3.0])
    data = np.column_stack([times, np.concatenate([first.data[:, 1:], away])])
    found = segment(skills(), Demonstration(times, data, first.frames))
    assert [one.name for one in found] == ["arc", UNKNOWN]
    assert found[1] == Segment(UNKNOWN, found[0].end, 2 * SAMPLES) and abs(found[0].end - SAMPLES) <= 12


def pose_skills() -> list[Skill]:
    """Reaching as it is shown, and with the hand going back to where it started; poses, two frames."""
    recipe, there = Recipe.of({"n_components": 5, "reg_covar": 1e-4}), reaching_demonstrations(8)
    back = []
    for one in there:
        poses = one.data[::-1, 1:]
        back.append(Demonstration(one.times, np.column_stack([one.times, poses]), one.frames))
    space = "R1 x R3 x S3"
    return [Skill.of_model(name, recipe.learn(shown, space)) for name, shown in (("reach", there), ("return", back))]


def test_poses_are_recognised_whatever_the_signs_of_their_quaternions_in_less_than_a_millisecond() -> None:
    recognizer = Recognizer(pose_skills())
    start, goal = place(0.05, 0.05, 0.3), place(0.52, -0.06, -0.2)
    shown = demonstrate(start, goal, np.random.default_rng(3))
    plain = watch(recognizer, shown)
    flipped = shown.data.copy()
    flipped[::2, 4:] *= -1.0
    other = watch(
        recognizer, Demonstration(shown.times, flipped, frames_at(start=start, object=goal * [1, 1, 1, -1, -1, -1, -1]))
    )
    assert plain[-1].probabilities["reach"] > 0.95
    np.testing.assert_allclose(
        [one.probabilities["reach"] for one in plain], [one.probabilities["reach"] for one in other], atol=1e-6
    )
    end = recognizer.predict(np.inf)
    assert end is not None and end.manifold == Manifold.parse("R3 x S3")
    assert quaternion.angle_between(end.mean[3:], goal[3:]) < 0.1
    taken = []
    recognizer.start()
    for t, x in zip(shown.times, shown.data[:, 1:], strict=True):
        begin = time.process_time()
        recognizer.step(round(1e9 * t), x, shown.frames)
        taken.append(time.process_time() - begin)
    assert np.median(taken) < 1e-3


def test_what_makes_no_sense_is_refused_with_the_reason() -> None:
    with pytest.raises(ValueError, match="different names"):
        Recognizer([])
    with pytest.raises(ValueError, match="different names"):
        Recognizer([skills()[0], skills()[0]])
    with pytest.raises(ValueError, match="one manifold"):
        Recognizer([skills()[0], pose_skills()[0]])
    with pytest.raises(ValueError, match="prior of the skill 'line'"):
        Skill("line", skills()[0].course, prior=0.0)
    with pytest.raises(ValueError, match="memory"):
        RecognitionConfig(memory=0.0)
    recognizer = Recognizer(skills())
    with pytest.raises(ValueError, match="the point is finite"):
        recognizer.step(0, [np.nan, 0.0], drawn("line", np.random.default_rng(0)).frames)
    with pytest.raises(ValueError, match="from now on"):
        recognizer.predict(-1.0)
    model = Recipe.of({"n_components": 4}, "semi_markov").learn(
        [stretched(drawn("line", np.random.default_rng(i))) for i in range(3)], Manifold.parse("R1 x R2")
    )
    with pytest.raises(ValueError, match="does not know its movement as a function of time"):
        Skill.of_model("line", model)
