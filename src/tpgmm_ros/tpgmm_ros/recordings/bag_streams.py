# SPDX-License-Identifier: Apache-2.0
"""`BagStreams`: what one bag says of a task, on one clock; any part of it becomes a recording."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from tpgmm_core.common.types import Array, Nanoseconds
from tpgmm_core.doubt.clocks import gaps
from tpgmm_core.doubt.doubts import Doubt
from tpgmm_core.doubt.rough_clock import RoughClock
from tpgmm_core.doubt.values import LARGEST_M
from tpgmm_core.observation.gate import MotionLimits
from tpgmm_core.observation.in_hand import carried_poses
from tpgmm_core.observation.streams import SECOND
from tpgmm_core.observation.tracked import TrackingConfig
from tpgmm_core.observation.unseen import START_TOLERANCE_S, last_seen
from tpgmm_ros.recordings.bag_messages import BagError
from tpgmm_ros.recordings.leaps import without_leaps
from tpgmm_ros.recordings.numeric_fields import read_numbers
from tpgmm_ros.recordings.pose_streams import divided
from tpgmm_ros.recordings.recording import Recording
from tpgmm_ros.task.task_file import Task

MOVEMENT = "the movement"
JOINTS = "the joints"
"""Names of the movement and of the joints among the streams; no frame's name has a space."""

GAP_S = 0.5
FRAME_GAP_S = 1.0
GAP_PERIODS = 10.0
"""A pause of a topic is said where it is longer than this time, and than so many of its periods."""

ROUNDING_S = 1e-6
"""Times that people write down are those of a sample where they differ by less."""

GOES_ON_M = 0.03
"""What is no farther from where it was before a pause, m, has rested meanwhile, or the pause is one of the clock."""

MOVED = 0.005
"""A frame whose numbers change by less has not moved, m."""


