# SPDX-License-Identifier: Apache-2.0
"""Bags to demonstrations: one clock, every frame at every sample of the movement, one common duration."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from tpgmm_core import Demonstration
from tpgmm_core.common.text import listed
from tpgmm_core.doubt.clocks import ClockError, CommonClock, TopicTimes, common_clock, gaps
from tpgmm_core.doubt.doubts import Doubt
from tpgmm_core.doubt.values import LARGEST_M
from tpgmm_core.geometry import quaternion
from tpgmm_core.observation.gate import MotionLimits
from tpgmm_core.observation.streams import SECOND
from tpgmm_core.observation.tracking import TrackingConfig
from tpgmm_ros.messages.sources import JointStateSource, PoseStampedSource, Source
from tpgmm_ros.recordings.bag_messages import Array, BagError, Nanoseconds, Stream
from tpgmm_ros.recordings.edits import SUFFIX, Edits
from tpgmm_ros.recordings.finding import find_bags, join_parts
from tpgmm_ros.recordings.joint_movement import read_link_stream
from tpgmm_ros.recordings.joint_streams import read_joint_stream
from tpgmm_ros.recordings.pose_arrays import read_pose_array
from tpgmm_ros.recordings.pose_streams import read_pose_streams, without_leaps
from tpgmm_ros.recordings.recording import Recording, align
from tpgmm_ros.recordings.storage.bag_reader import parts_of
from tpgmm_ros.task.task_file import PoseArraySpec, Task

__all__ = [
    "BagError",
    "Recording",
    "align",
    "find_bags",
    "join_parts",
    "read_demonstration",
    "read_demonstrations",
    "read_recording",
    "read_recordings",
]

MIN_SAMPLES = 10
"""Fewer samples of a movement are no demonstration of one."""

MOVEMENT = "the movement"
JOINTS = "the joints"
"""Names of the movement and of the joints among the streams; no frame's name has a space."""

START_TOLERANCE_S = 0.5
"""Topics start in any order when a recorder is switched on: a frame seen so soon was there all along."""

GAP_S = 0.5
FRAME_GAP_S = 1.0
GAP_PERIODS = 10.0
"""A pause of a topic is said where it is longer than this time, and than so many of its periods."""

MOVED = 0.005
"""A frame whose numbers change by less has not moved, m."""


def read_recording(path: str | Path, task: Task, every: int = 1) -> Recording:
    """Read one bag, as the task says it was recorded: streams of poses, or one PoseArray.

    Poses that are none, or that leap, are left out and counted in a note. Of streams, times are the header stamps when
    those of all topics are sane (not zero, never backwards), else the times of the recorder for all topics; a note
    says when, and doubts say what was put right (see `tpgmm_core.doubt.clocks`). Messages that repeat a stamp are
    dropped, and counted in a note. A frame holds its latest pose, however long ago that was seen, unless the task says
    after which time it is not known any more. Before its first
    observation a frame is not visible, unless that observation comes within 0.5 s of the first sample: then the frame
    counts as seen from the start. Joints are interpolated between their messages. Of a PoseArray, times are the numbers
    of the poses times `period`, and frames stand still. Edits beside the bag cut it (see `edits`).

    Parameters
    ----------
    path
        a bag
    task
        names the topics, the frames and the base frame
    every
        keep every n-th sample of the movement, and the last one

    Returns
    -------
    Recording
        the recording

    Raises
    ------
    BagError
        anything that is wrong with the bag.
    """
    path = path if isinstance(path, Path) else Path(path)
    recording = _from_streams(path, task) if task.recordings is None else _from_pose_array(path, task, task.recordings)
    recording = _edited(recording, Edits.of(path))
    if len(recording.times) < MIN_SAMPLES:
        raise BagError(
            path,
            f"the movement has {len(recording.times)} samples, expected at least {MIN_SAMPLES}; "
            "record the whole movement",
        )
    others = parts_of(path)[1:]
    if others:
        note = f"goes on in {listed([part.name for part in others])}: parts of one recording, read as one"
        recording = replace(recording, notes=(note, *recording.notes))
    return recording if every == 1 else _thinned(recording, every)


