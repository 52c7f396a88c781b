# SPDX-License-Identifier: Apache-2.0
"""`Waiting`: a movement that waits where it is while too little is known to go on, whatever its method is.

What the complete task would know at this moment, and what the frames that are there know, a second movement of the same
model tells: it is begun at the present phase in both situations. That costs nothing while all frames are known.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from tpgmm_core.common.text import listed
from tpgmm_core.common.types import Array
from tpgmm_core.geometry.frame import Frame
from tpgmm_core.model.adaptation import UNCONSTRAINED_VARIANCE
from tpgmm_core.model.reference import Reference
from tpgmm_core.retrieval.interface import Retrieval
from tpgmm_core.retrieval.knowledge import Knowledge, KnowledgeConfig, least_known
from tpgmm_core.retrieval.wrapped import Wrapped

PERIOD_NS = 50_000_000
"""What is known is judged so often while frames are missing, and whenever one comes or goes."""
ENOUGH = 0.5
"""A movement that waits goes on where the excess is at most this, so that a flickering frame makes no stutter."""


class Waiting(Wrapped):
    """A `Retrieval` that pauses while the frames that are missing leave a direction unknown: see `knowledge`.

    Missing are also frames that are trusted less than fully, or whose poses are not known exactly; they count by what
    they still say. A movement that waits stays in the situation in which each frame was seen last, with its covariance.
    So its reference comes to rest as in a pause, and the arm is as stiff as before. Once enough is known, the movement
    goes on from there as after any change of frames. It bears that no frame at all is known.

    Parameters
    ----------
    retrieval
        the movement
    probe
        another one of the same model and settings, for this alone
    config
        from when on too little is known; its ratio is above 0
    """

    def __init__(self, retrieval: Retrieval, probe: Retrieval, config: KnowledgeConfig) -> None:
        super().__init__(retrieval)
        self._probe, self._config = probe, config
        self._asked = retrieval.speed
        self._stays: dict[str, Frame] | None = None  # the situation in which it waits
        self._forget()

    def _forget(self) -> None:
        self._seen: dict[str, Frame] = {}
        self._last: Reference | None = None
        self._words = ""
        self._given: tuple[object, object] = (None, None)
        self._names: tuple[str, ...] = ()
        self._missing: list[str] = []
        self._rough: list[str] = []
        self._judged_ns = 0

    @property
    def speed(self) -> float:
        """That with which the movement goes where it does not wait: see `Retrieval.speed`."""
        return self._retrieval.speed if self._stays is None else self._asked

    @speed.setter
    def speed(self, speed: float) -> None:
        self._retrieval.speed = speed  # which refuses what it cannot go
        if self._stays is not None:
            self._asked, self._retrieval.speed = speed, 0.0

    def start(self, time_ns: int, state: Array | None = None, phase: float = 0.0) -> None:
        """Begin a movement, which does not wait: see `Retrieval.start`."""
        self._go_on()
        self._forget()
        self._retrieval.start(time_ns, state, phase)

    def step(
        self,
        time_ns: int,
        frames: Mapping[str, Frame],
        state: Array | None = None,
        weights: Mapping[str, float] | None = None,
    ) -> Reference:
        """The reference at a time, which says why where the movement waits: see `Retrieval.step`."""
        self._take(time_ns, frames, weights)
        if self._stays is None:
            reference = self._retrieval.step(time_ns, frames, state, weights)
        else:
            stays = self._retrieval.step(time_ns, self._stays, state)
            reference = replace(stays, frames=tuple(frames), waits=self._words)
        self._last = reference
        return reference

    def _take(self, time_ns: int, frames: Mapping[str, Frame], weights: Mapping[str, float] | None) -> None:
        """Look what is missing, and judge what that leaves, where it is due."""
        is_due = time_ns - self._judged_ns >= PERIOD_NS
        if self._given[0] is not frames or self._given[1] is not weights:
            self._given = frames, weights
            is_due |= tuple(frames) != self._names
            self._names = tuple(frames)
            self._seen.update(frames)
            trust = {name: 1.0 if weights is None else weights.get(name, 1.0) for name in frames}
            self._missing = [name for name in self.frame_names if trust.get(name, 0.0) < 1.0]
            self._rough = [name for name, frame in frames.items() if frame.pose_covariance is not None]
        if not (self._missing or self._rough):
            self._go_on()
        elif is_due and self._last is not None and all(name in self._seen for name in self.frame_names):
            self._judged_ns = time_ns
            self._judge(time_ns, self._last, frames, weights)

    def _judge(
        self, time_ns: int, last: Reference, frames: Mapping[str, Frame], weights: Mapping[str, float] | None
    ) -> None:
        """Wait from now on, or go on, by what is known at the phase of the last reference."""
        exact = {name: replace(frame, pose_covariance=None) for name, frame in self._seen.items()}
        try:
            complete = self._covariance(time_ns, last, exact, None)
            present = self._covariance(time_ns, last, frames, weights)
        except ValueError:  # frames that contradict each other: nothing is learned of it, and the step says so itself
            found = None
        else:
            found = least_known(complete, present, self.manifold, self._config)
        if not frames:
            self._wait(found)
        elif found is not None and found.excess > (1.0 if self._stays is None else ENOUGH):
            self._wait(found)
        elif found is not None:
            self._go_on()

    def _wait(self, found: Knowledge | None) -> None:
        self._words = "no frame is known" if found is None else self._say(found)
        if self._stays is None:
            self._stays, self._asked = dict(self._seen), self._retrieval.speed
            self._retrieval.speed = 0.0

    def _go_on(self) -> None:
        if self._stays is not None:
            self._stays, self._retrieval.speed = None, self._asked

    def _covariance(
        self, time_ns: int, last: Reference, frames: Mapping[str, Frame], weights: Mapping[str, float] | None
    ) -> Array:
        """What a situation tells of where to be at the phase of a reference, (n, n)."""
        if not frames:
            return UNCONSTRAINED_VARIANCE * np.eye(self.manifold.tangent_dim)
        self._probe.start(time_ns, last.gaussian.mean, last.phase)
        return self._probe.step(time_ns, frames, last.gaussian.mean, weights).gaussian.covariance

    def _say(self, found: Knowledge) -> str:
        present, complete = found.words()
        if self._missing:
            them = "it" if len(self._missing) == 1 else "them"
            return f"without {listed(self._missing)} the reference is known {present}; with {them}, to {complete}"
        return (
            f"with {listed(self._rough)} known as roughly as now, the reference is known {present}; known exactly, to "
            f"{complete}"
        )
