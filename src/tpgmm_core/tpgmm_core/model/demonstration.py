# SPDX-License-Identifier: Apache-2.0
"""`Demonstration`: what was shown once, in which situation, and which frames were seen when."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tpgmm_core.common.types import Array
from tpgmm_core.geometry.frame import Frame


@dataclass(frozen=True, slots=True, eq=False)
class Demonstration:
    """One demonstration.

    Parameters
    ----------
    times
        shape (T,), s, strictly increasing
    data
        shape (T, D), in the common frame; all that the model is to encode (time first where it is wanted)
    frames
        name → Frame, constant or with T time steps
    visible
        name → mask (T,), False where the frame was not seen; frames not named were always seen. Where a time-varying
        frame is not seen its A and b may hold anything finite

    Raises
    ------
    ValueError
        for shapes and times that do not fit, with what does not fit
    """

    times: Array
    data: Array
    frames: Mapping[str, Frame]
    visible: Mapping[str, NDArray[np.bool_]] | None = None

    def __post_init__(self) -> None:
        times, data = np.asarray(self.times, dtype=float), np.asarray(self.data, dtype=float)
        if times.ndim != 1 or len(times) == 0:
            raise ValueError(f"times have shape (T,) with T > 0, got {times.shape}")
        if data.ndim != 2 or len(data) != len(times):
            raise ValueError(f"data has shape (T, D) with T = {len(times)} as the times, got {data.shape}")
        if not np.all(np.isfinite(times)):
            raise ValueError("times must be finite")
        bad = np.flatnonzero(~np.all(np.isfinite(data), axis=1))
        if len(bad):
            raise ValueError(f"data must be finite, sample {bad[0]} is {data[bad[0]]} ({len(bad)} such samples)")
        bad = np.flatnonzero(np.diff(times) <= 0.0)
        if len(bad):
            i = bad[0]
            raise ValueError(
                f"times must increase strictly, but {times[i]} s is followed by {times[i + 1]} s (sample {i})"
            )
        if not self.frames:
            raise ValueError("a demonstration needs at least one frame")
        for name, frame in self.frames.items():
            if frame.b.shape[-1] != data.shape[1]:
                raise ValueError(f"frame {name!r} maps to {frame.b.shape[-1]} dimensions, the data has {data.shape[1]}")
            if frame.is_time_varying and len(frame.A) != len(times):
                raise ValueError(f"frame {name!r} has {len(frame.A)} time steps, the demonstration {len(times)}")
        visible = {name: np.asarray(mask) for name, mask in (self.visible or {}).items()}
        for name, mask in visible.items():
            if name not in self.frames:
                raise ValueError(f"visible names the unknown frame {name!r}; known are {sorted(self.frames)}")
            if mask.shape != times.shape or mask.dtype != np.bool_:
                raise ValueError(f"visible[{name!r}] is a bool mask {times.shape}, got {mask.dtype} {mask.shape}")
        object.__setattr__(self, "times", times)
        object.__setattr__(self, "data", data)
        object.__setattr__(self, "frames", dict(self.frames))
        object.__setattr__(self, "visible", visible)

    def projected(self) -> dict[str, Array]:
        """The data as seen from each frame, name → (T, D_j): Eq. (4)."""
        return {name: frame.project(self.data) for name, frame in self.frames.items()}

    def is_visible(self, name: str) -> NDArray[np.bool_]:
        """Mask (T,) of the samples at which the frame was seen.

        Parameters
        ----------
        name
            of the frame

        Returns
        -------
        NDArray[np.bool_]
            shape (T,)
        """
        assert self.visible is not None  # set by __post_init__
        return self.visible.get(name, np.ones(len(self.times), dtype=bool))

    def at(self, samples: NDArray[np.intp]) -> Demonstration:
        """The same demonstration with some of its samples only.

        Parameters
        ----------
        samples
            their indices, increasing

        Returns
        -------
        Demonstration
            with these samples, in this order
        """
        frames = {name: frame.at(samples) for name, frame in self.frames.items()}
        visible = {name: mask[samples] for name, mask in (self.visible or {}).items()}
        return Demonstration(self.times[samples], self.data[samples], frames, visible)
