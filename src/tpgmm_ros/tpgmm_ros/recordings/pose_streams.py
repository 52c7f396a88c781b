# SPDX-License-Identifier: Apache-2.0
"""Poses out of one bag, from the sources that a task names; what is no pose is left out, counted and said."""

from array import array
from collections.abc import Mapping, Sequence
from pathlib import Path
from sys import intern
from typing import Any, NamedTuple

import numpy as np

from tpgmm_core.common.text import listed, shown
from tpgmm_core.common.types import Array, Nanoseconds
from tpgmm_core.doubt.doubts import Doubt
from tpgmm_core.doubt.ends import doubts_of_ends
from tpgmm_core.geometry.pose import compose
from tpgmm_core.observation.poses import ROUNDING, check_poses, doubtful_units, never_filled, wrong_frame
from tpgmm_core.observation.transforms import NO_TRANSFORM, NO_TRANSFORM_YET, TransformError
from tpgmm_ros.messages.sources import Source, TopicSource, TransformSource
from tpgmm_ros.recordings.bag_messages import MOST_BAD, BagError, Stream, take_messages
from tpgmm_ros.recordings.storage.message_types import quick_decoder
from tpgmm_ros.recordings.transforms import RecordedTransforms


class PoseStreams(NamedTuple):
    """What a bag says of the things that a task names.

    Parameters
    ----------
    moving
        poses by name
    fixed
        poses (7,) of those that only static transforms lead to
    notes
        what is odd in the transforms that lead to these, in words
    doubts
        about the transforms that lead to any of them
    """

    moving: dict[str, Stream]
    fixed: dict[str, Array]
    notes: tuple[str, ...] = ()
    doubts: tuple[Doubt, ...] = ()


def read_pose_streams(path: Path, sources: Mapping[str, Source], base_frame: str) -> PoseStreams:
    """Read the poses that a bag holds of several things.

    Topics are relative names. A bag recorded inside a namespace is understood when the namespace is the only
    one in which all of the topics exist. Poses in other frames are transformed by what the bag holds on /tf and
    /tf_static.

    Parameters
    ----------
    path
        of the bag
    sources
        name → where its poses are
    base_frame
        the frame that all poses are returned in

    Returns
    -------
    PoseStreams
        poses (T, 7) by name: x, y, z in m, qx, qy, qz, qw, unit quaternions of continuous sign; where a source says
        more than a pose, with the nine numbers of its stretch beside them (see `divided`)

    Raises
    ------
    BagError
        the bag is damaged or incomplete, a topic is absent, empty or of another type, or most of its poses cannot be
        used.
    """
    transforms = RecordedTransforms(path)
    moving: dict[str, Stream] = {}
    fixed: dict[str, Array] = {}
    kinds: dict[str, dict[str, list[_Seen]]] = {}
    seen: dict[str, _Seen] = {}
    for name, source in sources.items():
        if not isinstance(source, TransformSource):
            seen[name] = _Seen(source)
            kinds.setdefault(source.message_type, {}).setdefault(source.topic, []).append(seen[name])
    names: dict[str, str] = {}
    for kind, topics in kinds.items():

        def take(topic: str, at: int, message: object, topics: dict[str, list[_Seen]] = topics) -> None:
            for one in topics[topic]:
                one.take(at, message)

        names |= take_messages(path, topics, kind, take, quick_decoder)
    for name, source in sources.items():
        if isinstance(source, TransformSource):
            found = transforms.stream(source)
            if isinstance(found, Stream):
                moving[name] = found
            else:
                fixed[name] = found
        else:
            moving[name] = seen[name].stream(path, names[source.topic], base_frame, transforms)
    return PoseStreams(moving, fixed, transforms.notes if fixed else (), transforms.doubts)


class _Seen:
    """What a source has observed, as numbers: the messages themselves take ten times the memory."""

    def __init__(self, source: TopicSource) -> None:
        self.source, self.messages = source, 0
        self.stamps, self.recorded, self.numbers = array("q"), array("q"), array("d")
        self.stretches = array("d")
        self.frame_ids: list[str] = []
        self.fault = ""

    def take(self, at: int, message: Any) -> None:
        """A message, with the time of the recorder, ns."""
        self.messages += 1
        if type(message) is tuple:  # a StampedPose
            stamp_ns, frame_id, pose = message
        elif (observation := self.source.read(message)) is not None and not observation.fault:
            stamp_ns, frame_id, pose = observation.stamp_ns, intern(observation.frame_id), observation.pose
            if observation.stretch is not None:
                self.stretches.extend(observation.stretch.ravel())
        else:
            self.fault = self.fault or ("" if observation is None else observation.fault)
            return
        self.stamps.append(stamp_ns)
        self.recorded.append(at)
        self.numbers.extend(pose)
        self.frame_ids.append(frame_id)

    def stream(self, path: Path, topic: str, base_frame: str, transforms: RecordedTransforms) -> Stream:
        """The poses of it, on a topic of a bag, in the base frame."""
        if self.fault:
            raise BagError(path, f"{topic}: {self.fault}. Correct what publishes it, and record again")
        if not self.stamps:
            raise BagError(
                path,
                f"{topic} never holds {self.source.selection}, in {self.messages} messages; correct the entry of the "
                "task file",
            )
        stamps, recorded = np.array(self.stamps, np.int64), np.array(self.recorded, np.int64)
        seen = Observed(stamps, self.frame_ids, np.array(self.numbers).reshape(-1, 7))
        poses, good, notes = usable_poses(path, topic, seen, base_frame, transforms)
        if self.stretches:
            poses = np.hstack([poses, np.array(self.stretches).reshape(-1, 9)[good]])
        return Stream(topic, stamps[good], recorded[good], poses, notes, doubts_of_ends(topic, recorded, good))