def _edited(recording: Recording, edits: Edits) -> Recording:
    """What the file beside the bag says that counts."""
    kept = np.flatnonzero((recording.times >= edits.begin_s) & (recording.times <= edits.end_s))
    if len(kept) == len(recording.times):
        return recording
    if not len(kept):
        raise BagError(
            recording.path,
            f"its edits begin at {edits.begin_s:g} s, and its movement ends after {recording.duration:.2f} s: correct "
            f"{recording.path.name}{SUFFIX}",
        )
    left = recording.at(kept)
    first, last = edits.begin_s, min(edits.end_s, recording.duration)
    note = f"cut to {first:.2f} to {last:.2f} s of {recording.duration:.2f} s, as its edits say"
    return replace(left, notes=(*left.notes, note))


def _thinned(recording: Recording, every: int) -> Recording:
    """Every n-th sample, and the last one."""
    last = len(recording.times) - 1
    return recording.at(np.unique(np.append(np.arange(0, last + 1, every), last)))


def _from_pose_array(path: Path, task: Task, spec: PoseArraySpec) -> Recording:
    stream, places = read_pose_array(path, spec, list(task.sources), task.base_frame)
    movement, numbers = stream.values, stream.stamps // round(spec.period * SECOND)
    places |= {name: np.array(frame.pose) for name, frame in task.frames.items() if frame.pose is not None}
    T = len(movement)
    notes = list(stream.notes)
    if T > 1 and (movement[:, 3:] == quaternion.IDENTITY).all():
        notes.append("every orientation is 0 0 0 1: none was recorded; what a model says of it means nothing")
    return Recording(
        path,
        spec.period * (numbers - numbers[0]).astype(float),
        movement,
        {name: np.tile(places[name], (T, 1)) for name in task.frames},
        {name: np.ones(T, bool) for name in task.frames},
        tuple(notes),
        derived=task.derived,
    )


def _from_streams(path: Path, task: Task) -> Recording:
    streams, fixed = read_pose_streams(path, _sources(task), task.base_frame)
    if isinstance(task.recorded_movement, JointStateSource):
        streams[MOVEMENT] = read_link_stream(path, task.recorded_movement, task.base_frame)
    names = task.space.joints()
    joints = read_joint_stream(path, task.space.joint_states, names) if names else None
    clock = _clock(path, streams if joints is None else {**streams, JOINTS: joints})
    notes, doubts = list(clock.notes), list(clock.doubts)
    series: dict[str, tuple[Nanoseconds, Array]] = {}
    limits = TrackingConfig(**task.tracking).motion
    for name, stream in streams.items():
        notes += stream.notes
        ns, values = clock.times[name], stream.values[clock.kept[name]]
        fresh = np.diff(ns, prepend=ns[0] - 1) > 0
        if not fresh.all():
            notes.append(f"{stream.topic}: {np.count_nonzero(~fresh)} messages with repeated stamps dropped")
        doubts += _doubts_of_rate(stream.topic, (ns[fresh], values[fresh]), name == MOVEMENT)
        kept, poses, leaps = without_leaps(path, stream.topic, ns[fresh], values[fresh], _in_its_unit(limits, values))
        series[name] = kept, poses
        notes += leaps

    ns, movement = series[MOVEMENT]
    frames: dict[str, Array] = {}
    visible: dict[str, NDArray[np.bool_]] = {}
    for name, spec in task.frames.items():
        if name not in series:
            pose = fixed[name] if spec.pose is None else np.array(spec.pose)
            frames[name], visible[name] = np.tile(pose, (len(ns), 1)), np.ones(len(ns), bool)
            continue
        frames[name], visible[name] = _hold(*series[name], ns, spec.unknown_after)
        if not visible[name].any():
            raise BagError(
                path,
                f"{streams[name].topic} was first seen after the movement had ended; publish the "
                f"frame {name!r} before the demonstration starts",
            )
        unseen, first = np.count_nonzero(~visible[name]), int(np.argmax(visible[name]))
        if first:
            notes.append(f"{name}: not seen in the first {first} of {len(ns)} samples")
        if unseen > first:
            notes.append(
                f"{name}: not known in {unseen - first} of {len(ns)} samples, {spec.unknown_after:g} s after it was "
                "last seen"
            )
    configurations = None
    if joints is not None:
        configurations = _configurations(path, joints, joints.values[clock.kept[JOINTS]], clock.times[JOINTS], ns)
    times, derived = (ns - ns[0]) * 1e-9, task.derived
    return Recording(path, times, movement, frames, visible, tuple(notes), configurations, derived, tuple(doubts))


def _sources(task: Task) -> dict[str, Source]:
    """Where the movement and the frames are in a recording, but for a movement of joints."""
    movement = task.recorded_movement or PoseStampedSource(task.movement)
    return ({} if isinstance(movement, JointStateSource) else {MOVEMENT: movement}) | task.sources


