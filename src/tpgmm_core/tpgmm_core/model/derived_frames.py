# SPDX-License-Identifier: Apache-2.0
"""Frames that nobody observes by themselves: of an observed frame, of the hand's pose at the start, or the base.

An unturned frame stands where its source stands, with the axes of the base: it says where things are and not how they
are turned. A model names its frames and keeps in its metadata what the derived ones are made of, so that whoever
reproduces with it needs the observed frames and the robot's state at the start, and nothing else.
"""

from __future__ import annotations

import json
from collections.abc import Collection, Iterable, Mapping
from dataclasses import dataclass, field
from typing import Any, Self

import numpy as np

from tpgmm_core.common.text import shown
from tpgmm_core.common.types import Array
from tpgmm_core.geometry.frame import Frame
from tpgmm_core.model.demonstration import Demonstration

HAND = "the hand at the start"
"""Source: the pose of what is reproduced, when the movement begins. No frame's name: those have no spaces."""
BASE = "the base"
"""Source: the common frame itself."""
KEY = "derived_frames"
"""Key of the derived frames in a model's metadata."""


@dataclass(frozen=True, slots=True)
class FrameSource:
    """What a derived frame is made of.

    Parameters
    ----------
    of
        name of an observed frame, or HAND, or BASE
    turned
        whether it turns with its source; else only its origin moves with it
    """

    of: str
    turned: bool = True

    def __str__(self) -> str:
        """In words."""
        return self.of if self.turned or self.of == BASE else f"{self.of}, unturned"


