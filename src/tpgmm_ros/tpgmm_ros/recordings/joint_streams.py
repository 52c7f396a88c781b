# SPDX-License-Identifier: Apache-2.0
"""A topic of JointState out of one bag: positions of chosen joints, by name."""

import math
from array import array
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from tpgmm_core.doubt.values import doubts_of_joint_units
from tpgmm_core.observation.joint_states import JointStateAssembler, JointStateError
from tpgmm_core.observation.streams import RESTARTED_AFTER, SECOND, Stamp, StreamWatch
from tpgmm_ros.recordings.bag_messages import MOST_BAD, BagError, Stream, take_messages

JOINT_STATE = "sensor_msgs/msg/JointState"


def read_joint_stream(path: Path, topic: str, joints: Sequence[str]) -> Stream:
    """Read positions of joints from messages as the robot's drivers have published them.

    They become states as they do while a robot runs (`tpgmm_core.observation.joint_states`): a message may hold more
    joints, fewer, or others, in any order. A state has the times of its last message where these are the recorder's.

    Parameters
    ----------
    path
        of the bag
    topic
        of the joint states
    joints
        n names

    Returns
    -------
    Stream
        positions (T, n) in the order of `joints`, with their stamps; a note of what was left out, a doubt where they
        look like degrees

    Raises
    ------
    BagError
        the bag is damaged or incomplete, the topic is absent, empty or of another type, some joint never
        came, or most messages cannot be used: they name a joint twice, or none, or have a position that is not finite.
    """
    assembler, watch = JointStateAssembler(joints, ["position"]), StreamWatch()
    stamps, at, positions = array("q"), array("q"), array("d")
    count, bad, first = 0, 0, ""

    def take(_: str, recorded: int, message: Any) -> None:
        nonlocal count, bad, first
        stamp_ns = message.header.stamp.sec * SECOND + message.header.stamp.nanosec
        try:
            if not message.name and len(message.position):
                raise JointStateError(f"it has {len(message.position)} positions and names no joints")
            sample = assembler.take(list(message.name), [message.position], stamp_ns)
        except JointStateError as error:
            sample, bad, first = None, bad + 1, first or f"number {count}: {error}"
        count += 1
        # overtaken ones are left out; what runs backwards for good, or never changes, is for others to judge
        if sample is None or watch.judge(sample.stamp_ns, recorded, 0, RESTARTED_AFTER, math.inf) is Stamp.OLD:
            return
        watch.accept(sample.stamp_ns, recorded)
        stamps.append(sample.stamp_ns)
        at.append(recorded)
        positions.extend(sample.values[0])

    name = take_messages(path, [topic], JOINT_STATE, take)[topic]
    if bad > MOST_BAD * count:
        raise BagError(
            path,
            f"{name} has {bad} of {count} messages that cannot be used, the first is {first}. Correct what publishes "
            "it, and record again",
        )
    if not stamps:
        raise BagError(
            path,
            f"{name} never has all joints of the task: {assembler.incomplete()}. "
            "Record all their drivers, or correct the task file",
        )
    numbers = np.array(positions).reshape(-1, len(joints))
    doubts = doubts_of_joint_units(joints, numbers)
    notes = (f"{name}: {bad} of {count} messages left out, the first is {first}",) if bad else ()
    return Stream(name, np.array(stamps, np.int64), np.array(at, np.int64), numbers, notes, doubts)