@dataclass(frozen=True, slots=True, eq=False)
class BagStreams:
    """What a bag says of a task, on one clock.

    Attributes
    ----------
    path
        the bag
    task
        that it is of
    times
        of the movement, of the joints and of each frame that moves, (S,) ns, increasing; those of joints may repeat
    values
        poses (S, 7), poses with a stretch (S, 16), or positions of joints (S, n), by the same names
    topics
        by the same names
    fixed
        poses (7,) of the other frames
    recorded
        (S,) times of the recorder for the movement's samples, ns; none where nobody knows them
    notes, doubts
        of the whole bag
    rough
        tells these times from those of the recorder, where its clock was set while it recorded
    """

    path: Path
    task: Task
    times: Mapping[str, Nanoseconds]
    values: Mapping[str, Array]
    topics: Mapping[str, str]
    fixed: Mapping[str, Array]
    recorded: Nanoseconds = field(default_factory=lambda: np.empty(0, np.int64))
    notes: tuple[str, ...] = ()
    doubts: tuple[Doubt, ...] = ()
    rough: RoughClock | None = None

    @property
    def seconds(self) -> Array:
        """Times of the movement from its first sample, (S,) s."""
        return 1e-9 * (self.times[MOVEMENT] - self.times[MOVEMENT][0]).astype(float)

    @property
    def duration_s(self) -> float:
        """From the first to the last sample of the movement, s."""
        return float(self.seconds[-1])

    def seconds_of(self, recorded: Nanoseconds) -> Array:
        """When what the recorder received at its times (N,), ns, was true: s from the first sample, as the movement."""
        if self.rough is not None:
            _, recorded = self.rough.placed(recorded)
        order = np.argsort(self.recorded, kind="stable")
        first = self.recorded[order[0]]
        return np.interp(recorded - first, self.recorded[order] - first, self.seconds[order])

    def recording(self, begin_s: float, end_s: float) -> Recording:
        """One part of it as a recording, with the doubts of this part.

        Poses that leap are left out. A frame holds its latest pose while the task says so (`unseen`), or its
        place in the hand. Before its first
        observation a frame is not visible, unless that comes within 0.5 s of the first sample: then the frame counts
        as seen from the start. Joints are interpolated between their messages.

        Parameters
        ----------
        begin_s, end_s
            its first and last time, s from the first sample of the movement

        Returns
        -------
        Recording
            its times begin at 0 with its first sample

        Raises
        ------
        BagError
            there is no sample in it, most of its poses leap, a frame is seen too late, or joints do not cover it.
        """
        first, stop = np.searchsorted(self.seconds, [begin_s - ROUNDING_S, end_s + ROUNDING_S])
        if first == stop:
            raise BagError(self.path, f"the movement has no samples from {begin_s:.2f} to {end_s:.2f} s")
        begin, end = self.times[MOVEMENT][first], self.times[MOVEMENT][stop - 1]
        notes, doubts = [], []
        series: dict[str, tuple[Nanoseconds, Array]] = {}
        is_timed = bool(len(self.recorded))
        tracking = TrackingConfig(**self.task.tracking)
        limits = tracking.motion
        for name, ns in self.times.items():
            if name == JOINTS:
                continue
            ns, values = _within(ns, self.values[name], begin, end, name == MOVEMENT)
            if is_timed:
                topic = self.topics[name]
                doubts += _doubts_of_rate(topic, (ns, values), name == MOVEMENT)
                if len(ns):
                    ns, values, leaps = without_leaps(self.path, topic, ns, values, _in_its_unit(limits, values))
                    notes += leaps
            series[name] = ns, values
        at, movement = series[MOVEMENT]
        frames: dict[str, Array] = {}
        stretches: dict[str, Array] = {}
        visible: dict[str, NDArray[np.bool_]] = {}
        for name in self.task.frames:
            if name in self.fixed:
                frames[name], visible[name] = np.tile(self.fixed[name], (len(at), 1)), np.ones(len(at), bool)
                continue
            if not len(series[name][0]):
                raise BagError(
                    self.path,
                    f"{self.topics[name]} was first seen after the movement had ended; publish the "
                    f"frame {name!r} before the demonstration starts",
                )
            unknown_after = self.task.frames[name].unknown_after
            which, visible[name] = last_seen(series[name][0], at, unknown_after)
            frames[name], axes = divided(series[name][1][which])
            if axes is not None:
                stretches[name] = axes
            if self.task.frames[name].with_hand:
                frames[name], moved = carried_poses(
                    at,
                    movement,
                    series[name][0],
                    divided(series[name][1])[0],
                    frames[name],
                    tracking.visible_timeout,
                    self._gripper(name),
                )
                if moved.any():
                    notes.append(f"{name}: not seen, but moving with the hand, in {moved.sum()} of {len(at)} samples")
            unseen, first = np.count_nonzero(~visible[name]), int(np.argmax(visible[name]))
            if first:
                notes.append(f"{name}: not seen in the first {first} of {len(at)} samples")
            if unseen > first:
                notes.append(
                    f"{name}: not known in {unseen - first} of {len(at)} samples, {unknown_after:g} s after it was "
                    "last seen"
                )
        return Recording(
            self.path,
            (at - at[0]) * 1e-9,
            movement,
            frames,
            visible,
            tuple(notes),
            self._configurations(at),
            self.task.derived,
            tuple(doubts),
            stretches=stretches,
        )

    def _gripper(self, name: str) -> tuple[Nanoseconds, NDArray[np.bool_]] | None:
        """When the gripper that may hold a frame told something, and whether it was closed; None: nothing tells it."""
        signal = self.task.frames[name].gripper
        if signal is None:
            return None
        recorded, values = read_numbers(self.path, signal.topic, signal.field)
        seconds = self.seconds_of(recorded)
        order = np.argsort(seconds, kind="stable")
        at = self.times[MOVEMENT][0] + np.round(SECOND * seconds[order]).astype(np.int64)
        return at, signal.holds(values[order])

    def _configurations(self, at: Nanoseconds) -> Array | None:
        """Positions (T, n) of the joints at these times (T,), ns; None for tasks without joints."""
        if JOINTS not in self.times:
            return None
        seen = self.times[JOINTS]
        missed = 1e-9 * max(seen[0] - at[0], at[-1] - seen[-1])
        if missed > START_TOLERANCE_S:
            raise BagError(
                self.path,
                f"{self.topics[JOINTS]} does not cover the movement, by {missed:.1f} s; record both all the time",
            )
        return np.column_stack([np.interp(at, seen, column) for column in self.values[JOINTS].T])


def _within(ns: Nanoseconds, values: Array, begin: int, end: int, moves: bool) -> tuple[Nanoseconds, Array]:
    """What was seen between two times; of a frame also the last before, which stands for where it was then."""
    first, stop = int(np.searchsorted(ns, begin)), int(np.searchsorted(ns, end, side="right"))
    if not moves and (first == len(ns) or ns[first] > begin):
        first = max(0, first - 1)
    return ns[first:stop], values[first:stop]


def _in_its_unit(limits: MotionLimits, poses: Array) -> MotionLimits:
    """Limits for poses (T, 7) that look like millimetres: these are doubted as such, and do not leap."""
    low, high = np.quantile(poses[:, :3], (0.05, 0.95), axis=0)
    return limits if np.linalg.norm(high - low) <= LARGEST_M else replace(limits, speed=1000.0 * limits.speed)


def _doubts_of_rate(topic: str, series: tuple[Nanoseconds, Array], moves: bool) -> list[Doubt]:
    """Pauses of a topic: of the movement, and of frames that are elsewhere after the pause."""
    ns, values = series
    found = []
    for begin, length in gaps(ns, GAP_S if moves else FRAME_GAP_S, GAP_PERIODS):
        k = int(np.searchsorted(ns, ns[0] + round(SECOND * begin)))
        if moves or not np.allclose(values[k], values[k + 1], atol=MOVED):
            where = f"{topic} pauses for {length:.2f} s, {begin:.2f} s after its first message"
            goes_on = float(np.linalg.norm(values[k + 1, :3] - values[k, :3])) < GOES_ON_M
            what = "what happened there is not known"
            if goes_on:
                what = "it goes on where it was: it rested, or a clock was set forward"
            found.append(Doubt("gap", (), f"{where}; {what}"))
    return found[:3]
