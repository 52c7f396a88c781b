# SPDX-License-Identifier: Apache-2.0
"""`OneByOne`: recordings that are in the memory one at a time; their numbers stand in files, as long as it lives."""

from __future__ import annotations

import tempfile
from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from types import TracebackType
from typing import Any, Self

import numpy as np

from tpgmm_core import Demonstration
from tpgmm_core.doubt.doubts import Doubt, RawDemonstration
from tpgmm_core.doubt.judging import judged_alone
from tpgmm_ros.recordings.judging import shown_in
from tpgmm_ros.recordings.recording import Recording
from tpgmm_ros.task.task_file import Task

OUTLINE = 100
"""Samples of each recording that stay in the memory: for what is judged of recordings beside one another."""


class OneByOne:
    """Keeps recordings in a temporary folder (TMPDIR says where), and outlines of them in the memory.

    Bags are read once, however often their numbers are gone through.

    Parameters
    ----------
    task
        that they are of
    """

    def __init__(self, task: Task) -> None:
        self._task = task
        self._folder = tempfile.TemporaryDirectory(prefix="tpgmm_")
        self._files: dict[str, Path] = {}
        self._doubts: dict[str, list[Doubt]] = {}

    def __enter__(self) -> Self:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, at: TracebackType | None) -> None:
        self._folder.cleanup()

    def keep(self, recording: Recording) -> Recording:
        """Put a recording into a file, and judge it by itself.

        Parameters
        ----------
        recording
            with all samples

        Returns
        -------
        Recording
            its outline

        Raises
        ------
        OSError
            the temporary folder is full.
        """
        file = self._files.setdefault(recording.place, Path(self._folder.name) / f"{len(self._files)}.npz")
        beside: dict[str, Any] = (
            {} if recording.configurations is None else {"configurations": recording.configurations}
        )
        for key in ("frames", "visible", "stretches"):
            beside[key] = list(getattr(recording, key).values())
        np.savez(file, times=recording.times, movement=recording.movement, **beside)
        self._doubts[recording.place] = judged_alone(shown_in(recording, self._task))
        T = len(recording.times)
        outline = recording.at(np.unique(np.linspace(0, T - 1, min(T, OUTLINE)).round().astype(np.intp)))
        return replace(outline, outline_of=T)

    def alone(self, one: RawDemonstration) -> Sequence[Doubt]:
        """What makes no sense in a recording of which an outline was kept, by itself."""
        return self._doubts[one.name]

    def whole(self, outline: Recording) -> Recording:
        """A recording with all samples, from its outline."""
        with np.load(self._files[outline.place], allow_pickle=False) as found:
            return replace(
                outline,
                times=found["times"],
                movement=found["movement"],
                frames=dict(zip(outline.frames, found["frames"], strict=True)),
                visible=dict(zip(outline.visible, found["visible"], strict=True)),
                stretches=dict(zip(outline.stretches, found["stretches"], strict=True)),
                configurations=found.get("configurations"),
                outline_of=0,
            )


class Parts:
    """Recordings as demonstrations of one duration, each a part: see `TPGMM.fit_parts`.

    Parameters
    ----------
    kept
        where they are
    outlines
        of them
    """

    def __init__(self, kept: OneByOne, outlines: Sequence[Recording]) -> None:
        self._kept, self._outlines = kept, outlines
        self.duration = float(np.mean([outline.duration for outline in outlines]))

    def __iter__(self) -> Iterator[Sequence[Demonstration]]:
        for outline in self._outlines:
            yield [self._kept.whole(outline).to_demonstration(self.duration)]
