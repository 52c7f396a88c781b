# SPDX-License-Identifier: Apache-2.0
"""What lies in bags of which nobody has told anything: topics, rates, pauses, frames."""

from __future__ import annotations

from array import array
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from tpgmm_core.common.types import Array
from tpgmm_core.doubt.clocks import gaps
from tpgmm_core.geometry import quaternion
from tpgmm_ros.recordings.storage.bag_error import BagError
from tpgmm_ros.recordings.storage.bag_reader import BagReader, BagTopic, check_not_empty
from tpgmm_ros.recordings.storage.message_types import quick_decoder

POSE_STAMPED = "geometry_msgs/msg/PoseStamped"
POSE_ARRAY = "geometry_msgs/msg/PoseArray"
STILL_M, STILL_RAD = 0.01, 0.05
"""What moves by less within a bag, or from bag to bag, stands still."""
LONGEST_GAP_S, GAP_PERIODS = 0.5, 10.0
MOST_POSES = 50_000
"""Of a topic, that are kept to look at."""


@dataclass(frozen=True, slots=True)
class TopicOverview:
    """A topic of one bag.

    Attributes
    ----------
    name, type
        as recorded
    count
        number of messages
    rate_hz
        of the recorder, from the median period; 0 where there are fewer than two messages
    gap_s
        longest pause that is out of proportion; 0 without one
    frame_ids
        of poses
    poses
        (T, 7) of poses, of a long topic some of them, else none
    """

    name: str
    type: str
    count: int
    rate_hz: float = 0.0
    gap_s: float = 0.0
    frame_ids: tuple[str, ...] = ()
    poses: Array = field(default_factory=lambda: np.empty((0, 7)))

    @property
    def path_m(self) -> float:
        """Way from the first to the last pose, in 50 straight pieces, m."""
        if not len(self.poses):
            return 0.0
        at = np.unique(np.linspace(0, len(self.poses) - 1, 51).round().astype(int))
        return float(np.linalg.norm(np.diff(self.poses[at, :3], axis=0), axis=1).sum())

    @property
    def moves(self) -> bool:
        """Whether its poses change within the bag."""
        if not len(self.poses):
            return False
        turned = quaternion.angle_between(self.poses[:1, 3:], self.poses[:, 3:])
        return bool(np.ptp(self.poses[:, :3], axis=0).max() > STILL_M or turned.max() > STILL_RAD)


@dataclass(frozen=True, slots=True)
class BagOverview:
    """One bag: its path, its duration in s by the recorder, and its topics."""

    path: Path
    duration_s: float
    topics: tuple[TopicOverview, ...]


def overview_of(path: Path) -> BagOverview:
    """Look into a bag; messages of topics that hold no poses are not read.

    Returns
    -------
    BagOverview
        what it holds

    Raises
    ------
    BagError
        it cannot be read, or holds no message.
    """
    with BagReader(path) as reader:
        check_not_empty(path, reader.topics)
        topics = tuple(_looked_at(reader, topic) for topic in reader.topics)
        return BagOverview(path, 1e-9 * (reader.last_ns - reader.first_ns), topics)


def _looked_at(reader: BagReader, topic: BagTopic) -> TopicOverview:
    if topic.type not in (POSE_STAMPED, POSE_ARRAY) or not topic.count:
        return TopicOverview(topic.name, topic.type, topic.count)
    seen = _Seen()
    try:
        for _, at, message in reader.messages([topic], quick_decoder):
            seen.take(at, message)
    except BagError:
        return TopicOverview(topic.name, topic.type, topic.count)
    times = np.sort(np.array(seen.times, np.int64))
    periods = 1e-9 * np.diff(times)
    usual = float(np.median(periods)) if len(periods) else 0.0
    found = gaps(times, LONGEST_GAP_S, GAP_PERIODS)
    return TopicOverview(
        topic.name,
        topic.type,
        topic.count,
        1.0 / usual if usual > 0.0 else 0.0,
        found[0][1] if found else 0.0,
        tuple(seen.frame_ids),
        _usable(seen.poses),
    )


class _Seen:
    """Times of the messages of a topic, and its poses; of a long topic some of these, evenly."""

    def __init__(self) -> None:
        self.times, self.frame_ids, self._numbers = array("q"), dict[str, None](), array("d")
        self._count, self._stride = 0, 1

    def take(self, at: int, message: Any) -> None:
        """A message of poses, with the time of the recorder, ns."""
        self.times.append(at)
        if type(message) is tuple:  # a StampedPose
            _, frame_id, pose = message
            self._add(pose)
        else:
            frame_id = message.header.frame_id
            for each in message.poses if hasattr(message, "poses") else [message.pose]:
                p, q = each.position, each.orientation
                self._add((p.x, p.y, p.z, q.x, q.y, q.z, q.w))
        self.frame_ids[frame_id] = None

    def _add(self, pose: Sequence[float]) -> None:
        if self._count % self._stride == 0:
            self._numbers.extend(pose)
            if len(self._numbers) > 7 * MOST_POSES:
                self._numbers = array("d", self.poses[::2].tobytes())
                self._stride *= 2
        self._count += 1

    @property
    def poses(self) -> Array:
        """(T, 7), as they came."""
        return np.array(self._numbers).reshape(-1, 7)


def _usable(poses: Array) -> Array:
    good = np.isfinite(poses).all(axis=1) & (np.linalg.norm(poses[:, 3:], axis=1) > 0.5)
    poses = poses[good]
    poses[:, 3:] = quaternion.normalize(poses[:, 3:])
    return poses
