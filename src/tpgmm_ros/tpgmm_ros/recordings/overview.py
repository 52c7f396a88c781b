# SPDX-License-Identifier: Apache-2.0
"""What lies in bags of which nobody has told anything: topics, rates, pauses, frames, and a task file for them."""

from __future__ import annotations

from array import array
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from tpgmm_core.common.safe_yaml import YamlError
from tpgmm_core.common.types import Array
from tpgmm_core.common.yaml_sections import Section
from tpgmm_core.common.yaml_values import is_name
from tpgmm_core.doubt.clocks import gaps
from tpgmm_core.doubt.values import LARGEST_M
from tpgmm_core.geometry import quaternion
from tpgmm_ros.messages.sources import SOURCES, TF_MESSAGE, TF_STATIC, short_type
from tpgmm_ros.recordings.joint_streams import JOINT_STATE
from tpgmm_ros.recordings.storage.bag_error import BagError
from tpgmm_ros.recordings.storage.bag_reader import BagReader, BagTopic, check_not_empty
from tpgmm_ros.recordings.storage.message_types import quick_decoder

FRAMES_FILE = "frames.yaml"
POSE_STAMPED = "geometry_msgs/msg/PoseStamped"
POSE_ARRAY = "geometry_msgs/msg/PoseArray"
OTHER_SOURCES = {
    short_type(TF_MESSAGE): "{tf: FRAME}",
    short_type(JOINT_STATE): "recordings: {movement: {joint_states: TOPIC, robot: FILE, link: LINK}}",
}
"""Sources that a task file names otherwise than by topic and type."""
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


@dataclass(frozen=True, slots=True)
class SuggestedTask:
    """A task file for bags: its text, or why there is none; and what to look at in it."""

    text: str
    reason: str = ""
    hints: tuple[str, ...] = ()


def suggested_task(bags: Sequence[BagOverview]) -> SuggestedTask:
    """Suggest a task file: the movement is what goes furthest, frames are the other poses, best those that vary.

    Parameters
    ----------
    bags
        one or more

    Returns
    -------
    SuggestedTask
        the text of a task file, which is to be looked at before it is used
    """
    common = [t.name for t in bags[0].topics if all(t.name in {o.name for o in bag.topics} for bag in bags)]
    stamped = [name for name in common if _all_of(bags, name, POSE_STAMPED)]
    arrays = [name for name in common if _all_of(bags, name, POSE_ARRAY)]
    others = _other_sources(bags)
    if not stamped and not arrays:
        reason = "no topic of PoseStamped or PoseArray with poses is in all of these bags"
        return SuggestedTask("", reason, tuple(others))
    array = not stamped
    names = arrays if array else stamped
    movement = max(names, key=lambda name: np.median([t.path_m for t in _each(bags, name)]))
    moving = _each(bags, movement)
    frame_ids = dict.fromkeys(frame for name in names for t in _each(bags, name) for frame in t.frame_ids if frame)
    base = next(iter(frame_ids), "base").strip("/")
    hints = [] if any(topic.moves for topic in moving) else others
    if len(frame_ids) > 1:
        hints.append(f"poses are in different frames ({', '.join(frame_ids)}): all have to be in base_frame")
    if max(np.ptp(t.poses[:, :3], axis=0).max() for t in moving) > LARGEST_M:
        hints.append(f"{movement} looks like millimetres: poses are expected in m")
    frames = []
    for name in names:
        if name != movement:
            first = np.array([t.poses[0] for t in _each(bags, name)])
            varies = np.ptp(first[:, :3], axis=0).max() > STILL_M or bool(
                (quaternion.angle_between(first[:1, 3:], first[:, 3:]) > STILL_RAD).any()
            )
            what = "moves" if any(t.moves for t in _each(bags, name)) else "stands still in each bag"
            where = "elsewhere from bag to bag" if varies else "always at the same place"
            frames.append((_frame_name(name), name, f"{what}, {where}"))
    lines = [
        "# Suggested from the recordings: look at each line, above all at `endpoint` and at the frames.",
        "name: my_task",
        f"base_frame: {base}",
        f"movement: {'endpoint/pose' if array else movement.strip('/')}",
        "endpoint: hand  # the end point of your robot that follows the movement",
        "frames:",
    ]
    for frame, topic, about in frames:
        lines.append(f"  {frame}: {{topic: {topic.strip('/')}}}  # {about}")
    beside = _frames_beside(bags[0].path) if array else []
    lines += [f"  {frame}: {{topic: {frame}/pose}}  # in {FRAMES_FILE} beside the bags" for frame in beside]
    if not frames and not beside:
        lines.append("  robot: {pose: [0, 0, 0, 0, 0, 0, 1]}  # there are no other poses; what does it depend on?")
    if array:
        if all(one.count == 1 for one in moving):
            lines.append(f"recordings: {{pose_array: {movement.strip('/')}, period: 0.05, frames: {FRAMES_FILE}}}")
            hints.append(f"a PoseArray has no times: `period` is a guess; the poses of frames stand in {FRAMES_FILE}")
        else:
            return SuggestedTask("", f"{movement} holds several PoseArrays a bag: one, the whole movement, is expected")
    components = 5 if len(bags) < 5 else 7
    settings = f"n_components: {components}, reg_covar: 1.0e-3, init: time, max_iter: 200, random_state: 0"
    lines.append(f"model: {{{settings}}}")
    return SuggestedTask("\n".join(lines) + "\n", hints=tuple(hints))


def _other_sources(bags: Sequence[BagOverview]) -> list[str]:
    """Topics that say where things are in another way than by poses, with what names them in a task file."""
    found = []
    for topic in bags[0].topics:
        everywhere = all(any(t.name == topic.name and t.count for t in bag.topics) for bag in bags)
        kind = short_type(topic.type)
        if kind in OTHER_SOURCES:
            entry = OTHER_SOURCES[kind]
        elif kind in SOURCES and topic.type != POSE_STAMPED:
            entry = f"{{topic: {topic.name.strip('/')}, type: {kind}}}"
        else:
            continue
        if everywhere and topic.name != f"/{TF_STATIC}":
            found.append(f"{topic.name} ({kind}) also says where things are: in a task file it is named by {entry}")
    return found


def _frames_beside(bag: Path) -> list[str]:
    """Names of the frames that a file beside a bag of PoseArray tells the poses of."""
    try:
        return [name for name in Section.load(bag.parent / FRAMES_FILE, "").section(bag.name).values if is_name(name)]
    except YamlError:
        return []


def _all_of(bags: Sequence[BagOverview], name: str, kind: str) -> bool:
    return all(topic.type == kind and len(topic.poses) for topic in _each(bags, name))


def _each(bags: Sequence[BagOverview], name: str) -> list[TopicOverview]:
    return [next(topic for topic in bag.topics if topic.name == name) for bag in bags]


def _frame_name(topic: str) -> str:
    """object/pose → object; letters, digits and underscores alone."""
    parts = [part for part in topic.strip("/").split("/") if part != "pose"]
    name = "_".join("".join(c if c.isalnum() else "_" for c in part) for part in parts) or "frame"
    return name if not name[0].isdigit() else f"frame_{name}"
