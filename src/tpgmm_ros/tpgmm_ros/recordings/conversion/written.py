# SPDX-License-Identifier: Apache-2.0
"""Demonstrations to bags with a task file, and bags held against what was written: the same numbers, bit by bit."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from tpgmm_core.common.types import Array, Nanoseconds
from tpgmm_core.common.yaml_values import quoted
from tpgmm_ros.recordings.bag_messages import read_messages
from tpgmm_ros.recordings.conversion.conversion_error import ConversionError
from tpgmm_ros.recordings.conversion.demonstrations import Shown
from tpgmm_ros.recordings.numeric_fields import read_numbers
from tpgmm_ros.recordings.storage.bag_writer import BagWriter
from tpgmm_ros.recordings.storage.definitions import types_for

POSE_STAMPED, FLOAT64 = "geometry_msgs/msg/PoseStamped", "std_msgs/msg/Float64"
MOVEMENT = "hand/pose"
BEGIN = "begin"
"""Frame of where the hand is at the beginning."""
START_NS = 1_000_000_000
"""Stamp of the first sample: 0 would mean that there is none."""


def topic_of(frame: str) -> str:
    """The topic of a frame's poses."""
    return f"{frame}/pose"


def topics_of(shown: Shown) -> dict[str, Array]:
    """Topic → (T, 7) poses of the hand and of each frame."""
    return {MOVEMENT: shown.movement} | {topic_of(name): values for name, values in shown.frames.items()}


def task_text(name: str, base_frame: str, frames: Sequence[str]) -> str:
    """The task file of such bags.

    Parameters
    ----------
    name
        of the task
    base_frame
        frame_id of all poses
    frames
        names of those that have topics

    Returns
    -------
    str
        YAML
    """
    lines = [
        "# Written by convert: look at each line, above all at `endpoint` and at the frames.",
        f"name: {quoted(name)}",
        f"base_frame: {quoted(base_frame)}",
        f"movement: {MOVEMENT}",
        "endpoint: hand  # the end point of your robot that follows the movement",
        "frames:",
        *(f"  {quoted(frame)}: {{topic: {topic_of(frame)}}}" for frame in frames),
        f"  {BEGIN}: {{hand: start, turned: false}}  # where the hand is when the movement begins",
    ]
    if not frames:
        lines.insert(-1, "  robot: {pose: [0, 0, 0, 0, 0, 0, 1]}  # no frames were given; what does it depend on?")
    return "\n".join(lines) + "\n"


def write_bag(
    path: Path, ns: Nanoseconds, poses: Mapping[str, Array], base_frame: str, numbers: Mapping[str, Array] | None = None
) -> Path:
    """Write poses that are known already as topics of PoseStamped, and further numbers as topics of Float64.

    Parameters
    ----------
    path
        of the bag, which does not exist yet
    ns
        (T,) from the first sample
    poses
        topic → (T, 7); where a pose is not finite, none is written
    base_frame
        frame_id of all poses
    numbers
        topic → (T,)

    Returns
    -------
    Path
        the bag

    Raises
    ------
    OSError
        the disk does not take it, or there is something at `path`.
    """
    store, number_store = types_for(POSE_STAMPED), types_for(FLOAT64)
    kinds: Any = store.types
    numbers = numbers or {}
    writer = BagWriter(path)
    try:
        topics = {name: writer.add_topic(f"/{name}", POSE_STAMPED, store) for name in poses}
        further = {name: writer.add_topic(f"/{name}", FLOAT64, number_store) for name in numbers}
        for k, at in enumerate((START_NS + ns).tolist()):
            stamp = kinds["builtin_interfaces/msg/Time"](*divmod(at, 1_000_000_000))
            header = kinds["std_msgs/msg/Header"](stamp=stamp, frame_id=base_frame)
            for name, values in poses.items():
                if np.isfinite(values[k]).all():
                    x, y, z, *q = values[k].tolist()
                    pose = kinds["geometry_msgs/msg/Pose"](
                        kinds["geometry_msgs/msg/Point"](x, y, z), kinds["geometry_msgs/msg/Quaternion"](*q)
                    )
                    writer.write(topics[name], at, store.serialize_cdr(kinds[POSE_STAMPED](header, pose), POSE_STAMPED))
            for name, column in numbers.items():
                message = number_store.types[FLOAT64](float(column[k]))
                writer.write(further[name], at, number_store.serialize_cdr(message, FLOAT64))
        return writer.close()
    except BaseException:
        writer.discard()
        raise


def audit(bag: Path, shown: Shown, base_frame: str) -> dict[str, int]:
    """Read a bag back, and hold it against what was written.

    Parameters
    ----------
    bag
        the bag
    shown
        what was written
    base_frame
        frame_id of all poses

    Returns
    -------
    dict[str, int]
        messages by topic

    Raises
    ------
    ConversionError
        anything differs.
    """
    moving = topics_of(shown)
    found = read_messages(bag, list(moving), POSE_STAMPED)
    counts = {}
    for name, values in moving.items():
        seen = np.isfinite(values).all(axis=1)
        headers = [message.header for message in found[name].messages]
        stamps = np.array([h.stamp.sec * 1_000_000_000 + h.stamp.nanosec for h in headers], np.int64)
        _hold(bag, name, stamps, (START_NS + shown.ns)[seen])
        _hold(bag, name, found[name].recorded, stamps)
        _hold(bag, name, np.array([_numbers(message.pose) for message in found[name].messages]), values[seen])
        if {header.frame_id for header in headers} - {base_frame}:
            raise ConversionError(f"{bag}: {name} has another frame than {base_frame!r}")
        counts[name] = len(stamps)
    for name, column in shown.numbers.items():
        recorded, back = read_numbers(bag, name, "data")
        finite = np.isfinite(column)
        _hold(bag, name, recorded, (START_NS + shown.ns)[finite])
        _hold(bag, name, back, column[finite])
        counts[name] = len(back)
    return counts


def _hold(bag: Path, topic: str, found: np.ndarray[Any, Any], written: np.ndarray[Any, Any]) -> None:
    if found.shape != written.shape or not (found == written).all():
        raise ConversionError(
            f"{bag}: {topic} does not hold what was written ({len(found)} of {len(written)} messages); keep the bag "
            "and the file, and report it"
        )


def _numbers(pose: Any) -> Array:
    p, q = pose.position, pose.orientation
    return np.array([p.x, p.y, p.z, q.x, q.y, q.z, q.w])
