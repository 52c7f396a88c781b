# SPDX-License-Identifier: Apache-2.0
"""Topics of PoseStamped out of one bag."""

from collections.abc import Iterable
from pathlib import Path

import numpy as np

from tpgmm_ros.recordings.bag_messages import Stream, checked_poses, read_messages

POSE_STAMPED = "geometry_msgs/msg/PoseStamped"


def read_pose_streams(path: Path, topics: Iterable[str], base_frame: str) -> dict[str, Stream]:
    """Read PoseStamped topics of one bag.

    Topics are relative names. A bag recorded inside a namespace is understood when the namespace is the only
    one in which all of the topics exist.

    Parameters
    ----------
    path
        of the bag
    topics
        to be read
    base_frame
        the frame that all poses must be expressed in

    Returns
    -------
    dict[str, Stream]
        poses (T, 7) by topic, as given: x, y, z in m, qx, qy, qz, qw, unit quaternions of continuous sign

    Raises
    ------
    BagError
        the bag is damaged or incomplete, a topic is absent, empty or of another type, or a pose is
        not in `base_frame`, not finite, or has no unit quaternion.
    """
    streams = {}
    for topic, several in read_messages(path, topics, POSE_STAMPED).items():
        headers = [message.header for message in several.messages]
        streams[topic] = Stream(
            several.topic,
            stamps=np.array([h.stamp.sec * 1_000_000_000 + h.stamp.nanosec for h in headers], np.int64),
            recorded=several.recorded,
            values=checked_poses(
                path, several.topic, [m.pose for m in several.messages], [h.frame_id for h in headers], base_frame
            ),
        )
    return streams
