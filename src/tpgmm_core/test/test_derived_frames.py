# SPDX-License-Identifier: Apache-2.0
"""Derived frames: what they are made of, what of a demonstration they show, and that a model's metadata keep them."""

from __future__ import annotations

import numpy as np
import pytest

from tpgmm_core import Demonstration, Frame
from tpgmm_core.geometry import quaternion
from tpgmm_core.model.derived_frames import BASE, HAND, KEY, DerivedFrames, FrameSource, with_frames

DERIVED = DerivedFrames(
    {
        "place": FrameSource("object", turned=False),
        "hand_start": FrameSource(HAND, turned=False),
        "grasp": FrameSource(HAND),
        "base": FrameSource(BASE),
    }
)
TURN = quaternion.normalize([0.1, 0.2, 0.3, 0.9])


def demonstration(T: int = 20) -> Demonstration:
    rng = np.random.default_rng(0)
    times = np.linspace(0.0, 1.0, T)
    data = np.column_stack([times, rng.normal(size=(T, 3)), quaternion.normalize(rng.normal(size=(T, 4)))])
    seen = {"object": times > 0.3}
    return Demonstration(times, data, {"object": Frame.from_pose([1.0, 2.0, 3.0], TURN).with_time()}, seen)


def test_each_sees_the_data_from_its_place() -> None:
    shown = demonstration()
    seen = DERIVED.extended(shown).projected()
    np.testing.assert_array_equal(seen["base"], shown.data)
    np.testing.assert_allclose(seen["place"], shown.data - [0, 1, 2, 3, 0, 0, 0, 0], atol=1e-14)
    np.testing.assert_allclose(seen["hand_start"][0, 1:], [0, 0, 0, *shown.data[0, 4:]], atol=1e-14)
    np.testing.assert_allclose(seen["grasp"][0, 1:], [0, 0, 0, 0, 0, 0, 1], atol=1e-14)
    np.testing.assert_array_equal(seen["grasp"][:, 0], shown.times)


def test_a_derived_frame_is_seen_when_its_source_is() -> None:
    shown = DERIVED.extended(demonstration())
    np.testing.assert_array_equal(shown.is_visible("place"), shown.is_visible("object"))
    assert shown.is_visible("hand_start").all() and shown.is_visible("base").all()
    assert DERIVED.weights({"object": 0.3}) == {"place": 0.3, "hand_start": 1.0, "grasp": 1.0, "base": 1.0}


def test_without_the_hand_or_the_object_only_the_others_are_known() -> None:
    shown = demonstration()
    assert set(DERIVED.frames(shown.frames)) == {"place", "base"}
    assert set(DERIVED.frames({}, shown.data[0, 1:])) == {"hand_start", "grasp", "base"}
    assert DERIVED.frames({}) == {}


def test_an_unturned_frame_that_only_turns_is_constant() -> None:
    turns = quaternion.normalize(np.random.default_rng(1).normal(size=(20, 4)))
    moving = Frame.from_pose(np.tile([1.0, 2.0, 3.0], (20, 1)), turns).with_time()
    place = DERIVED.frames({"object": moving})["place"]
    assert not place.is_time_varying
    np.testing.assert_array_equal(place.b, [0, 1, 2, 3, 0, 0, 0, 0])


def test_positions_alone_have_derived_frames_too() -> None:
    times = np.linspace(0.0, 1.0, 10)
    data = np.column_stack([times, np.random.default_rng(0).normal(size=(10, 3))])
    shown = DERIVED.extended(Demonstration(times, data, {"object": Frame(np.eye(4), np.arange(4.0))}))
    np.testing.assert_allclose(shown.projected()["grasp"][0], np.zeros(4), atol=1e-15)
    np.testing.assert_allclose(shown.projected()["place"][:, 1:], data[:, 1:] - [1.0, 2.0, 3.0])


def test_metadata_keep_them_and_a_model_without_any_is_as_before() -> None:
    assert DerivedFrames.of_metadata(DERIVED.metadata()) == DERIVED
    assert DerivedFrames.joined([DERIVED, DerivedFrames(), DERIVED]) == DERIVED
    other = DerivedFrames({next(iter(DERIVED.sources)): FrameSource("elsewhere")})
    with pytest.raises(ValueError, match="in one model, from 'elsewhere' in another: name them differently"):
        DerivedFrames.joined([DERIVED, other])
    assert DerivedFrames().metadata() == {} and DerivedFrames.of_metadata({}) == DerivedFrames()


@pytest.mark.parametrize("text", ["", "[]", "3", '{"a": 1}', '{"a": ["b"]}', '{"a": ["b", 1]}', "[" * 100_000])
def test_damaged_metadata_are_refused(text: str) -> None:
    with pytest.raises(ValueError, match="derived_frames.*train the model again"):
        DerivedFrames.of_metadata({KEY: text})


def test_what_has_to_be_observed_is_known() -> None:
    assert DERIVED.observed(["place", "object", "base", "grasp", "cup"]) == ("object", "cup")
    assert DERIVED.only(["base"]).observed(["base"]) == ()


def test_a_frame_that_is_missing_is_named() -> None:
    shown = with_frames(DerivedFrames({"base": FrameSource(BASE)}).extended(demonstration()), ["base"])
    with pytest.raises(ValueError, match="'place' is derived from 'object'; the demonstration has the frames base"):
        DERIVED.extended(shown)


def test_a_frame_is_not_derived_from_a_derived_one() -> None:
    with pytest.raises(ValueError, match="'b' is derived from 'a', which is derived too"):
        DerivedFrames({"a": FrameSource(BASE), "b": FrameSource("a")})
