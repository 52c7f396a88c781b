# SPDX-License-Identifier: Apache-2.0
"""Recordings at a steady rate, and how far that leads away from what was recorded."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from tpgmm_core.common.types import Array
from tpgmm_core.geometry import quaternion
from tpgmm_ros.recordings.conversion.conversion_error import ConversionError
from tpgmm_ros.recordings.recording import Recording

_SAME_S = 1e-6
"""Times that differ by less are the same."""


@dataclass(frozen=True, slots=True)
class Sampled:
    """A recording at a steady rate.

    Attributes
    ----------
    recording
        its times are k / rate
    off_m
        how far the path along straight lines is from the samples that were recorded, m; 0 where these are the same
    """

    recording: Recording
    off_m: float


def rate_of(recordings: Sequence[Recording]) -> float:
    """Samples per second that recordings have, Hz: the median."""
    return float(1.0 / np.median(np.concatenate([np.diff(one.times) for one in recordings])))


def sampled(recording: Recording, fps: int) -> Sampled:
    """A recording at a steady rate; one that has that rate stays as it is.

    Parameters
    ----------
    recording
        with any times
    fps
        samples per second, Hz

    Returns
    -------
    Sampled
        between the recorded samples, positions and joints go straight, orientations turn steadily, and frames are
        where they were last seen

    Raises
    ------
    ConversionError
        it is shorter than a sample.
    """
    count = int(np.floor(recording.duration * fps + _SAME_S)) + 1
    times = np.arange(count) / fps
    if count < 2:
        raise ConversionError(f"{recording.place}: has one sample at {fps} Hz; name a higher --rate")
    if count == len(recording.times) and np.abs(times - recording.times).max() <= _SAME_S:
        return Sampled(replace(recording, times=times), 0.0)
    last = np.clip(np.searchsorted(recording.times, times + _SAME_S, side="right") - 1, 0, len(recording.times) - 1)
    poses = _between(recording.times, recording.movement, times)
    joints = recording.configurations
    found = Recording(
        recording.path,
        times,
        poses,
        {name: values[last] for name, values in recording.frames.items()},
        {name: seen[last] for name, seen in recording.visible.items()},
        recording.notes,
        None if joints is None else np.column_stack([np.interp(times, recording.times, q) for q in joints.T]),
        recording.derived,
        recording.doubts,
        recording.take,
    )
    inside = recording.times <= times[-1]
    back = _between(times, poses, recording.times[inside])
    return Sampled(found, float(np.linalg.norm((back - recording.movement[inside])[:, :3], axis=1).max()))


def _between(known: Array, poses: Array, times: Array) -> Array:
    """Poses (T, 7) at times (T,), from those (S, 7) at known ones (S,), increasing."""
    k = np.clip(np.searchsorted(known, times, side="right") - 1, 0, len(known) - 2)
    share = np.clip((times - known[k]) / (known[k + 1] - known[k]), 0.0, 1.0)[:, None]
    positions = poses[k, :3] + share * (poses[k + 1, :3] - poses[k, :3])
    return np.hstack([positions, quaternion.slerp(poses[k, 3:], poses[k + 1, 3:], share[:, 0])])
