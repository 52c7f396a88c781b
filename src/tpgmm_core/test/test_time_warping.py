# SPDX-License-Identifier: Apache-2.0
"""Dynamic time warping in all frames at once: demonstrations of different paces get a time that they share."""

from __future__ import annotations

import numpy as np
import pytest

from tpgmm_core import Demonstration, Frame
from tpgmm_core.choice.reproducing import reproduce_gaussians
from tpgmm_core.geometry import quaternion
from tpgmm_core.geometry.manifold import Manifold
from tpgmm_core.learning.time_warping import KEY, on_common_time
from tpgmm_core.retrieval.methods import METHODS
from tpgmm_core.retrieval.recipe import Recipe

SPACE = Manifold.parse("R1 x R3 x S3")
DURATION = 4.0


def paced(share: np.ndarray, amount: float) -> np.ndarray:
    """Where somebody is who is early or late in the middle, by this share of the movement; as far as 0.15."""
    return np.asarray(share + amount * np.sin(np.pi * share) ** 2)


def shown(amount: float, place: np.ndarray, T: int = 150, phantom: np.ndarray | None = None) -> Demonstration:
    """From the base's origin over an arc to an object at a place, turning meanwhile; a phantom is anywhere."""
    times = np.linspace(0.0, DURATION, T)
    s = paced(times / DURATION, amount)
    path = s[:, None] * place + np.stack([0.0 * s, 0.1 * np.sin(2.0 * np.pi * s), 0.3 * np.sin(np.pi * s)], axis=1)
    turns = quaternion.exp(np.stack([0.0 * s, 0.0 * s, 1.2 * s], axis=1))
    frames = {"base": np.zeros(3), "object": place, **({} if phantom is None else {"phantom": phantom})}
    data = np.concatenate([times[:, None], path, turns], axis=1)
    identity = np.array([0.0, 0.0, 0.0, 1.0])
    return Demonstration(times, data, {name: Frame.from_pose(b, identity).with_time() for name, b in frames.items()})


def demonstrations(M: int = 6, phantom: bool = False) -> tuple[list[Demonstration], np.ndarray]:
    """With how early or late each of them is; nobody on the average."""
    rng = np.random.default_rng(3)
    amounts = np.linspace(-0.12, 0.12, M)
    places = np.array([0.6, 0.2, 0.0]) + rng.uniform(-0.1, 0.1, (M, 3))
    others = rng.uniform(-1.0, 1.0, (M, 3)) if phantom else [None] * M
    lengths = rng.integers(90, 300, M)
    parts = zip(amounts, places, lengths, others, strict=True)
    return [shown(amount, place, int(T), other) for amount, place, T, other in parts], amounts


@pytest.mark.parametrize("phantom", [False, True])
def test_demonstrations_of_different_paces_are_at_the_same_place_at_the_same_time_afterwards(phantom: bool) -> None:
    given, amounts = demonstrations(phantom=phantom)
    warped = on_common_time(given, SPACE)
    even = np.linspace(0.0, DURATION, 50)
    gone = [
        [
            np.interp(even, new.times, paced(old.times / DURATION, a))
            for new, old, a in zip(items, given, amounts, strict=True)
        ]
        for items in (given, warped)
    ]
    before, after = np.std(gone, axis=1).max(axis=1)
    assert after < 0.2 * before
    for one, other in zip(given, warped, strict=True):
        assert other.times[0] == one.times[0] and other.times[-1] == pytest.approx(one.times[-1])
        assert np.all(np.diff(other.times) > 0.0)
        np.testing.assert_allclose(other.data[:, 0], other.times)
        np.testing.assert_array_equal(other.data[:, 1:], one.data[:, 1:])
        assert other.frames.keys() == one.frames.keys()


def test_time_stays_on_the_average_and_one_demonstration_or_equal_ones_keep_theirs() -> None:
    given, _ = demonstrations()
    middle = [
        float(np.interp(0.5 * DURATION, one.times, new.times))
        for one, new in zip(given, on_common_time(given, SPACE), strict=True)
    ]
    assert np.mean(middle) == pytest.approx(0.5 * DURATION, abs=0.03)
    place = np.array([0.6, 0.2, 0.0])
    for same in ([shown(0.1, place)], [shown(0.1, place)] * 4):
        for one, new in zip(same, on_common_time(same, SPACE), strict=True):
            np.testing.assert_allclose(new.times, one.times, atol=1e-9)


def test_a_demonstration_of_one_sample_has_no_pace_and_stays_as_it_is() -> None:
    given, _ = demonstrations(3)
    alone = given[0].at(np.array([0]))
    kept = on_common_time([alone, *given[1:]], SPACE)[0]
    np.testing.assert_array_equal(kept.data, alone.data)
    np.testing.assert_array_equal(kept.times, alone.times)


def test_a_frame_that_was_hidden_does_not_decide_while_it_was() -> None:
    """What is held for a frame that is not seen may be anything."""
    given, _ = demonstrations(phantom=True)
    hidden = []
    for item in given:
        mask = np.linspace(0.0, 1.0, len(item.times)) < 0.3
        hidden.append(Demonstration(item.times, item.data, item.frames, {"phantom": mask}))
    without = [Demonstration(d.times, d.data, {k: f for k, f in d.frames.items() if k != "phantom"}) for d in given]
    for one, other in zip(on_common_time(hidden, SPACE), on_common_time(without, SPACE), strict=True):
        late = np.linspace(0.0, 1.0, len(one.times)) > 0.6
        np.testing.assert_allclose(one.times[late], other.times[late], atol=0.1)


@pytest.mark.parametrize("method", METHODS)
def test_different_paces_do_not_make_a_movement_uncertain_with_any_method(method: str) -> None:
    """At one time some are early and others late; in what they do they agree."""
    given, _ = demonstrations(8)
    deviations = []
    for value in (False, True):
        settings = {"retrieval": method, "n_components": 9, "reg_covar": 1e-6, KEY: value}
        model = Recipe.of(settings).learn(given, SPACE)
        assert (KEY in model.metadata_) == value and model.metadata_["duration_s"] == pytest.approx(DURATION)
        _, covariances = reproduce_gaussians(model, given[3])
        deviations.append(np.median(np.sqrt(np.linalg.eigvalsh(covariances[:, :3, :3])[:, -1])))
    assert deviations[1] < (0.9 if method == "dynamical_system" else 0.7) * deviations[0]


def test_where_not_all_demonstrations_are_there_at_once_it_is_refused() -> None:
    given, _ = demonstrations(2)
    with pytest.raises(ValueError, match="time_warping compares all demonstrations at once"):
        Recipe.of({KEY: True}).learn_parts([given], SPACE)
    with pytest.raises(ValueError, match="time_warping is true or false, got 'yes'"):
        Recipe.of({KEY: "yes"})
    assert not Recipe.of({KEY: True}, "periodic").time_warping
