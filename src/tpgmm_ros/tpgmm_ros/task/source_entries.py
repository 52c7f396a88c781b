# SPDX-License-Identifier: Apache-2.0
"""Sources of poses as task files name them: the same words for frames on topics, and in recordings.

{topic: cup/pose}                                                       # PoseStamped
{topic: cup/transform, type: geometry_msgs/TransformStamped, child: cup}
{topic: odom, type: nav_msgs/Odometry}
{topic: detections, type: vision_msgs/Detection3DArray, class: cup, min_score: 0.5}
{topic: maps, type: tpgmm_msgs/TaskParameters, name: cup}               # any affine map, of that name in the messages
{tf: cup}                                                               # /tf and /tf_static
{tf: {frame: cup, parent: world}}                                       # where these call the base frame otherwise
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

from tpgmm_core.common.text import shown
from tpgmm_core.common.yaml_sections import Section
from tpgmm_core.common.yaml_values import a_name, a_number, a_text, a_topic, checked_text
from tpgmm_ros.messages.sources import (
    SOURCES,
    DetectionSource,
    JointStateSource,
    PoseStampedSource,
    Source,
    TaskParametersSource,
    TransformSource,
    TransformStampedSource,
    short_type,
)

KEYS = ("topic", "type", "tf", "child", "class", "id", "min_score", "name")
"""Keys of an entry that names a source."""

a_frame_id = checked_text(
    lambda text: not text.startswith("/") and text.split() == [text],
    "the frame_id of the poses, without a leading slash",
)


def read_source(entry: Section, base_frame: str) -> Source:
    """The source that an entry names with `topic` or `tf`.

    Parameters
    ----------
    entry
        of the task file
    base_frame
        of the task

    Returns
    -------
    Source
        the source

    Raises
    ------
    YamlError
        the entry does not describe one.
    """
    if "tf" in entry.values:
        _refuse_options(entry, "tf")
        if not isinstance(entry.values["tf"], Mapping):
            return TransformSource(entry.required("tf", a_frame_id), base_frame)
        section = entry.section("tf")
        section.refuse_others("frame", "parent")
        parent = section.required("parent", a_frame_id) if "parent" in section.values else base_frame
        return TransformSource(section.required("frame", a_frame_id), parent)
    topic = entry.required("topic", a_topic)
    kind = SOURCES[entry.required("type", _a_type)] if "type" in entry.values else PoseStampedSource
    options = _OPTIONS.get(kind, {})
    _refuse_options(entry, "topic", "type", *options)
    values = {name: entry.required(key, read) for key, (name, read) in options.items() if key in entry.values}
    if kind is DetectionSource and not {"class_id", "tracking_id"} & values.keys():
        raise entry.error("accepts any detection: give the 'class' or the tracking 'id' of the object")
    if kind is TaskParametersSource and not values:
        raise entry.error("lacks the key 'name': which frame of the messages is meant")
    source: Source = kind(topic, **values)
    return source


def read_movement(entry: Section, base_frame: str) -> Source | JointStateSource:
    """The source of a recorded movement: like that of a frame, or joint states and a robot file.

    Parameters
    ----------
    entry
        of the task file
    base_frame
        of the task

    Returns
    -------
    Source or JointStateSource
        the source

    Raises
    ------
    YamlError
        the entry does not describe one.
    """
    if "joint_states" in entry.values:
        entry.refuse_others("joint_states", "robot", "link")
        robot = entry.path_in("robot", "a robot file")
        return JointStateSource(entry.required("joint_states", a_topic), robot, entry.required("link", a_text))
    entry.refuse_others(*KEYS, "joint_states")
    if len(entry.values.keys() & {"topic", "tf"}) != 1:
        raise entry.error("needs exactly one of 'topic', 'tf' and 'joint_states'")
    return read_source(entry, base_frame)


def _refuse_options(entry: Section, *known: str) -> None:
    for key in entry.values:
        if key in KEYS and key not in known:
            kind = "tf" if "tf" in known else entry.values.get("type", "geometry_msgs/PoseStamped")
            raise entry.error(f"has {key!r}, which is not a key of {shown(kind)}; expected {', '.join(known)}")


def _a_type(value: Any) -> str:
    name = short_type(value) if isinstance(value, str) else value
    if not isinstance(name, str) or name not in SOURCES:
        raise ValueError("one of " + ", ".join(SOURCES))
    return name


_OPTIONS: Mapping[type, Mapping[str, tuple[str, Callable[[Any], Any]]]] = {
    TransformStampedSource: {"child": ("child", a_frame_id)},
    DetectionSource: {
        "class": ("class_id", a_text),
        "id": ("tracking_id", a_text),
        "min_score": ("min_score", a_number(0.0)),
    },
    TaskParametersSource: {"name": ("name", a_name)},
}
