# SPDX-License-Identifier: Apache-2.0
"""Transforms are composed at their times, interpolated between two of them, and never extrapolated."""

from __future__ import annotations

import numpy as np
import pytest

from tpgmm_core.geometry import quaternion
from tpgmm_core.geometry.pose import compose, inverse
from tpgmm_core.observation.transforms import TransformError, TransformTree, TransformWatch

RANDOM = np.random.default_rng(0)
MS = 1_000_000


def a_pose() -> np.ndarray:
    return np.concatenate([RANDOM.normal(size=3), quaternion.exp(RANDOM.normal(size=3))])


def assert_same(a: np.ndarray, b: np.ndarray) -> None:
    np.testing.assert_allclose(a[:3], b[:3], atol=1e-12)
    np.testing.assert_allclose(quaternion.angle_between(a[3:], b[3:]), 0.0, atol=1e-7)


def test_a_chain_goes_up_to_where_two_frames_meet_and_down_again() -> None:
    tree, camera, base, cup = TransformTree(), a_pose(), a_pose(), a_pose()
    tree.add("world", "/camera", camera, 0, is_static=True)
    tree.add("/world", "base", base, 0, is_static=True)
    tree.add("camera", "cup", cup, 5 * MS)
    assert tree.latest("cup", "base") == 5 * MS and tree.latest("camera", "base") is None
    assert_same(tree.pose("cup", "base", 5 * MS), compose(inverse(base), compose(camera, cup)))
    assert_same(tree.pose("camera", "base", None), compose(inverse(base), camera))
    assert_same(tree.pose("world", "/base", None), inverse(base))


def test_each_transform_of_a_chain_is_interpolated_to_the_same_time() -> None:
    tree = TransformTree()
    turn = quaternion.exp([0.0, 0.0, 1.0])
    for k in range(11):
        tree.add("base", "camera", [0.1 * k, 0, 0, 0, 0, 0, 1], 10 * k * MS)
    tree.add("camera", "cup", [0, 0, 0, 0, 0, 0, 1], 25 * MS)
    tree.add("camera", "cup", [0, 1, 0, *turn], 45 * MS)
    assert tree.latest("cup", "base") == 45 * MS
    assert_same(tree.pose("cup", "base", 35 * MS), np.array([0.35, 0.5, 0, *quaternion.exp([0.0, 0.0, 0.5])]))
    np.testing.assert_array_equal(tree.pose("camera", "base", 20 * MS), [0.2, 0, 0, 0, 0, 0, 1])


@pytest.mark.parametrize(
    ("at", "words", "may_come"), [(9, "0.001 s before its first", False), (21, "0.001 s after", True)]
)
def test_nothing_is_extrapolated(at: int, words: str, may_come: bool) -> None:
    tree = TransformTree()
    tree.add("base", "cup", a_pose(), 10 * MS)
    tree.add("base", "cup", a_pose(), 20 * MS)
    with pytest.raises(TransformError, match=words) as raised:
        tree.pose("cup", "base", at * MS)
    assert raised.value.may_come is may_come and "no transform at this time:" in str(raised.value)


def test_what_does_not_hang_together_is_said() -> None:
    tree = TransformTree()
    tree.add("base", "arm", a_pose(), 0)
    tree.add("camera", "cup", a_pose(), 0)
    with pytest.raises(
        TransformError, match="nothing connects 'base' to 'cup'; those that came are about arm, base, cam"
    ):
        tree.latest("cup", "base")
    tree.add("cup", "camera", a_pose(), 0)
    with pytest.raises(TransformError, match="form a loop"):
        tree.latest("cup", "base")


@pytest.mark.parametrize("bad", [[0, 0, 0, 0, 0, 0, 0], [np.nan, 0, 0, 0, 0, 0, 1]])
def test_a_transform_that_is_none_is_refused_and_the_last_one_stays(bad: list[float]) -> None:
    tree, cup = TransformTree(), a_pose()
    assert tree.add("base", "cup", cup, 0) == ""
    assert "(transform from 'base' to 'cup')" in tree.add("base", "cup", bad, MS)
    assert tree.latest("cup", "base") == 0 and tree.add("base", "base", cup, 0).startswith("wrong frame_id")


