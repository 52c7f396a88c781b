# SPDX-License-Identifier: Apache-2.0
"""A simulated camera: it sees now and then, not exactly, and says so late.

It takes an image of all that is in sight, a little before or after its beat, and hands out the poses that were found
in it when the image has been worked on. Time is an argument: with the same times and the same seed it sees the same.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from tpgmm_core.common.settings import Settings, setting
from tpgmm_core.common.types import Array
from tpgmm_core.geometry.manifold import POSE

_SECOND = 1_000_000_000


@dataclass(frozen=True, slots=True, kw_only=True)
class CameraConfig(Settings):
    """What a camera is like; the defaults are those of an ordinary one with a detector of objects behind it.

    The noise is that of each image, independent of all others, for each of the three directions alike.
    """

    rate: float = setting(30.0, 0.1, 1000.0, "Images, Hz")
    jitter: float = setting(0.004, 0.0, 1.0, "An image is at most this far from its beat, evenly distributed, s")
    delay: float = setting(0.03, 0.0, 1.0, "From the image to the poses that were found in it, s")
    position_noise: float = setting(0.001, 0.0, 0.1, "Standard deviation along each axis, m")
    orientation_noise: float = setting(math.radians(0.5), 0.0, 0.5, "Standard deviation about each axis, rad")

    def exact(self, rate: float) -> CameraConfig:
        """One that sees exactly, at once and on its beat, `rate` times per second, Hz."""
        return replace(self, rate=rate, jitter=0.0, delay=0.0, position_noise=0.0, orientation_noise=0.0)


#: What programs offer: perception as it is, or one that is never wrong.
PERCEPTIONS = ("camera", "exact")


def perception(kind: str, exact_rate: float) -> CameraConfig:
    """The camera for one of PERCEPTIONS.

    Parameters
    ----------
    kind
        its name
    exact_rate
        how often an exact one sees, Hz

    Returns
    -------
    CameraConfig
        what a camera sees and when

    Raises
    ------
    ValueError
        for another name
    """
    if kind not in PERCEPTIONS:
        raise ValueError(f"perception '{kind}': expected one of {', '.join(PERCEPTIONS)}")
    return CameraConfig() if kind == "camera" else CameraConfig().exact(exact_rate)


@dataclass(frozen=True, slots=True)
class Sighting:
    """What was found in one image.

    Parameters
    ----------
    stamp_ns
        when the image was taken, ns
    poses
        (7,) of what was in sight, by name, as it looked
    """

    stamp_ns: int
    poses: dict[str, Array]


class SimulatedCamera:
    """Ask it regularly; it can only look when it is asked, so that its times are those at which it is.

    Parameters
    ----------
    config
        what it is like
    seed
        of noise and jitter
    """

    def __init__(self, config: CameraConfig, seed: int | list[int] = 0) -> None:
        self.config = config
        self._random = np.random.default_rng(seed)
        self._spread = np.repeat([config.position_noise, config.orientation_noise], 3)
        self._first_ns: int | None = None
        self._asked_ns = self._due_ns = 0
        self._beats = 0
        self._pending: deque[Sighting] = deque()

    def look(self, time_ns: int, places: Mapping[str, Array]) -> Sighting | None:
        """What is known at a time, ns, that was not known before: the newest image that has been worked on.

        A time before the last one begins anew.

        Parameters
        ----------
        places
            true poses (7,) of what is in sight now

        Returns
        -------
        Sighting | None
            None where there is nothing new
        """
        if self._first_ns is None or time_ns < self._asked_ns:  # a simulation that was started again
            self._begin(time_ns, places)
        self._asked_ns = time_ns
        if time_ns >= self._due_ns:
            self._take(time_ns, places)
        ready: Sighting | None = None
        while self._pending and time_ns - self._pending[0].stamp_ns >= round(self.config.delay * _SECOND):
            ready = self._pending.popleft()
        return ready

    def _begin(self, time_ns: int, places: Mapping[str, Array]) -> None:
        """It was running before anybody asked: the last image of what is there is known by now."""
        self._beats = 0
        self._pending.clear()
        self._first_ns = self._due_ns = max(0, time_ns - round(self.config.delay * _SECOND))
        if self._first_ns < time_ns:
            self._take(self._first_ns, places)

    def _take(self, time_ns: int, places: Mapping[str, Array]) -> None:
        self._pending.append(Sighting(time_ns, {name: self._see(place) for name, place in places.items()}))
        self._wait_for_the_next(time_ns)

    def _see(self, place: Array) -> Array:
        if not self._spread.any():
            return place.copy()
        return POSE.exp(place, self._spread * self._random.standard_normal(6))

    def _wait_for_the_next(self, time_ns: int) -> None:
        assert self._first_ns is not None
        period = _SECOND / self.config.rate
        # beats that passed while nobody asked are left out: a camera takes no images of the past
        self._beats = max(self._beats, math.floor((time_ns - self._first_ns) / period)) + 1
        jitter = self._random.uniform(-1.0, 1.0) * self.config.jitter * _SECOND
        self._due_ns = max(time_ns + 1, self._first_ns + round(self._beats * period + jitter))
