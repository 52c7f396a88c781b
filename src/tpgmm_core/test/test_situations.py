# SPDX-License-Identifier: Apache-2.0
"""How many situations the frames' degrees of freedom need, what is not determined, and which one would add most."""

from __future__ import annotations

import numpy as np
import pytest

from reaching import frames_at, place, reaching_demonstrations
from tpgmm_core import Demonstration
from tpgmm_core.common.types import Array
from tpgmm_core.geometry.manifold import Manifold
from tpgmm_core.learning.situations import DemonstratedSituations, FrameCoordinates, demonstrated_situations
from worlds import moved, random_world

ROBOT = place(0.0, 0.0, 0.0)
MANIFOLD = Manifold.parse("R1 x R3 x S3")


def judged(*poses: Array) -> DemonstratedSituations:
    """Of demonstrations with an object at these poses (7,), and a robot that stands still."""
    times = np.linspace(0.0, 1.0, 5)
    shown = [
        Demonstration(times, np.column_stack([times, np.tile(pose, (5, 1))]), frames_at(object=pose, robot=ROBOT))
        for pose in poses
    ]
    return demonstrated_situations(shown, MANIFOLD)


def test_degrees_of_freedom_are_counted_and_what_never_varies_is_named() -> None:
    rng = np.random.default_rng(0)
    found = judged(*(place(*rng.uniform(-0.2, 0.2, 2), rng.uniform(-0.5, 0.5)) for _ in range(5)))
    assert found.varied == ("object: x", "object: y", "object: turn about z")
    assert found.constant == ("object: z", "object: turn about x", "object: turn about y")
    assert (found.count, found.least, found.better, found.undetermined) == (5, 4, 8, 0)
    assert "object (x, y, turn about z) varied: 3 degrees of freedom" in str(found) and "5 were demonstrated" in str(
        found
    )
    assert "Never varied, so not learned: object (z, turn about x, turn about y)" in str(found)


def test_what_varies_together_only_is_not_determined_and_the_missing_corner_is_asked_for() -> None:
    found = judged(*(place(share, 0.5 * share, 0.0) for share in np.linspace(-0.2, 0.2, 6)))
    assert found.undetermined == 1 and "1 of the degrees of freedom never varied independently" in str(found)
    x, y = (found.most_informative[f"object: {axis}"] for axis in "xy")
    assert x * y < 0.0 and abs(x) == pytest.approx(0.2) and abs(y) == pytest.approx(0.1)


def test_the_corner_that_no_demonstration_was_near_is_the_most_informative_one() -> None:
    found = judged(*(place(x, y, 0.0) for x, y in ((0, 0), (0, 0.1), (0.1, 0), (0.05, 0.05), (0.02, 0.01))))
    assert found.most_informative == pytest.approx({"object: x": 0.1, "object: y": 0.1})
    assert "The most informative next demonstration: object (x 0.10, y 0.10)" in str(found)


def test_the_same_situation_again_and_again_teaches_nothing_of_others() -> None:
    found = judged(*[place(0.1, 0.2, 0.3)] * 4)
    assert found.varied == () and found.least == 1 and "all 4 demonstrations have the same situation" in str(found)
    assert str(judged(place(0.1, 0.2, 0.3))).startswith("one demonstration shows one situation")
    assert "object (x) varied: 1 degree of freedom." in str(judged(place(0.1, 0.2, 0.3), place(0.4, 0.2, 0.3)))


def test_enough_demonstrations_are_not_asked_for_more() -> None:
    found = demonstrated_situations(reaching_demonstrations(20), MANIFOLD)
    assert len(found.varied) == 6 and found.better == 14 and "most informative" not in str(found)


def test_coordinates_of_a_missing_frame_are_not_known_and_those_of_a_moved_world_move_alike() -> None:
    rng = np.random.default_rng(1)
    situations = [d.frames for d in reaching_demonstrations()]
    space = MANIFOLD.subset(range(1, 8))
    coordinates = FrameCoordinates.of(situations, space)
    assert coordinates(situations[0]).shape == (12,)
    half = coordinates({"object": situations[0]["object"]})
    assert np.isnan(half).sum() == 6
    world = random_world(7, rng)
    elsewhere = [moved(world, frames) for frames in situations]
    again = FrameCoordinates.of(elsewhere, space)
    for one, other in zip(situations, elsewhere, strict=True):
        assert np.linalg.norm(coordinates(one)) == pytest.approx(np.linalg.norm(again(other)), abs=1e-9)
