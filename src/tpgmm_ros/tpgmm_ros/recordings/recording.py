# SPDX-License-Identifier: Apache-2.0
"""`Recording`: what one bag, or one take of it, holds of a task; demonstrations of one duration from several."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from tpgmm_core import Demonstration, Frame
from tpgmm_core.common.types import Array
from tpgmm_core.doubt.doubts import Doubt
from tpgmm_core.model.derived_frames import DerivedFrames


@dataclass(frozen=True, slots=True)
class Recording:
    """What one bag, or one take of it, holds of a task, sampled where the movement was.

    Attributes
    ----------
    path
        the bag
    times
        (T,) s from the first sample, strictly increasing
    movement
        (T, 7) poses of what is demonstrated, in the base frame: x, y, z in m, qx, qy, qz, qw
    frames
        poses (T, 7) of every frame of the task: the latest observation at or before each sample
    visible
        masks (T,), False where a frame had not been seen yet
    stretches
        of some of the frames also what their axes do to positions (T, 3, 3); see `Frame.from_pose`
    notes
        what was put right or left out while reading, in words
    configurations
        (T, n) positions of the task's joints, rad and m; None for tasks that name none
    derived
        the task's frames that are made of those above, and of the first pose of the movement
    doubts
        what makes no sense in this bag
    take
        number of the demonstration among those of its bag, from 1; 0: the bag holds no other
    outline_of
        number of the samples of which these are some, where only an outline is kept; 0: these are all
    """

    path: Path
    times: Array
    movement: Array
    frames: dict[str, Array]
    visible: dict[str, NDArray[np.bool_]]
    notes: tuple[str, ...] = ()
    configurations: Array | None = None
    derived: DerivedFrames = field(default_factory=DerivedFrames)
    doubts: tuple[Doubt, ...] = ()
    take: int = 0
    outline_of: int = 0
    stretches: dict[str, Array] = field(default_factory=dict)

    @property
    def n_samples(self) -> int:
        """Samples that were recorded, also where only an outline of them is kept."""
        return self.outline_of or len(self.times)

    @property
    def name(self) -> str:
        """The bag's name, and which of its takes this is: demo_01, or demo_01#2."""
        return self.path.name + (f"#{self.take}" if self.take else "")

    @property
    def place(self) -> str:
        """The same with the whole path."""
        return str(self.path) + (f"#{self.take}" if self.take else "")

    @property
    def duration(self) -> float:
        """Time from the first to the last sample in s."""
        return float(self.times[-1])

    def at(self, samples: NDArray[np.intp]) -> Recording:
        """The same recording with some of its samples only.

        Parameters
        ----------
        samples
            their numbers, increasing

        Returns
        -------
        Recording
            its times begin at 0 with the first of them
        """
        times = self.times[samples]
        return replace(
            self,
            times=times - times[0],
            movement=self.movement[samples],
            frames={name: poses[samples] for name, poses in self.frames.items()},
            visible={name: seen[samples] for name, seen in self.visible.items()},
            stretches={name: stretches[samples] for name, stretches in self.stretches.items()},
            configurations=None if self.configurations is None else self.configurations[samples],
        )

    def to_demonstration(self, duration: float | None = None) -> Demonstration:
        """Demonstration of [time, pose], and of configurations where there are some, which frames leave as they are.

        Parameters
        ----------
        duration
            that the time is stretched to linearly, s; None: as recorded

        Returns
        -------
        Demonstration
            the demonstration
        """
        times = self.times if duration is None else self.times * (duration / self.duration)
        joints = np.empty((len(times), 0)) if self.configurations is None else self.configurations
        same = [Frame(np.eye(joints.shape[1]), np.zeros(joints.shape[1]))] if joints.size else []
        demonstration = Demonstration(
            times=times,
            data=np.column_stack([times, self.movement, joints]),
            frames={
                name: _frame(poses, self.stretches.get(name), same).with_time() for name, poses in self.frames.items()
            },
            visible=self.visible,
        )
        return self.derived.extended(demonstration)


def _frame(poses: Array, stretches: Array | None, beside: list[Frame]) -> Frame:
    """Frame of poses (T, 7), and of what lies beside them; one constant map where nothing ever changes."""
    is_constant = all(part is None or (part == part[0]).all() for part in (poses, stretches))
    several = poses[0] if is_constant else poses
    axes = None if stretches is None else stretches[0] if is_constant else stretches
    frame = Frame.from_pose(several[..., :3], several[..., 3:], stretch=axes)
    return Frame.stacked([frame, *beside]) if beside else frame


def align(recordings: Sequence[Recording]) -> tuple[list[Demonstration], float]:
    """Recordings as demonstrations of one duration.

    Parameters
    ----------
    recordings
        one or more

    Returns
    -------
    tuple[list[Demonstration], float]
        demonstrations with their times stretched linearly to the mean duration, and that duration, s

    Raises
    ------
    ValueError
        there are no recordings.
    """
    if not recordings:
        raise ValueError("there are no recordings to align; expected at least one")
    duration = float(np.mean([recording.duration for recording in recordings]))
    return [recording.to_demonstration(duration) for recording in recordings], duration
