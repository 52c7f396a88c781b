# SPDX-License-Identifier: Apache-2.0
"""`RecordedBag`: what a bag holds of a task; its parts have clocks of their own where the bag has not one for all."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

import numpy as np

from tpgmm_core.common.types import Array
from tpgmm_core.doubt.clocks import ClockError, CommonClock, common_clock
from tpgmm_core.doubt.rough_clock import RoughClock
from tpgmm_core.doubt.stamps import TopicTimes
from tpgmm_core.geometry import quaternion
from tpgmm_core.observation.poses import doubtful_units
from tpgmm_core.observation.streams import SECOND
from tpgmm_ros.messages.sources import JointStateSource, PoseStampedSource, Source
from tpgmm_ros.recordings.bag_messages import BagError, Stream
from tpgmm_ros.recordings.bag_streams import JOINTS, MOVEMENT, ROUNDING_S, BagStreams
from tpgmm_ros.recordings.joint_movement import read_link_stream
from tpgmm_ros.recordings.joint_streams import read_joint_stream
from tpgmm_ros.recordings.pose_arrays import read_pose_array
from tpgmm_ros.recordings.pose_streams import read_pose_streams
from tpgmm_ros.recordings.recording import Recording
from tpgmm_ros.task.recordings_section import PoseArraySpec
from tpgmm_ros.task.task_file import Task

BEFORE_S, AFTER_S = 1.0, 1.25
"""What other topics said so long before and after a part tells how its clocks go."""


class RecordedBag:
    """What a bag holds of a task.

    Parameters
    ----------
    path
        the bag
    task
        that it is of

    Attributes
    ----------
    streams
        all of it on one time, on which takes are found; a rough one where the clocks of the bag do not hold together
    notes
        of the whole bag, in words

    Raises
    ------
    BagError
        the bag cannot be read.
    """

    def __init__(self, path: Path, task: Task) -> None:
        self.path = path
        self._problem: BagError | None = None
        self._recorded: Mapping[str, Stream] = {}
        if task.recordings is not None:
            self.streams = _of_array(path, task, task.recordings)
            self.notes = self.streams.notes
            return
        recorded, fixed = _read(path, task)
        self._rough = RoughClock.of(recorded[MOVEMENT].recorded)
        try:
            self.streams, by_recorder = on_one_clock(path, task, recorded, fixed)
            self.notes = self.streams.notes
            by_part = by_recorder and len(self._rough.begins) == 1
        except ClockError as error:
            self._problem = BagError(path, str(error))
            self.streams = self._on_rough_clock(path, task, recorded, fixed)
            by_part = True
        if by_part:
            self._recorded = recorded
            self.notes = tuple(dict.fromkeys(note for stream in recorded.values() for note in stream.notes))

    def recording(self, begin_s: float, end_s: float) -> Recording:
        """A part of it as a recording: see `BagStreams.recording`.

        Parameters
        ----------
        begin_s, end_s
            its first and last time, s from the first sample of `streams`

        Returns
        -------
        Recording
            with the notes and doubts of this part

        Raises
        ------
        BagError
            the clocks do not hold together within this part, or like `BagStreams.recording`.
        """
        is_whole = begin_s <= ROUNDING_S and end_s >= self.streams.duration_s - ROUNDING_S
        if is_whole and self._problem is not None:
            raise self._problem
        if not self._recorded:
            found = self.streams.recording(begin_s, end_s)
            return replace(found, doubts=(*self.streams.doubts, *found.doubts))
        recorded = self._recorded if is_whole else self._part(begin_s, end_s)
        stripped = {name: replace(stream, notes=()) for name, stream in recorded.items()}
        try:
            part, _ = on_one_clock(self.path, self.streams.task, stripped, self.streams.fixed)
        except ClockError as error:
            raise BagError(self.path, str(error)) from None
        found = part.recording(0.0, part.duration_s)
        return replace(found, notes=(*part.notes, *found.notes), doubts=(*part.doubts, *found.doubts))

    def _on_rough_clock(
        self, path: Path, task: Task, recorded: Mapping[str, Stream], fixed: Mapping[str, Array]
    ) -> BagStreams:
        """The movement alone, at rough times."""
        movement = recorded[MOVEMENT]
        _, times = self._rough.placed(movement.recorded)
        order = np.argsort(times, kind="stable")
        order = order[np.diff(times[order], prepend=times[order][0] - 1) > 0]
        at = times[order]
        values, topics = {MOVEMENT: movement.values[order]}, {MOVEMENT: movement.topic}
        return BagStreams(path, task, {MOVEMENT: at}, values, topics, fixed, at, rough=self._rough)

    def _part(self, begin_s: float, end_s: float) -> dict[str, Stream]:
        """Messages of the movement within a part, and those of the others that go with it."""
        origin = int(self.streams.times[MOVEMENT][0])
        begin, end = (origin + round(SECOND * (at + by)) for at, by in ((begin_s, -ROUNDING_S), (end_s, ROUNDING_S)))
        parts, times = self._rough.placed(self._recorded[MOVEMENT].recorded)
        mine = np.flatnonzero((times >= begin) & (times <= end))
        if not len(mine):
            raise BagError(self.path, f"the movement has no samples from {begin_s:.2f} to {end_s:.2f} s")
        found = {MOVEMENT: _taken(self._recorded[MOVEMENT], mine)}
        first = found[MOVEMENT]
        for name, stream in self._recorded.items():
            if name == MOVEMENT:
                continue
            number, at = self._rough.placed(stream.recorded)
            same = (number >= parts[mine[0]]) & (number <= parts[mine[-1]])
            which = np.flatnonzero(same & (at >= begin - BEFORE_S * SECOND) & (at <= end + AFTER_S * SECOND))
            earlier = np.flatnonzero(at <= (at[which[0]] - 1 if len(which) else begin))
            if not len(earlier):
                found[name] = _taken(stream, which if len(which) else np.array([0]))
                continue
            last = int(earlier[-1])
            taken = _taken(stream, np.append(last, which).astype(np.intp))
            if number[last] < parts[mine[0]]:  # by another clock: it stood where it was
                taken.stamps[0] = (min(taken.stamps[1], first.stamps[0]) if len(which) else first.stamps[0]) - 1
                taken.recorded[0] = (min(taken.recorded[1], first.recorded[0]) if len(which) else first.recorded[0]) - 1
            found[name] = taken
        return found


def _taken(stream: Stream, which: np.ndarray) -> Stream:
    return replace(stream, stamps=stream.stamps[which], recorded=stream.recorded[which], values=stream.values[which])


def _read(path: Path, task: Task) -> tuple[dict[str, Stream], dict[str, Array]]:
    """All topics as they were recorded, and poses of frames that do not move."""
    streams, fixed, notes, doubts = read_pose_streams(path, _sources(task), task.base_frame)
    # a frame that is lost at an end stays where it was, or is not seen yet
    streams = {name: s if name == MOVEMENT else replace(s, doubts=()) for name, s in streams.items()}
    if isinstance(task.recorded_movement, JointStateSource):
        streams[MOVEMENT] = read_link_stream(path, task.recorded_movement, task.base_frame)
    if names := task.space.joints():
        streams[JOINTS] = read_joint_stream(path, task.space.joint_states, names)
    movement = streams[MOVEMENT]
    notes = (*movement.notes, *_unturned(movement), *notes, *_far(task))
    streams[MOVEMENT] = replace(movement, notes=notes, doubts=(*movement.doubts, *doubts))
    return streams, {**fixed, **_given(task)}


def _unturned(stream: Stream) -> list[str]:
    """What is said of a movement that has no orientation."""
    if len(stream.values) < 2 or not (stream.values[:, 3:] == quaternion.IDENTITY).all():
        return []
    return ["every orientation is 0 0 0 1: none was recorded; what a model says of it means nothing"]


def _far(task: Task) -> list[str]:
    """What is said of frames whose poses in the task file look like millimetres."""
    said = {name: doubtful_units(pose[:3]) for name, pose in _given(task).items()}
    return [f"the pose of {name} in the task file {doubt}" for name, doubt in said.items() if doubt]


def _of_array(path: Path, task: Task, spec: PoseArraySpec) -> BagStreams:
    """Times are the numbers of the poses times `period`; frames stand still."""
    stream, places = read_pose_array(path, spec, list(task.sources), task.base_frame)
    notes = [*stream.notes, *_unturned(stream)]
    values, topics = {MOVEMENT: stream.values}, {MOVEMENT: stream.topic}
    return BagStreams(
        path, task, {MOVEMENT: stream.stamps}, values, topics, {**places, **_given(task)}, notes=tuple(notes)
    )


def _given(task: Task) -> dict[str, Array]:
    return {name: np.array(frame.pose) for name, frame in task.frames.items() if frame.pose is not None}


def _sources(task: Task) -> dict[str, Source]:
    """Where the movement and the frames are in a recording, but for a movement of joints."""
    movement = task.recorded_movement or PoseStampedSource(task.movement)
    return ({} if isinstance(movement, JointStateSource) else {MOVEMENT: movement}) | task.sources


def on_one_clock(
    path: Path, task: Task, streams: Mapping[str, Stream], fixed: Mapping[str, Array]
) -> tuple[BagStreams, bool]:
    """Streams of a bag on the clock that they have in common.

    Parameters
    ----------
    path, task
        the bag, and what it is of
    streams
        as recorded
    fixed
        poses (7,) of frames that do not move

    Returns
    -------
    tuple[BagStreams, bool]
        on one clock, and whether it is the recorder's

    Raises
    ------
    ClockError
        there is no such clock.
    """
    clock = _clock(streams)
    times, values, notes = dict(clock.times), {}, list(clock.notes)
    recorded = streams[MOVEMENT].recorded[clock.kept[MOVEMENT]]
    for name, stream in streams.items():
        values[name] = stream.values[clock.kept[name]]
        notes += stream.notes
        if name == JOINTS:
            continue
        fresh = np.diff(times[name], prepend=times[name][0] - 1) > 0
        if not fresh.all():
            notes.append(f"{stream.topic}: {np.count_nonzero(~fresh)} messages with repeated stamps dropped")
        recorded = recorded[fresh] if name == MOVEMENT else recorded
        times[name], values[name] = times[name][fresh], values[name][fresh]
    topics = {name: stream.topic for name, stream in streams.items()}
    doubts = (*clock.doubts, *(doubt for stream in streams.values() for doubt in stream.doubts))
    found = BagStreams(path, task, times, values, topics, fixed, recorded, tuple(dict.fromkeys(notes)), doubts)
    return found, clock.by_recorder


def _clock(streams: Mapping[str, Stream]) -> CommonClock:
    """When all that is in these streams was true."""
    times = {name: TopicTimes(name, s.topic, s.stamps, s.recorded) for name, s in streams.items()}
    return common_clock(times.pop(MOVEMENT), list(times.values()))
