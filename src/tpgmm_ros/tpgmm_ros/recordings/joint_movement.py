# SPDX-License-Identifier: Apache-2.0
"""The pose of a link out of recorded joint states and a robot file: forward kinematics."""

from dataclasses import replace
from pathlib import Path

import numpy as np

from tpgmm_core.doubt.values import doubts_of_joint_limits
from tpgmm_core.robot.description import RobotFileError
from tpgmm_core.robot.model import RobotModel
from tpgmm_ros.messages.sources import JointStateSource
from tpgmm_ros.recordings.bag_messages import BagError, Stream
from tpgmm_ros.recordings.joint_streams import read_joint_stream


def read_link_stream(path: Path, source: JointStateSource, base_frame: str) -> Stream:
    """Poses of a link at the times of its joint states.

    Joints that do not move the link are not needed; messages may hold more joints, fewer, or others.

    Parameters
    ----------
    path
        of the bag
    source
        topic, robot file and link
    base_frame
        the frame that poses are returned in

    Returns
    -------
    Stream
        poses (T, 7)

    Raises
    ------
    BagError
        the robot file cannot be used, has no such link or another base frame, joints look like degrees, or like
        `read_joint_stream`.
    """
    try:
        robot = RobotModel.from_file(source.robot)
        frame_id = robot.endpoint_frame_ids.get(source.link)
        frame_id = robot.frame_id(source.link) if frame_id is None else frame_id
    except (RobotFileError, ValueError, OSError) as error:
        raise BagError(path, f"its movement is that of {source.link!r} of {source.robot}: {error}") from error
    if robot.base_frame != base_frame:
        raise BagError(
            path,
            f"its movement is that of {source.link!r} in {robot.base_frame!r}, the base frame of {source.robot}; the "
            f"task has {base_frame!r}: name the same base_frame in both files",
        )
    parent = robot.pinocchio.frames[frame_id].parentJoint
    moving = [int(joint) for joint in robot.pinocchio.supports[parent]][1:]
    joints = [robot.pinocchio.names[joint] for joint in moving]
    if not joints:
        raise BagError(path, f"its movement is that of {source.link!r}, which no joint of {source.robot} moves")
    states = read_joint_stream(path, source.topic, joints)
    if states.doubts:  # poses out of them would mean nothing, and leap
        raise BagError(path, f"{states.topic}: {states.doubts[0].text}")
    beyond = doubts_of_joint_limits(
        joints, states.values, robot.lower_limits[robot.indices(joints)], robot.upper_limits[robot.indices(joints)]
    )
    data, q, at = robot.create_data(), robot.home.copy(), robot.indices(joints)
    poses = np.empty((len(states.values), 7))
    for k, positions in enumerate(states.values):
        q[at] = positions
        data.update(q)
        poses[k] = data.frame_pose(frame_id)
    return replace(states, values=poses, doubts=beyond)
