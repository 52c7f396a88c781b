# SPDX-License-Identifier: Apache-2.0
"""How well a frame is observed: counted while it is tracked, and said in words."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from tpgmm_core.common.types import Array
from tpgmm_core.observation.pose_filter import PoseFilter
from tpgmm_core.observation.poses import doubtful_units, odd_length
from tpgmm_core.observation.streams import SECOND

#: The same numbers for this long, under fresh stamps, where there was noise before: they are frozen, s.
FROZEN_AFTER = 1.0


@dataclass(frozen=True, slots=True)
class FrameHealth:
    """How well one frame is observed.

    Parameters
    ----------
    age
        since the last observation that was used, s; None where there is none
    rate
        of its observations, Hz; None while too few have come
    noise
        standard deviations in the direction of most noise, m and rad; 0 where none is known
    refused
        number of refused observations so far, by reason
    notes
        what was put right, in words
    doubts
        what should be looked after, in words
    trouble
        why the last observation was refused; empty where it was used
    """

    age: float | None
    rate: float | None
    noise: tuple[float, float]
    refused: dict[str, int]
    notes: tuple[str, ...] = ()
    doubts: tuple[str, ...] = ()
    trouble: str = ""


class FrameRecord:
    """What is counted of the observations of one frame."""

    def __init__(self) -> None:
        self.refused: dict[str, int] = {}
        self.odd_lengths = self.odd_covariances = 0
        self.trouble = ""
        self.forget()

    def forget(self) -> None:
        """Start anew; what was counted stays."""
        self._seen: list[float] = []
        self._since_ns = self._stamp_ns = 0
        self._trembled = False

    def refuse(self, reason: str) -> None:
        """Count a refused observation by its reason: kind, ":", details."""
        kind = reason.split(":", 1)[0]
        self.refused[kind] = self.refused.get(kind, 0) + 1
        self.trouble = reason

    def take(self, given: Sequence[float] | Array, pose: Array, stamp_ns: int, filtered: PoseFilter) -> None:
        """Count an observation that is used.

        Parameters
        ----------
        given
            the pose as it came
        pose
            the same (7,), checked
        stamp_ns
            when it was seen, ns
        filtered
            what has seen it too, and knows its noise
        """
        self.odd_lengths += odd_length(given)
        self.trouble = ""
        seen = pose.tolist()
        if seen != self._seen:
            self._seen, self._since_ns = seen, stamp_ns
        self._stamp_ns = stamp_ns
        self._trembled = self._trembled or filtered.is_noisy

    def notes(self, lead_ns: int) -> tuple[str, ...]:
        """What was put right; `lead_ns`: by how much stamps are corrected, ns."""
        notes = []
        if lead_ns:
            notes.append(f"its clock is {lead_ns / SECOND:.3f} s ahead of ROS time: stamps are corrected")
        if self.odd_lengths:
            notes.append(f"{self.odd_lengths} quaternions were not of length 1 and were normalised")
        if self.odd_covariances:
            notes.append(
                f"{self.odd_covariances} covariances are none (a variance that is not above 0, or not finite): not used"
            )
        if reason := doubtful_units(self._seen[:3]):
            notes.append(reason)
        return tuple(notes)

    def doubts(self) -> tuple[str, ...]:
        """What should be looked after."""
        unchanged = (self._stamp_ns - self._since_ns) / SECOND
        if not self._trembled or unchanged < FROZEN_AFTER:
            return ()
        return (
            f"possibly frozen: the same numbers for {unchanged:.1f} s with new stamps, although there was noise before",
        )
