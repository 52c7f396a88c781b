# SPDX-License-Identifier: Apache-2.0
"""Doubts about values, and about demonstrations beside the others: found where they are, and nowhere else."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from tpgmm_core.doubt.doubts import Doubt, RawDemonstration
from tpgmm_core.doubt.ends import doubts_of_ends
from tpgmm_core.doubt.judging import judged
from tpgmm_core.doubt.values import doubts_of_joint_units
from tpgmm_core.geometry import quaternion
from tpgmm_core.geometry.pose import compose, inverse


def smooth(share: np.ndarray) -> np.ndarray:
    return share**3 * (10.0 - 15.0 * share + 6.0 * share**2)


def yaw(angle: object) -> np.ndarray:
    return quaternion.exp(np.asarray(angle)[..., None] * np.array([0.0, 0.0, 1.0]))


def shown(
    seed: int, samples: int = 80, duration: float = 4.0, turn: float = 0.0, noise: float = 5e-4
) -> RawDemonstration:
    """A hand goes to an object that stands elsewhere each time, and turns by some angle on the way."""
    random = np.random.default_rng(seed)
    times = np.linspace(0.0, duration * random.uniform(0.8, 1.2), samples)
    share = smooth(times / times[-1])
    place = np.array([0.6, 0.0, 0.1, *yaw(random.uniform(-0.8, 0.8))])
    place[:2] += random.uniform(-0.2, 0.2, 2)
    begin, end = np.array([0.4, 0.3, 0.5]), place[:3] + [0.0, 0.0, 0.1]
    positions = begin + share[:, None] * (end - begin) + noise * random.normal(size=(samples, 3))
    turned = quaternion.multiply(place[3:], yaw(turn * share))
    frames = {"object": np.tile(place, (samples, 1))}
    return RawDemonstration(
        f"demo_{seed}", times, np.hstack([positions, turned]), frames, {"object": np.ones(samples, bool)}
    )


def scaled(one: RawDemonstration, hand: float, place: float) -> RawDemonstration:
    movement, frames = one.movement.copy(), {name: poses.copy() for name, poses in one.frames.items()}
    movement[:, :3] *= hand
    for poses in frames.values():
        poses[:, :3] *= place
    return replace(one, movement=movement, frames=frames)


def group(count: int = 6, **settings: float) -> list[RawDemonstration]:
    return [shown(seed, **settings) for seed in range(count)]  # type: ignore[arg-type]


def kinds(doubts: list[Doubt]) -> set[tuple[str, tuple[str, ...], bool]]:
    return {(doubt.kind, doubt.about, doubt.refuses) for doubt in doubts}


def test_joints_in_degrees_are_named_and_rad_are_not() -> None:
    rad = np.linspace([0.0, -1.0], [3.0, 1.5], 40)
    assert not doubts_of_joint_units(["shoulder", "elbow"], rad)
    (doubt,) = doubts_of_joint_units(["shoulder", "elbow"], np.degrees(rad))
    assert doubt.kind == "units" and not doubt.refuses
    assert "the joint shoulder is 171.9 from its zero, which in rad is 27 turns" in doubt.text


@pytest.mark.parametrize("samples", [12, 80, 4000])
@pytest.mark.parametrize("turn", [0.0, 3.5, 6.1])
def test_good_demonstrations_raise_no_doubt(samples: int, turn: float) -> None:
    assert not judged(group(samples=samples, turn=turn))
    assert not judged(group(1)) and not judged(group(2))


def test_demonstrations_far_from_the_origin_raise_no_doubt() -> None:
    far = np.array([448262.0, 4427757.0, 650.0, *quaternion.IDENTITY])
    moved = [
        replace(one, movement=compose(far, one.movement), frames={n: compose(far, p) for n, p in one.frames.items()})
        for one in group()
    ]
    assert not judged(moved)


def test_millimetres_everywhere_are_said() -> None:
    for factor in (1000.0, 100.0):
        (doubt,) = judged([scaled(one, factor, factor) for one in group()])
        assert (doubt.kind, doubt.about, doubt.refuses) == ("units", (), False) and "millimetres" in doubt.text


@pytest.mark.parametrize(("hand", "place"), [(1000.0, 1.0), (1.0, 1000.0), (100.0, 1.0)])
def test_a_topic_in_another_unit_is_refused(hand: float, place: float) -> None:
    assert kinds(judged([scaled(one, hand, place) for one in group()])) == {("units", (), True)}
    mixed = [scaled(one, hand, place) if i == 2 else one for i, one in enumerate(group())]
    found = judged(mixed)
    assert all(doubt.refuses and doubt.about == ("demo_2",) for doubt in found) and found


@pytest.mark.parametrize("count", [2, 5])
@pytest.mark.parametrize("factor", [1000.0, 100.0])
def test_a_recording_in_another_unit_is_named(count: int, factor: float) -> None:
    mixed = [scaled(one, factor, factor) if i == 1 else one for i, one in enumerate(group(count))]
    assert kinds(judged(mixed)) == {("units", ("demo_1",), True)}


def test_a_frame_that_moves_and_comes_late_is_no_matter_of_units() -> None:
    several = group()
    visible = several[0].visible["object"].copy()
    visible[:30] = False
    frames = {"object": np.where(visible[:, None], several[0].frames["object"], 1e9)}
    several[0] = replace(several[0], frames=frames, visible={"object": visible})
    assert not [doubt for doubt in judged(several) if doubt.kind == "units"]


def test_leaps_are_named_with_when_and_how_far() -> None:
    several = group(noise=2e-3)
    movement = several[3].movement.copy()
    movement[40:45, :3] += [0.0, 0.3, 0.0]
    several[3] = replace(several[3], movement=movement)
    doubt = next(doubt for doubt in judged(several) if doubt.kind == "speed")
    assert (
        doubt.about == ("demo_3",) and f"{several[3].times[39]:.2f} s" in doubt.text and "moves by 0.29" in doubt.text
    )


def test_turns_that_flip_are_named() -> None:
    several = group()
    movement = several[1].movement.copy()
    movement[::5, 3:] = quaternion.multiply(movement[::5, 3:], yaw(np.pi))
    several[1] = replace(several[1], movement=movement)
    assert ("speed", ("demo_1",), False) in kinds(judged(several))


@pytest.mark.parametrize("step", [0.1, 0.02])
def test_positions_that_are_rounded_are_called_so(step: float) -> None:
    """They leap, and stand still in between: neither of these is the reason."""
    several = group(samples=400)
    movement = several[2].movement.copy()
    movement[:, :3] = step * np.round(movement[:, :3] / step)
    several[2] = replace(several[2], movement=movement)
    found = [doubt for doubt in judged(several) if doubt.about == ("demo_2",)]
    assert [doubt.kind for doubt in found] == ["speed"] and f"in steps of {step:.3g} m" in found[0].text


def test_a_hand_that_stands_still_is_named() -> None:
    several = group()
    several[0] = replace(several[0], movement=np.tile(several[0].movement[0], (80, 1)))
    assert ("still", ("demo_0",), False) in kinds(judged(several))


@pytest.mark.parametrize("factor", [0.2, 4.0])
def test_durations_that_differ_by_factors_are_named(factor: float) -> None:
    several = group()
    several[4] = replace(several[4], times=several[4].times * factor)
    assert kinds(judged(several)) == {("duration", ("demo_4",), False)}


def test_half_a_movement_is_named() -> None:
    several = group()
    half = slice(0, 30)
    one = several[2]
    frames = {"object": one.frames["object"][half]}
    several[2] = RawDemonstration(one.name, one.times[half], one.movement[half], frames, {"object": np.ones(30, bool)})
    assert ("misfit", ("demo_2",), False) in kinds(judged(several))


def test_a_copy_is_named_with_its_original() -> None:
    several = [*group(), replace(shown(2), name="again")]
    assert kinds(judged(several)) == {("copy", ("demo_2", "again"), False)}


@pytest.mark.parametrize("count", [3, 4, 6, 70])
@pytest.mark.parametrize("turn", [170.0, 200.0])
def test_one_that_turns_the_other_way_round_is_named(count: int, turn: float) -> None:
    """It ends as the others do: by 170 degrees one way, 190 the other way."""
    several = group(count, turn=np.radians(turn))
    several[1] = shown(1, turn=np.radians(turn - 360.0))
    (doubt,) = judged(several)
    assert doubt.kind == "misfit" and doubt.about == ("demo_1",)
    assert f"it turns by {360 - turn:.0f} deg in the opposite direction to the others ({turn:.0f} deg)" in doubt.text
    assert " deg (at " in doubt.text and " s it is " in doubt.text


def test_one_that_goes_elsewhere_is_named_with_when() -> None:
    several = group()
    movement = several[5].movement.copy()
    share = several[5].times / several[5].times[-1]
    movement[:, 2] += 0.35 * np.sin(np.pi * np.clip((share - 0.4) / 0.4, 0.0, 1.0)) ** 2
    several[5] = replace(several[5], movement=movement)
    (doubt,) = judged(several)
    assert doubt.kind == "misfit" and doubt.about == ("demo_5",) and " s it is 0.3" in doubt.text
    begin = float(doubt.text.split("from ")[1].split(" to ")[0])
    assert 0.4 < begin / several[5].duration < 0.7


def test_a_recording_whose_axes_are_left_handed_is_named_unless_the_start_is_a_frame() -> None:
    several = group()
    mirror = np.array([1.0, -1.0, 1.0, -1.0, 1.0, -1.0, 1.0])
    frames = {name: poses * mirror for name, poses in several[2].frames.items()}
    several[2] = replace(several[2], movement=several[2].movement * mirror, frames=frames)
    (doubt,) = judged(several)
    assert doubt.kind == "misfit" and doubt.about == ("demo_2",) and "from 0.00 to" in doubt.text
    assert not judged([replace(one, from_start=True) for one in several])


def test_a_pause_with_a_slow_movement_in_it_is_no_leap() -> None:
    several = group()
    kept = np.r_[0:30, 41:80]
    several[2] = replace(
        several[2],
        times=several[2].times[kept],
        movement=several[2].movement[kept],
        frames={},
        visible={},
    )
    assert not [doubt for doubt in judged(several) if doubt.kind == "speed"]


def test_two_publishers_by_turns_on_one_topic_are_said() -> None:
    several = group()
    movement = several[1].movement.copy()
    movement[::2, 1] += 0.02
    several[1] = replace(several[1], movement=movement)
    (doubt,) = [doubt for doubt in judged(several) if "two programs publish" in doubt.text]
    assert doubt.about == ("demo_1",)


@pytest.mark.parametrize("count", [6, 12])
def test_half_of_the_demonstrations_otherwise_are_said(count: int) -> None:
    """Half of them mirrored, or with w first: each half agrees in itself, so that no single one is odd."""
    several = group(count)
    w_first, mirrored = several.copy(), several.copy()
    for k in range(1, count, 2):
        w_first[k] = replace(w_first[k], movement=w_first[k].movement[:, [0, 1, 2, 6, 3, 4, 5]])
        mirrored[k] = replace(mirrored[k], movement=mirrored[k].movement * [1, -1, 1, -1, 1, -1, 1])
    odd = tuple(f"demo_{k}" for k in range(1, count, 2))
    assert ("order", odd, False) in kinds(judged(w_first))
    (doubt,) = [doubt for doubt in judged(mirrored) if doubt.about == odd]
    assert doubt.kind == "misfit" and f"{len(odd)} of {count} demonstrations agree among themselves" in doubt.text
    assert " m or more from all others, at 0 % of the time" in doubt.text and not doubt.refuses


def test_movements_from_two_places_are_one_group_where_the_start_is_a_frame() -> None:
    several = [replace(one, frames={}, visible={}) for one in group()]
    for k in (1, 3, 5):
        several[k] = replace(several[k], movement=several[0].movement + [0.0, 0.6, 0.0, 0.0, 0.0, 0.0, 0.0])
    for k in (0, 2, 4):
        several[k] = replace(several[k], movement=several[0].movement + [0.001 * k, *np.zeros(6)])
    assert [doubt.kind for doubt in judged(several)].count("misfit") == 1
    assert not [doubt for doubt in judged([replace(one, from_start=True) for one in several]) if doubt.kind == "misfit"]


def test_a_movement_whose_end_cannot_be_used_is_said() -> None:
    times, good = np.arange(100, dtype=np.int64) * 50_000_000, np.ones(100, bool)
    assert not doubts_of_ends("hand", times, good)
    good[5:8] = good[95:] = False
    assert not doubts_of_ends("hand", times, good)
    good[80:] = False
    (doubt,) = doubts_of_ends("hand", times, good)
    assert doubt.kind == "gap" and "the last 1.00 s of hand cannot be used" in doubt.text


def seen_from(several: list[RawDemonstration], change: Callable[[np.ndarray], np.ndarray]) -> list[RawDemonstration]:
    return [replace(one, frames={"object": change(one.frames["object"])}) for one in several]


def test_inverted_poses_of_a_frame_are_suspected() -> None:
    (doubt,) = [doubt for doubt in judged(seen_from(group(), inverse)) if doubt.kind == "order"]
    assert "the frame object: its poses are inverted, it seems" in doubt.text
    (doubt,) = [d for d in judged(seen_from(group(), lambda p: p * [1, 1, 1, -1, -1, -1, 1])) if d.kind == "order"]
    assert "the frame object: its quaternions are conjugated, it seems" in doubt.text


def test_a_frame_that_is_on_the_hand_all_the_time_is_said() -> None:
    several = group()
    for k, one in enumerate(several):
        held = one.movement[np.arange(80) // 3 * 3]  # seen at a third of the rate
        several[k] = replace(one, frames={"object": compose(held, np.array([0.0, 0.0, 0.05, 0.0, 0.0, 0.0, 1.0]))})
    (doubt,) = [doubt for doubt in judged(several) if doubt.kind == "still"]
    assert "the frame object moves with the hand, all the time" in doubt.text
    carried = one.movement.copy()
    carried[:40] = one.movement[40]
    several[0] = replace(several[0], frames={"object": carried})
    assert not [doubt for doubt in judged(several) if doubt.kind == "still"]


def test_frames_that_change_places_are_said() -> None:
    one = shown(0)
    here, there = one.frames["object"], one.frames["object"] + [0.3, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0]
    after = (one.times > 2.0)[:, None]
    both = {"a": np.where(after, there, here), "b": np.where(after, here, there)}
    (doubt,) = judged([replace(one, frames=both, visible={})])
    assert "the frames a and b change places at 2.0" in doubt.text and not doubt.refuses
    assert not judged([replace(one, frames={"a": np.where(after, there, here), "b": there}, visible={})])


def test_rests_that_differ_are_said() -> None:
    several = group(noise=0.0)
    one = several[2]
    rest = np.tile(one.movement[:1], (100, 1))
    times = np.append(np.arange(100) * 0.05, one.times + 5.0)
    frames = {"object": np.tile(one.frames["object"][:1], (180, 1))}
    several[2] = replace(one, times=times, movement=np.vstack([rest, one.movement]), frames=frames, visible={})
    (doubt,) = [doubt for doubt in judged(several) if doubt.kind == "duration"]
    assert doubt.about == ("demo_2",) and "s before it moves" in doubt.text and "still: 1.0" in doubt.text


def test_a_hand_whose_publisher_stops_in_the_middle_of_the_movement_is_said() -> None:
    one = shown(0)
    movement = one.movement.copy()
    movement[40:] = movement[40]
    assert "has the same pose in the next 39 messages" in judged([replace(one, movement=movement)])[0].text
    rests = np.vstack([one.movement, np.tile(one.movement[-1:], (60, 1))])
    at = np.append(one.times, one.times[-1] + 0.05 * np.arange(1, 61))
    assert not judged([replace(one, times=at, movement=rests, frames={}, visible={})])
