# SPDX-License-Identifier: Apache-2.0
"""Objects that a simulation has instead of sensors: where they lie, which are hidden, and new places at random."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from tpgmm_core.common.types import Array
from tpgmm_core.geometry import quaternion
from tpgmm_core.geometry.pose import compose
from tpgmm_demos.scene.pick_place import OBJECT_REGION, TARGET_REGION, PlacementRegion

#: Where objects of any task lie: beside one another on a table below the hand, m.
BELOW, BESIDE, ROOM = 0.13, 0.22, 0.09
#: The hand at an object: this far above its middle along the object's z axis; "above" it is this much higher, m.
AT, CLEARANCE = 0.02, 0.10


def regions_of(task: str, frames: Iterable[str], hand: Array) -> dict[str, PlacementRegion]:
    """Where the objects of a task may lie in a simulation.

    Parameters
    ----------
    task
        its name
    frames
        names of the observed ones
    hand
        (7,) where the hand is at home

    Returns
    -------
    dict[str, PlacementRegion]
        a region for each frame
    """
    names = list(frames)
    if task == "pick_place" and set(names) == {"object", "target"}:
        return {"object": OBJECT_REGION, "target": TARGET_REGION}
    x, y, z = (float(value) for value in hand[:3])
    regions = {}
    for i, name in enumerate(names):
        side = y + BESIDE * (0.5 * (len(names) - 1) - i)
        regions[name] = PlacementRegion(
            (x - ROOM, side - ROOM, z - BELOW - 0.02), (x + ROOM, side + ROOM, z - BELOW + 0.02), yaw=0.6, tilt=0.0
        )
    return regions


class Arrangement:
    """Where the objects lie.

    Parameters
    ----------
    regions
        where each of them may lie
    seed
        of the places

    Attributes
    ----------
    places
        name -> pose (7,), hidden or not
    hidden
        names of those that nobody sees
    """

    def __init__(self, regions: dict[str, PlacementRegion], seed: int | None = None) -> None:
        self._regions = regions
        self._random = np.random.default_rng(seed)
        self.places: dict[str, Array] = {}
        self.hidden: set[str] = set()
        self.shuffle()

    def shuffle(self) -> None:
        """Lay all of them elsewhere."""
        self.places = {name: region.sample(self._random) for name, region in self._regions.items()}

    def move(self, name: str, pose: Array) -> None:
        """Lay one of them at a pose (7,).

        Raises
        ------
        ValueError
            for one that there is not
        """
        if name not in self.places:
            raise ValueError(f"there is no object {name!r} to be moved; there are {', '.join(self.places) or 'none'}")
        self.places[name] = np.concatenate([pose[:3], quaternion.normalize(pose[3:])])

    def hide(self, name: str, hidden: bool) -> None:
        """Hide one of them from the sensors, or show it again."""
        self.hidden = self.hidden | {name} if hidden else self.hidden - {name}

    def in_sight(self) -> dict[str, Array]:
        """Those that are seen."""
        return {name: pose for name, pose in self.places.items() if name not in self.hidden}


def hand_over(place: Array, home: Array, above: bool) -> Array:
    """Where to lead a hand to an object, or to a place above it.

    Parameters
    ----------
    place
        (7,) of the object
    home
        (7,) of the hand at home: it is turned to an object as it is at home to one that is not turned
    above
        a little higher

    Returns
    -------
    Array
        (7,)
    """
    height = AT + (CLEARANCE if above else 0.0)
    return compose(place, np.concatenate([[0.0, 0.0, height], home[3:]]))
