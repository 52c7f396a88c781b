# SPDX-License-Identifier: Apache-2.0
"""A task file for bags of which nobody has told anything, from what lies in them."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from tpgmm_core.common.safe_yaml import YamlError
from tpgmm_core.common.text import listed
from tpgmm_core.common.yaml_sections import Section
from tpgmm_core.common.yaml_values import a_topic, is_name
from tpgmm_core.doubt.values import LARGEST_M
from tpgmm_core.geometry import quaternion
from tpgmm_ros.messages.sources import SOURCES, TF_MESSAGE, TF_STATIC, short_type
from tpgmm_ros.recordings.joint_streams import JOINT_STATE
from tpgmm_ros.recordings.overview import POSE_ARRAY, POSE_STAMPED, STILL_M, STILL_RAD, BagOverview, TopicOverview

FRAMES_FILE = "frames.yaml"
OTHER_SOURCES = {
    short_type(TF_MESSAGE): "{tf: FRAME}",
    short_type(JOINT_STATE): "recordings: {movement: {joint_states: TOPIC, robot: FILE, link: LINK}}",
}
"""Sources that a task file names otherwise than by topic and type."""
LONGEST_NAME = 200
"""Characters of a topic: DDS, which carries it, knows little more."""
_FRAME = re.compile(r"[\w./-]+")


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
    odd = [name for name in common if not _is_topic(name)]
    common = [name for name in common if _is_topic(name)]
    stamped = [name for name in common if _all_of(bags, name, POSE_STAMPED)]
    arrays = [name for name in common if _all_of(bags, name, POSE_ARRAY)]
    strange = [f"{listed(odd, 3)}: this is no name of ROS, so that no task file can name it"] if odd else []
    others = [*strange, *_other_sources(bags)]
    if not stamped and not arrays:
        reason = "no topic of PoseStamped or PoseArray with poses is in all of these bags"
        return SuggestedTask("", reason, tuple(others))
    array = not stamped
    names = arrays if array else stamped
    movement = max(names, key=lambda name: np.median([t.path_m for t in _each(bags, name)]))
    moving = _each(bags, movement)
    frame_ids = dict.fromkeys(
        frame for name in names for t in _each(bags, name) for frame in t.frame_ids if _FRAME.fullmatch(frame)
    )
    base = next(iter(frame_ids), "base").strip("/")
    hints = strange if any(topic.moves for topic in moving) else others
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
            what = "moves" if any(t.moves for t in _each(bags, name)) else "stands still"
            if len(bags) > 1:
                what += f" in each bag, {'elsewhere from bag to bag' if varies else 'always at the same place'}"
            frames.append((_frame_name(name), name, what))
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


def _is_topic(name: str) -> bool:
    """Whether a task file can name a topic like this."""
    try:
        return len(a_topic(name.strip("/"))) <= LONGEST_NAME
    except ValueError:
        return False


def _all_of(bags: Sequence[BagOverview], name: str, kind: str) -> bool:
    return all(topic.type == kind and len(topic.poses) for topic in _each(bags, name))


def _each(bags: Sequence[BagOverview], name: str) -> list[TopicOverview]:
    return [next(topic for topic in bag.topics if topic.name == name) for bag in bags]


def _frame_name(topic: str) -> str:
    """object/pose → object; letters, digits and underscores alone."""
    parts = [part for part in topic.strip("/").split("/") if part != "pose"]
    name = "_".join("".join(c if c.isalnum() else "_" for c in part) for part in parts) or "frame"
    return name if not name[0].isdigit() else f"frame_{name}"
