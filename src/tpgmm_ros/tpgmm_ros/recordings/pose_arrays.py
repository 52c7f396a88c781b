# SPDX-License-Identifier: Apache-2.0
"""Movements recorded as one PoseArray per bag, without stamps, with the frames in a file beside the bags.

demo_1.bag:                                        # name of the bag
  start:                                           # name of the frame
    position: [0.32, 0.03, 0.50]                   # m, in the frame of the recorded poses
    orientation_xyzw: [0.0, 0.0, 0.0, 1.0]
"""

from collections.abc import Iterable
from pathlib import Path

import numpy as np

from tpgmm_core.common.safe_yaml import YamlError
from tpgmm_core.common.types import Array
from tpgmm_core.common.yaml_sections import Section
from tpgmm_core.common.yaml_values import a_quaternion, numbers
from tpgmm_core.observation.streams import SECOND
from tpgmm_ros.messages.fields import pose_numbers
from tpgmm_ros.recordings.bag_messages import BagError, Stream, read_messages
from tpgmm_ros.recordings.pose_streams import Observed, usable_poses
from tpgmm_ros.task.recordings_section import PoseArraySpec

POSE_ARRAY = "geometry_msgs/msg/PoseArray"


def read_pose_array(
    path: Path, spec: PoseArraySpec, frames: Iterable[str], base_frame: str
) -> tuple[Stream, dict[str, Array]]:
    """Read a movement and its frames from a bag of PoseArray messages.

    Parameters
    ----------
    path
        of the bag
    spec
        how they were recorded
    frames
        names of the frames
    base_frame
        the frame that all poses must be expressed in

    Returns
    -------
    tuple[Stream, dict[str, Array]]
        poses (T, 7) of the movement, at multiples of the period, and those (7,) of the frames that the file holds for
        this bag

    Raises
    ------
    BagError
        the bag cannot be read, does not hold one PoseArray with poses in `base_frame`, most of them good, or the file
        of frames does not tell each frame of this bag.
    """
    found = read_messages(path, [spec.pose_array], POSE_ARRAY)[spec.pose_array]
    if len(found.messages) != 1:
        raise BagError(
            path,
            f"{found.topic} holds {len(found.messages)} messages, expected one PoseArray, which is the whole movement; "
            "record each demonstration into a bag of its own",
        )
    message = found.messages[0]
    if not message.poses:
        raise BagError(path, f"the PoseArray on {found.topic} is empty; record the whole movement")
    period_ns, frame_id = round(spec.period * SECOND), message.header.frame_id
    T = len(message.poses)
    numbers_of_poses = np.array([pose_numbers(pose) for pose in message.poses])
    seen = Observed(period_ns * np.arange(T), [frame_id] * T, numbers_of_poses)
    movement, good, notes = usable_poses(path, found.topic, seen, base_frame)
    stamps = period_ns * np.flatnonzero(good)
    return Stream(found.topic, stamps, stamps, movement, notes), _places(path, spec.frames, frames)


def _places(path: Path, file_name: str, frames: Iterable[str]) -> dict[str, Array]:
    file = path.parent / file_name
    try:
        bag = Section.load(file, "the frames of each bag").section(path.name)
        places = {}
        for name in frames:
            pose = bag.section(name)
            pose.refuse_others("position", "orientation_xyzw")
            position = pose.required("position", numbers(3))
            places[name] = np.array([*position, *pose.required("orientation_xyzw", a_quaternion)])
    except YamlError as error:
        raise BagError(path, f"its frames are not known: {error}") from None
    return places