def divided(values: Array) -> tuple[Array, Array | None]:
    """Poses (T, 7) of a stream, and its stretches (T, 3, 3), where it has some; see `Frame.from_pose`."""
    return values[:, :7], values[:, 7:].reshape(-1, 3, 3) if values.shape[1] > 7 else None


class Observed(NamedTuple):
    """Observations, each as it came.

    Parameters
    ----------
    stamps
        (T,) ns
    frame_ids
        T
    numbers
        (T, 7) of poses
    """

    stamps: Nanoseconds
    frame_ids: Sequence[str]
    numbers: Array


def usable_poses(
    path: Path,
    topic: str,
    observed: Observed,
    base_frame: str,
    transforms: RecordedTransforms | None = None,
) -> tuple[Array, np.ndarray, tuple[str, ...]]:
    """Those of some observations that are poses in the base frame.

    Parameters
    ----------
    path, topic
        where they are from, for errors
    observed
        T of them
    base_frame
        the frame that they are to be in
    transforms
        what leads there from other frames; None: nothing

    Returns
    -------
    tuple[Array, np.ndarray, tuple[str, ...]]
        poses (n, 7) with unit quaternions of continuous sign; which (T,) these are; notes

    Raises
    ------
    BagError
        most of them cannot be used, with the reason of the most frequent fault.
    """
    numbers, frame_ids = observed.numbers, np.array(observed.frame_ids, dtype=object)
    poses, good, reasons = check_poses(numbers)
    notes: list[str] = []
    if (empty := good & never_filled(numbers)).any():
        good = good & ~empty
        first = f"number {int(np.argmax(empty))}: never filled in: at 0 0 0 as in an empty message, unlike the others"
        reasons["never filled in"] = int(np.count_nonzero(empty)), first
    for frame_id in sorted(set(frame_ids.tolist())):
        if not (reason := wrong_frame(frame_id, base_frame)):
            continue
        there = good & (frame_ids == frame_id)
        moved = 0
        for k in np.flatnonzero(there).tolist():
            try:
                if transforms is None or not frame_id:
                    raise TransformError(reason)
                place = transforms.pose(frame_id, base_frame, int(observed.stamps[k]))
            except TransformError as error:
                good[k] = False
                kind = reason if str(error).startswith(NO_TRANSFORM) else str(error)
                count, first = reasons.get(kind.split(":", 1)[0], (0, f"number {k}: {kind}"))
                reasons[kind.split(":", 1)[0]] = count + 1, first
                continue
            poses[k] = compose(place, poses[k])
            moved += 1
        if moved and transforms is not None:
            notes += transforms.notes
            notes.append(f"{topic}: {moved} poses in {shown(frame_id)} transformed to {shown(base_frame)} by /tf")
    bad = len(good) - int(np.count_nonzero(good))
    if bad > MOST_BAD * len(good):
        raise BagError(path, _mostly_bad(topic, len(good), reasons, sorted(set(frame_ids.tolist())), base_frame))
    notes += [
        f"{topic}: {count} of {len(good)} poses left out, the first is {first}" for count, first in reasons.values()
    ]
    odd = int(np.count_nonzero(abs(np.linalg.norm(numbers[good, 3:], axis=1) - 1.0) > ROUNDING))
    if odd:
        notes.append(f"{topic}: {odd} of {len(good)} quaternions have other lengths than 1 and were scaled")
    if doubt := doubtful_units(poses[good, :3]):
        notes.append(f"{topic} {doubt}")
    return poses[good], good, tuple(notes)


def _mostly_bad(
    topic: str, total: int, reasons: dict[str, tuple[int, str]], frame_ids: list[str], base_frame: str
) -> str:
    kind, (count, first) = max(reasons.items(), key=lambda item: item[1][0])
    if kind == "wrong frame_id":
        foreign = [frame_id for frame_id in frame_ids if wrong_frame(frame_id, base_frame)]
        return (
            f"{topic} has poses in the frame {listed(foreign, 5)}, expected the base frame {base_frame!r}; transform "
            "them before recording, record /tf and /tf_static with them, or correct base_frame in the task file"
        )
    bad = f"{topic} has {count} of {total} poses that cannot be used, the first is {first}"
    if kind == NO_TRANSFORM_YET:
        return f"{bad}. Publish that transform all the time, or on /tf_static if it never changes, and record it again"
    return f"{bad}. Correct what publishes it, and record again"