def test_old_transforms_are_given_up_and_late_ones_sorted_in() -> None:
    tree = TransformTree(memory=1.0)
    order = RANDOM.permutation(50)
    for start in range(0, 1000, 50):
        for k in order + start:
            tree.add("base", "cup", [0.01 * k, 0, 0, 0, 0, 0, 1], int(k) * 10 * MS)
    assert tree.pose("cup", "base", 9_123 * MS)[0] == pytest.approx(9.123)
    with pytest.raises(TransformError, match="before its first"):
        tree.pose("cup", "base", 5_000 * MS)


def test_a_watch_tells_each_time_once_and_when_all_of_the_chain_is_known() -> None:
    tree = TransformTree()
    watch = TransformWatch(tree, "cup", "base")
    assert watch.news() is None and "nothing connects" in watch.reason
    tree.add("base", "camera", [0, 0, 1, 0, 0, 0, 1], 0)
    tree.add("camera", "cup", [0, 1, 0, 0, 0, 0, 1], 30 * MS)
    assert watch.news() is None and "requested 0.030 s before its first" in watch.reason
    seen = []
    for k in range(1, 20):
        tree.add("base", "camera", [0.1 * k, 0, 1, 0, 0, 0, 1], 20 * k * MS)
        tree.add("camera", "cup", [0, 1, 0, 0, 0, 0, 1], (30 * k + 30) * MS)
        if (found := watch.news()) is not None:
            seen.append(found)
    assert [stamp for stamp, _ in seen] == [20 * k * MS for k in range(1, 20) if 20 * k >= 30]
    for stamp, pose in seen:
        assert stamp is not None
        np.testing.assert_allclose(pose, [5e-9 * stamp, 1, 1, 0, 0, 0, 1], atol=1e-12)
    static = TransformTree()
    static.add("base", "cup", [0, 1, 0, 0, 0, 0, 1], 0, is_static=True)
    found = TransformWatch(static, "cup", "base").news()
    assert found is not None and found[0] is None


def test_two_parents_by_turns_are_refused_and_a_thing_that_is_grasped_is_not() -> None:
    tree, cup = TransformTree(), a_pose()
    for parent, times in (("base", range(10)), ("hand", range(10, 20)), ("base", range(1020, 1030))):
        for k in times:
            tree.add("base", "hand", a_pose(), 2 * k * MS)
            tree.add(parent, "cup", cup, 2 * k * MS)
            tree.pose("cup", "base", 2 * k * MS)
    for parent, k in (("hand", 2060), ("base", 2062)):
        tree.add("base", "hand", a_pose(), k * MS)
        tree.add(parent, "cup", cup, k * MS)
    with pytest.raises(TransformError, match="'cup' has two parents by turns, 'hand' and 'base': two programs publish"):
        tree.pose("cup", "base", 2062 * MS)
    for k in range(2070, 3110, 10):
        tree.add("base", "hand", a_pose(), k * MS)
        tree.add("hand", "cup", cup, k * MS)
    tree.pose("cup", "base", 3100 * MS)


def test_static_transforms_that_contradict_one_another_are_named_and_repeated_ones_are_not() -> None:
    tree, camera = TransformTree(), np.array([1.0, 0.2, 1.5, 0.0, 0.0, 0.0, 1.0])
    tree.add("base", "camera", camera, 0, is_static=True)
    tree.add("base", "camera", camera + 1e-5, 0, is_static=True)
    tree.add("base", "camera", -camera * [-1, -1, -1, 1, 1, 1, 1], 0, is_static=True)
    assert not tree.unsteady
    tree.add("base", "camera", camera + [0.3, 0.4, 0, 0, 0, 0, 0], 0, is_static=True)
    assert "'camera' has a static transform and another one" in tree.unsteady["camera"]
    assert "0.500 m and 0.0 deg apart" in tree.unsteady["camera"]
    tree.add("base", "table", camera, 0, is_static=True)
    tree.add("world", "table", camera, 0, is_static=True)
    assert "in 'base' and in 'world'" in tree.unsteady["table"]
    tree.add("base", "tool", camera, 0, is_static=True)
    tree.add("base", "tool", camera + [0.1, 0, 0, 0, 0, 0, 0], MS)
    assert "0.100 m" in tree.unsteady["tool"]