@dataclass(frozen=True, slots=True)
class DerivedFrames:
    """Derived frames by name.

    Parameters
    ----------
    sources
        name of the derived frame → what it is made of

    Raises
    ------
    ValueError
        for a frame that is derived from a derived one, or from itself
    """

    sources: Mapping[str, FrameSource] = field(default_factory=dict)

    def __post_init__(self) -> None:
        for name, source in self.sources.items():
            if source.of in self.sources:
                raise ValueError(
                    f"frame {shown(name)} is derived from {shown(source.of)}, which is derived too: name an observed "
                    "or fixed frame"
                )
        object.__setattr__(self, "sources", dict(self.sources))

    @classmethod
    def of_metadata(cls, metadata: Mapping[str, Any]) -> Self:
        """Those that a model was learned with; none for a model that names none.

        Returns
        -------
        Self
            the frames by name, and what they are made of

        Raises
        ------
        ValueError
            for a text that `metadata` did not write
        """
        text = metadata.get(KEY, "{}")
        try:
            sources = {}
            for name, (of, turned) in json.loads(text).items():
                if not isinstance(of, str) or not isinstance(turned, bool):
                    raise ValueError
                sources[name] = FrameSource(of, turned)
        except (ValueError, TypeError, AttributeError, RecursionError):
            raise ValueError(
                f"the model's metadata say {KEY} = {shown(text)}; expected what 'train' writes, such as "
                '{"object_unturned": ["object", false]}: train the model again'
            ) from None
        return cls(sources)

    @classmethod
    def joined(cls, parts: Iterable[DerivedFrames]) -> Self:
        """Those of several models that are used together.

        Parameters
        ----------
        parts
            of each model

        Returns
        -------
        Self
            all of them

        Raises
        ------
        ValueError
            for a name that means different frames
        """
        sources: dict[str, FrameSource] = {}
        for part in parts:
            for name, source in part.sources.items():
                if sources.setdefault(name, source) != source:
                    raise ValueError(
                        f"frame {shown(name)} is derived from {shown(str(sources[name]))} in one model, from "
                        f"{shown(str(source))} in another: name them differently"
                    )
        return cls(sources)

    def metadata(self) -> dict[str, str]:
        """For a model's metadata; nothing where nothing is derived."""
        if not self.sources:
            return {}
        return {KEY: json.dumps({name: [source.of, source.turned] for name, source in self.sources.items()})}

    def only(self, names: Collection[str]) -> Self:
        """Those of these names."""
        return type(self)({name: source for name, source in self.sources.items() if name in names})

    def observed(self, names: Collection[str]) -> tuple[str, ...]:
        """Frames that have to be observed, or are fixed, so that these are known: names in order, each once."""
        needed = (self.sources[name].of if name in self.sources else name for name in names)
        return tuple(name for name in dict.fromkeys(needed) if name not in (HAND, BASE))

    def frames(self, known: Mapping[str, Frame], start: Array | None = None) -> dict[str, Frame]:
        """Those that can be made now, over [time, point].

        Parameters
        ----------
        known
            the frames that are known, by name
        start
            where the hand was when the movement began, a pose (7,) or a position (3,); None where not known

        Returns
        -------
        dict[str, Frame]
            by name
        """
        made = {}
        for name, source in self.sources.items():
            frame = self._frame(source, known, start)
            if frame is not None:
                made[name] = frame
        return made

    def weights(self, known: Mapping[str, float]) -> dict[str, float]:
        """How far each is trusted, 0 to 1: as far as the frame that it is derived from."""
        return {name: known.get(source.of, 1.0) for name, source in self.sources.items()}

    def extended(self, demonstration: Demonstration) -> Demonstration:
        """The demonstration with these frames beside its own; the hand started at its first sample.

        Returns
        -------
        Demonstration
            with its own frames and these

        Raises
        ------
        ValueError
            where a frame is needed that the demonstration has not
        """
        if not self.sources:
            return demonstration
        made = self.frames(demonstration.frames, demonstration.data[0, 1:])
        for name, source in self.sources.items():
            if name not in made:
                raise ValueError(
                    f"frame {shown(name)} is derived from {shown(source.of)}; the demonstration has the frames "
                    f"{', '.join(demonstration.frames)}"
                )
        visible = dict(demonstration.visible or {})
        visible |= {name: visible[source.of] for name, source in self.sources.items() if source.of in visible}
        return Demonstration(demonstration.times, demonstration.data, {**demonstration.frames, **made}, visible)

    @staticmethod
    def _frame(source: FrameSource, known: Mapping[str, Frame], start: Array | None) -> Frame | None:
        if source.of == BASE:
            D = len(start) + 1 if start is not None else next((f.b.shape[-1] for f in known.values()), 0)
            return Frame(np.eye(D), np.zeros(D)) if D else None
        if source.of == HAND:
            return None if start is None else _of_start(start, source.turned)
        frame = known.get(source.of)
        return frame if frame is None or source.turned else unturned(frame)


def _of_start(start: Array, turned: bool) -> Frame:
    if turned and len(start) == 7:
        return Frame.from_pose(start[:3], start[3:]).with_time()
    return Frame(np.eye(len(start) + 1), np.concatenate([[0.0], start[:3], np.zeros(len(start) - 3)]))


def unturned(frame: Frame) -> Frame:
    """A frame at the same place whose axes are those of the base.

    Parameters
    ----------
    frame
        over [time, pose] or [time, position]

    Returns
    -------
    Frame
        with the same origin, known as well as that of the frame
    """
    b = frame.b[0] if frame.is_time_varying and (frame.b == frame.b[0]).all() else frame.b
    covariance = None
    if frame.pose_covariance is not None:
        covariance = np.zeros((6, 6))
        covariance[:3, :3] = frame.pose_covariance[:3, :3]
    return Frame(np.eye(b.shape[-1]), b, pose_covariance=covariance)


def with_frames(demonstration: Demonstration, names: Collection[str]) -> Demonstration:
    """The same demonstration, seen from these frames only, in this order."""
    visible = {name: mask for name, mask in (demonstration.visible or {}).items() if name in names}
    return Demonstration(
        demonstration.times, demonstration.data, {name: demonstration.frames[name] for name in names}, visible
    )