def _clock(path: Path, streams: Mapping[str, Stream]) -> CommonClock:
    """When all that is in these streams was true."""
    times = {name: TopicTimes(name, s.topic, s.stamps, s.recorded) for name, s in streams.items()}
    try:
        return common_clock(times.pop(MOVEMENT), list(times.values()))
    except ClockError as error:
        raise BagError(path, str(error)) from None


def _in_its_unit(limits: MotionLimits, poses: Array) -> MotionLimits:
    """Limits for poses (T, 7) that look like millimetres: these are doubted as such, and do not leap."""
    low, high = np.quantile(poses[:, :3], (0.05, 0.95), axis=0)
    return limits if np.linalg.norm(high - low) <= LARGEST_M else replace(limits, speed=1000.0 * limits.speed)


def _doubts_of_rate(topic: str, series: tuple[Nanoseconds, Array], moves: bool) -> list[Doubt]:
    """Pauses of a topic: of the movement, and of frames that are elsewhere after the pause."""
    ns, values = series
    found = []
    for begin, length in gaps(ns, GAP_S if moves else FRAME_GAP_S, GAP_PERIODS):
        k = int(np.searchsorted(ns, ns[0] + round(1e9 * begin)))
        if moves or not np.allclose(values[k], values[k + 1], atol=MOVED):
            where = f"{topic} pauses for {length:.2f} s, {begin:.2f} s after its first message"
            found.append(Doubt("gap", (), f"{where}; what happened there is not known"))
    return found[:3]


def _configurations(path: Path, joints: Stream, values: Array, seen: Nanoseconds, at: Nanoseconds) -> Array:
    """Positions (S, n) of joints at these times (S,), ns, from those (T, n) seen at times (T,)."""
    missed = 1e-9 * max(seen[0] - at[0], at[-1] - seen[-1])
    if missed > START_TOLERANCE_S:
        raise BagError(path, f"{joints.topic} does not cover the movement, by {missed:.1f} s; record both all the time")
    return np.column_stack([np.interp(at, seen, column) for column in values.T])


def _hold(
    seen: Nanoseconds, poses: Array, at: Nanoseconds, unknown_after: float | None
) -> tuple[Array, NDArray[np.bool_]]:
    """Latest of the poses (S, 7) seen (S,) at or before each time (T,): poses (T, 7), and mask (T,) where.

    Later than `unknown_after`, s, the pose is not known any more; None: it is for ever.
    """
    latest = np.searchsorted(seen, at, side="right") - 1
    visible = latest >= 0
    if seen[0] - at[0] <= START_TOLERANCE_S * 1e9:
        visible[:] = True
    if unknown_after is not None:
        visible &= (at - seen[np.maximum(latest, 0)]) * 1e-9 <= unknown_after
    return poses[np.maximum(latest, 0)], visible


def read_recordings(
    paths: Sequence[str | Path], task: Task, every: int = 1, progress: Callable[[Path], None] | None = None
) -> tuple[list[Recording], list[BagError]]:
    """Read several bags.

    Parameters
    ----------
    paths
        of the bags
    task
        what they are for
    every
        keep every n-th sample of the movement, and the last one
    progress
        called after each bag

    Returns
    -------
    tuple[list[Recording], list[BagError]]
        the good ones, and what is wrong with the others
    """
    good: list[Recording] = []
    bad: list[BagError] = []
    for given in paths:
        path = given if isinstance(given, Path) else Path(given)  # a BagPath stays one
        try:
            good.append(read_recording(path, task, every))
        except BagError as error:
            bad.append(error)
        if progress is not None:
            progress(path)
    return good, bad


def read_demonstration(path: str | Path, task: Task) -> Demonstration:
    """Read one bag as a demonstration with its own duration; see `read_recording`."""
    return read_recording(path, task).to_demonstration()


def read_demonstrations(
    paths: Sequence[str | Path], task: Task, progress: Callable[[Path], None] | None = None
) -> tuple[list[Demonstration], float]:
    """Read bags as demonstrations of one duration. See `read_recording`.

    Parameters
    ----------
    paths
        of the bags
    task
        what they are for
    progress
        called after each bag

    Returns
    -------
    tuple[list[Demonstration], float]
        demonstrations, and their mean duration, s

    Raises
    ------
    BagError
        the first bad bag; the others stand in its notes.
    """
    good, bad = read_recordings(paths, task, progress=progress)
    if bad:
        for other in bad[1:]:
            bad[0].add_note(str(other))
        raise bad[0]
    return align(good)
