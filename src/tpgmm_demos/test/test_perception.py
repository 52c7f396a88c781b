# SPDX-License-Identifier: Apache-2.0
"""The simulated camera: its beat, its delay, its noise, and that a seed repeats it."""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np
import pytest

from tpgmm_core.geometry.manifold import POSE
from tpgmm_demos.scene.perception import CameraConfig, Sighting, SimulatedCamera, perception

MS = 1_000_000
PLACE = np.array([0.6, 0.3, 0.1, 0.0, 0.0, math.sin(0.4), math.cos(0.4)])


def watch(
    camera: SimulatedCamera, seconds: float, tick_ms: int = 10, begin_ms: int = 1000
) -> Iterator[tuple[int, Sighting]]:
    """Each sighting with the time at which it was handed out, ns."""
    for time_ms in range(begin_ms, begin_ms + round(1000 * seconds), tick_ms):
        sighting = camera.look(time_ms * MS, {"object": PLACE})
        if sighting is not None:
            yield time_ms * MS, sighting


def test_it_sees_as_often_as_its_rate_says_and_hands_out_as_late_as_its_delay_says() -> None:
    seen = list(watch(SimulatedCamera(CameraConfig(), seed=1), 100.0, tick_ms=1))
    stamps = np.array([sighting.stamp_ns for _, sighting in seen])
    assert len(seen) == pytest.approx(3000, abs=2)
    assert {time_ns - sighting.stamp_ns for time_ns, sighting in seen} == {30 * MS}
    beats = 970 * MS + np.arange(len(stamps)) * 1e9 / 30.0
    off = stamps - beats
    assert np.all(np.abs(off) <= 5 * MS) and np.std(off) > 1 * MS, "jitter about the beat, which is kept for ever"


@pytest.mark.parametrize("tick_ms", [2, 10, 20, 25])
def test_slow_ticks_neither_lose_nor_double_images_as_long_as_they_are_faster_than_it(tick_ms: int) -> None:
    seen = list(watch(SimulatedCamera(CameraConfig(), seed=1), 30.0, tick_ms))
    stamps = [sighting.stamp_ns for _, sighting in seen]
    assert len(set(stamps)) == len(stamps) == pytest.approx(900, abs=20)
    for time_ns, sighting in seen:
        assert 30 * MS <= time_ns - sighting.stamp_ns < (30 + tick_ms) * MS


def test_noise_has_the_spread_that_is_asked_for_and_no_bias() -> None:
    seen = [sighting.poses["object"] for _, sighting in watch(SimulatedCamera(CameraConfig(), seed=2), 200.0)]
    errors = np.array([POSE.log(PLACE, pose) for pose in seen])
    spread = np.repeat([0.001, math.radians(0.5)], 3)
    assert np.std(errors, axis=0) == pytest.approx(spread, rel=0.06)
    assert np.all(np.abs(np.mean(errors, axis=0)) < 4.0 * spread / np.sqrt(len(errors)))
    assert abs(np.corrcoef(errors[:-1, 0], errors[1:, 0])[0, 1]) < 0.06, "no image knows of the one before"
    assert np.linalg.norm(np.array(seen)[:, 3:], axis=1) == pytest.approx(1.0)


def test_a_seed_repeats_what_is_seen_bit_by_bit_and_another_one_does_not() -> None:
    first, again, other = (list(watch(SimulatedCamera(CameraConfig(), seed), 2.0)) for seed in (3, 3, 4))
    assert [time for time, _ in first] == [time for time, _ in again]
    for (_, one), (_, two) in zip(first, again, strict=True):
        assert one.stamp_ns == two.stamp_ns and one.poses["object"].tobytes() == two.poses["object"].tobytes()
    assert any(
        one.poses["object"].tobytes() != two.poses["object"].tobytes()
        for (_, one), (_, two) in zip(first, other, strict=False)
    )


def test_exact_perception_sees_at_every_third_tick_at_once_and_without_an_error() -> None:
    seen = list(watch(SimulatedCamera(perception("exact", 100.0 / 3.0)), 10.0))
    assert [time_ns for time_ns, _ in seen] == [(1000 + 30 * i) * MS for i in range(334)]
    for time_ns, sighting in seen:
        assert sighting.stamp_ns == time_ns and np.array_equal(sighting.poses["object"], PLACE)


def test_what_was_out_of_sight_when_the_image_was_taken_is_not_in_it_and_what_was_in_sight_is() -> None:
    camera = SimulatedCamera(CameraConfig(jitter=0.0), seed=1)
    camera.look(1000 * MS, {"object": PLACE})
    assert camera.look(1010 * MS, {"object": PLACE}) is None  # an image is taken
    sighting = camera.look(1040 * MS, {})  # it has gone since
    assert sighting is not None and sighting.stamp_ns == 1010 * MS and set(sighting.poses) == {"object"}
    late = camera.look(1070 * MS, {"object": PLACE})
    assert late is not None and late.stamp_ns == 1040 * MS and late.poses == {}


def test_it_was_running_before_anybody_asked_so_that_what_lies_there_is_known_from_the_first_moment_on() -> None:
    sighting = SimulatedCamera(CameraConfig(), seed=1).look(1000 * MS, {"object": PLACE})
    assert sighting is not None and sighting.stamp_ns == 970 * MS and set(sighting.poses) == {"object"}


def test_after_a_long_silence_it_goes_on_with_one_image_and_its_beat() -> None:
    camera = SimulatedCamera(CameraConfig(delay=0.0, jitter=0.0), seed=1)
    assert camera.look(0, {"object": PLACE}) is not None
    stamps = [s.stamp_ns for _, s in watch(camera, 1.0, tick_ms=1, begin_ms=60_000)]
    assert len(stamps) == 30 or len(stamps) == 31
    assert np.diff(stamps).min() >= 33 * MS


def test_when_time_begins_again_so_does_it() -> None:
    camera = SimulatedCamera(CameraConfig(), seed=1)
    assert len(list(watch(camera, 2.0, begin_ms=50_000))) > 50
    assert len(list(watch(camera, 2.0, begin_ms=1000))) > 50


@pytest.mark.parametrize(
    "setting", [{"rate": 0.0}, {"delay": -0.1}, {"position_noise": math.nan}, {"jitter": math.inf}]
)
def test_settings_out_of_their_range_are_refused_by_name(setting: dict[str, float]) -> None:
    with pytest.raises(ValueError, match=next(iter(setting))):
        CameraConfig(**setting)


def test_an_unknown_kind_is_refused_with_the_known_ones() -> None:
    with pytest.raises(ValueError, match="'perfect'.*camera, exact"):
        perception("perfect", 30.0)
