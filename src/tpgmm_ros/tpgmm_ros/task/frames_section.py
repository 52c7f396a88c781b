# SPDX-License-Identifier: Apache-2.0
"""The part `frames` of a task file: each task frame is observed, fixed, or derived from another one.

object: {topic: object/pose}           # observed: PoseStamped; for other sources see `source_entries`
table: {tf: table, unseen: stays}      # observed; out of sight it is where it was last seen
cup: {topic: cup, unseen: {with: hand}}  # the same, or with the hand if it was last seen to move with it
nut: {topic: nut, unseen: {with: hand, gripper: {topic: width, type: std_msgs/Float64, below: 0.03}}}  # held by it
robot: {pose: [0, 0, 0, 0, 0, 0, 1]}   # fixed: x y z (m), qx qy qz qw, in base_frame
place: {frame: object, turned: false}  # derived: where `object` is, with the axes of base_frame
begin: {hand: start, turned: false}    # derived: where the hand is when the movement begins
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any

from tpgmm_core.common.text import listed, shown
from tpgmm_core.common.yaml_sections import Section
from tpgmm_core.common.yaml_values import a_choice, a_name, a_number, a_quaternion, a_truth, is_name, numbers
from tpgmm_core.model.derived_frames import HAND, DerivedFrames, FrameSource
from tpgmm_ros.messages.sources import PoseStampedSource, Source
from tpgmm_ros.task.signals import TypedSignal, read_typed_signal
from tpgmm_ros.task.source_entries import KEYS, read_source

UNSEEN = "unseen"
"""Key of what is known of an observed frame that is out of sight."""
WITH_HAND = {"with": "hand"}
"""Its value for a frame that the hand may carry."""


@dataclass(frozen=True, slots=True)
class TaskFrameSpec:
    """One task frame: observed, or fixed in the base frame. Exactly one of the two is set.

    Attributes
    ----------
    name
        name of the frame, as in the model
    source
        what it is observed by, or None
    pose
        fixed pose (x, y, z in m, qx, qy, qz, qw, unit quaternion) in the base frame, or None
    unknown_after
        how long an observed frame that is out of sight is where it was last seen, s; infinite: it stays there. None:
        as recordings and the tracker have it where nothing is said
    with_hand
        whether it then moves with the hand, if it was seen to
    gripper
        holds where the gripper is closed that may hold it, or None; what it says counts more than what was seen
    """

    name: str
    source: Source | None = None
    pose: tuple[float, ...] | None = None
    unknown_after: float | None = None
    with_hand: bool = False
    gripper: TypedSignal | None = None


def read_frames(section: Section, movement: str, base_frame: str) -> tuple[dict[str, TaskFrameSpec], DerivedFrames]:
    """The frames that the part `frames` of a task file names.

    Parameters
    ----------
    section
        frame name → how it is known
    movement
        the task's topic, which is no frame's
    base_frame
        frame_id in which poses are expressed

    Returns
    -------
    dict[str, TaskFrameSpec]
        observed and fixed frames by name, in the order of the file
    DerivedFrames
        those that are made of others

    Raises
    ------
    YamlError
        the part does not describe frames
    """
    if not section.values:
        raise section.error("is empty: name at least one frame, such as 'object: {topic: object/pose}'")
    taken: dict[Source, str] = {PoseStampedSource(movement): "the movement"}
    frames: dict[str, TaskFrameSpec] = {}
    derived: dict[str, FrameSource] = {}
    for name in section.values:
        if not is_name(name):
            raise section.error(f"has the frame name {shown(name)}: use letters, digits and underscores")
        entry = section.section(name)
        entry.refuse_others(*KEYS, UNSEEN, "pose", "frame", "hand", "turned")
        if len(entry.values.keys() & {"topic", "tf", "pose", "frame", "hand"}) != 1:
            raise entry.error(
                "needs exactly one of 'topic' or 'tf' (observed), 'pose' (fixed), 'frame' (derived from another frame) "
                "and 'hand' (derived from the hand's pose at the start)"
            )
        if "frame" in entry.values or "hand" in entry.values:
            _refuse(entry, (*KEYS, UNSEEN), "observed frames")
            derived[name] = _source(entry)
            continue
        _refuse(entry, ("turned",), "frames with 'frame' or 'hand'")
        if "pose" in entry.values:
            _refuse(entry, (*KEYS, UNSEEN), "observed frames")
            frames[name] = TaskFrameSpec(name, pose=entry.required("pose", _pose))
            continue
        source = read_source(entry, base_frame)
        if source in taken:
            what = shown(entry.values["topic"] if "topic" in entry.values else entry.values["tf"])
            raise entry.error(
                f"has the {'topic' if 'topic' in entry.values else 'transform'} {what}, which is already used by "
                f"{taken[source]}: each frame needs its own"
            )
        taken[source] = f"the frame {name!r}"
        frames[name] = TaskFrameSpec(name, source, **_unseen(entry))
    for name, made_of in derived.items():
        if made_of.of not in (*frames, HAND):
            raise section.error(
                f"has {shown(name)}, which is derived from {shown(made_of.of)}; expected an observed or fixed frame of "
                f"this file: {listed(frames) or 'there is none'}"
            )
    return frames, DerivedFrames(derived)


def _refuse(entry: Section, keys: Iterable[str], what: str) -> None:
    for key in keys:
        if key in entry.values:
            raise entry.error(f"has {key!r}, which is for {what}")


def _source(entry: Section) -> FrameSource:
    turned = entry.required("turned", a_truth) if "turned" in entry.values else True
    if "hand" in entry.values:
        entry.required("hand", a_choice("start"))
        return FrameSource(HAND, turned)
    return FrameSource(entry.required("frame", a_name), turned)


def _unseen(entry: Section) -> dict[str, Any]:
    """What the entry says of a frame that is out of sight, as arguments of `TaskFrameSpec`."""
    value = entry.values.get(UNSEEN)
    if isinstance(value, Mapping) and {key: value[key] for key in value if key != "gripper"} == WITH_HAND:
        section = entry.section(UNSEEN)
        gripper = read_typed_signal(section.section("gripper")) if "gripper" in value else None
        return {"unknown_after": math.inf, "with_hand": True, "gripper": gripper}
    return {"unknown_after": entry.required(UNSEEN, _time_or_stays)} if UNSEEN in entry.values else {}


def _time_or_stays(value: Any) -> float:
    """The time after which it is not known where a frame is, s."""
    if value == "stays":
        return math.inf
    try:
        return a_number(0.0)(value)
    except ValueError:
        raise ValueError(
            "'stays' (an unseen frame stays where it was last seen), {with: hand} (the same, but with the hand if it "
            "was last seen to move with it, or if its gripper holds it), or the time in s after which its pose is "
            "unknown"
        ) from None


def _pose(value: Any) -> tuple[float, ...]:
    try:
        pose = numbers(7)(value)
        return (*pose[:3], *a_quaternion(list(pose[3:])))
    except ValueError:
        raise ValueError("seven finite numbers: x y z (m) qx qy qz qw, with a quaternion of norm 1") from None
