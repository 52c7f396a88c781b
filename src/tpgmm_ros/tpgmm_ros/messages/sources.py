# SPDX-License-Identifier: Apache-2.0
"""Sources of poses: for each type of message one small class that makes observations of messages.

A source reads the messages of rclpy and those of rosbags alike, by their fields, and imports no ROS: what a task
file names is read live and from recordings by the same code. Another source is another class here, with `topic`,
`message_type` and `read`, and a row in `SOURCES`.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar, Protocol

from tpgmm_core.common.text import shown
from tpgmm_core.observation.poses import Observation
from tpgmm_core.observation.tracked import FrameStatus
from tpgmm_ros.messages.affine import affine_observation
from tpgmm_ros.messages.fields import covariance_array, pose_numbers, time_to_ns, transform_numbers


class TopicSource(Protocol):
    """A topic whose messages say where one thing is.

    Attributes
    ----------
    topic
        relative topic.
    message_type
        full name of the messages' type.
    """

    message_type: ClassVar[str]

    @property
    def topic(self) -> str:
        """Relative topic."""

    @property
    def selection(self) -> str:
        """What of the messages is meant, in words; empty for all of them."""

    def read(self, message: Any) -> Observation | None:
        """The observation in a message; None where it says nothing of this thing."""


@dataclass(frozen=True, slots=True)
class PoseStampedSource:
    """geometry_msgs/PoseStamped."""

    topic: str
    selection: ClassVar[str] = ""
    message_type: ClassVar[str] = "geometry_msgs/msg/PoseStamped"

    def read(self, message: Any) -> Observation | None:
        """See `TopicSource`."""
        return self.observation(message)

    @staticmethod
    def observation(message: Any) -> Observation:
        """The observation in a message; each holds one."""
        header = message.header
        return Observation(time_to_ns(header.stamp), header.frame_id, pose_numbers(message.pose))


@dataclass(frozen=True, slots=True)
class PoseWithCovarianceStampedSource:
    """geometry_msgs/PoseWithCovarianceStamped."""

    topic: str
    selection: ClassVar[str] = ""
    message_type: ClassVar[str] = "geometry_msgs/msg/PoseWithCovarianceStamped"

    def read(self, message: Any) -> Observation | None:
        """See `TopicSource`."""
        header, pose = message.header, message.pose
        return Observation(time_to_ns(header.stamp), header.frame_id, pose_numbers(pose.pose), covariance_array(pose))


@dataclass(frozen=True, slots=True)
class OdometrySource:
    """nav_msgs/Odometry: the pose of its child frame."""

    topic: str
    selection: ClassVar[str] = ""
    message_type: ClassVar[str] = "nav_msgs/msg/Odometry"

    def read(self, message: Any) -> Observation | None:
        """See `TopicSource`."""
        header, pose = message.header, message.pose
        return Observation(time_to_ns(header.stamp), header.frame_id, pose_numbers(pose.pose), covariance_array(pose))


@dataclass(frozen=True, slots=True)
class TransformStampedSource:
    """geometry_msgs/TransformStamped: the pose of its child frame.

    Attributes
    ----------
    child
        only transforms to this frame; None: all
    """

    topic: str
    child: str | None = None
    message_type: ClassVar[str] = "geometry_msgs/msg/TransformStamped"

    @property
    def selection(self) -> str:
        """See `TopicSource`."""
        return "" if self.child is None else f"child {shown(self.child)}"

    def read(self, message: Any) -> Observation | None:
        """See `TopicSource`."""
        if self.child is not None and message.child_frame_id.removeprefix("/") != self.child:
            return None
        header = message.header
        return Observation(time_to_ns(header.stamp), header.frame_id, transform_numbers(message.transform))


@dataclass(frozen=True, slots=True)
class DetectionSource:
    """vision_msgs/Detection3DArray: the surest of the detections of a class, or the one with a tracking id.

    Attributes
    ----------
    class_id
        of a hypothesis; None: any
    tracking_id
        of a detection; None: any
    min_score
        hypotheses that are less sure are not used
    """

    topic: str
    class_id: str | None = None
    tracking_id: str | None = None
    min_score: float = 0.0
    message_type: ClassVar[str] = "vision_msgs/msg/Detection3DArray"

    @property
    def selection(self) -> str:
        """See `TopicSource`."""
        named = (("class", self.class_id), ("id", self.tracking_id))
        return ", ".join(f"{key} {shown(value)}" for key, value in named if value is not None)

    def read(self, message: Any) -> Observation | None:
        """See `TopicSource`. Detections without a header of their own have that of the array."""
        best: tuple[float, Any, Any] | None = None
        for detection in message.detections:
            if self.tracking_id is not None and detection.id != self.tracking_id:
                continue
            for result in detection.results:
                hypothesis = result.hypothesis
                if self.class_id is not None and hypothesis.class_id != self.class_id:
                    continue
                # a score that is no number is not sure of anything
                if hypothesis.score >= self.min_score and (best is None or hypothesis.score > best[0]):
                    best = hypothesis.score, detection, result.pose
        if best is None:
            return None
        _, detection, pose = best
        header = detection.header if detection.header.frame_id else message.header
        return Observation(time_to_ns(header.stamp), header.frame_id, pose_numbers(pose.pose), covariance_array(pose))


@dataclass(frozen=True, slots=True)
class TaskParametersSource:
    """tpgmm_msgs/TaskParameters: one frame of somebody else's, which may be any affine map of positions.

    Attributes
    ----------
    name
        of the frame in the messages
    """

    topic: str
    name: str
    message_type: ClassVar[str] = "tpgmm_msgs/msg/TaskParameters"

    @property
    def selection(self) -> str:
        """See `TopicSource`."""
        return f"a visible frame {shown(self.name)}"

    def read(self, message: Any) -> Observation | None:
        """See `TopicSource`. Without a stamp of its own, a frame has that of the message; a held one says nothing."""
        for item in message.frames:
            if item.name == self.name and item.status == FrameStatus.VISIBLE:
                header = message.header
                stamp_ns = time_to_ns(item.stamp) or time_to_ns(header.stamp)
                return affine_observation(stamp_ns, header.frame_id, item)
        return None


@dataclass(frozen=True, slots=True)
class TransformSource:
    """Transforms on /tf and /tf_static, composed.

    Attributes
    ----------
    frame
        the frame whose pose is meant
    base
        by which name transforms know the base frame
    """

    frame: str
    base: str


@dataclass(frozen=True, slots=True)
class JointStateSource:
    """sensor_msgs/JointState and a robot file: the pose of a link. For movements in recordings.

    Attributes
    ----------
    topic
        relative topic
    robot
        the robot file
    link
        an end point of the robot file, or a frame of its URDF
    """

    topic: str
    robot: Path
    link: str


Source = TopicSource | TransformSource
"""Where poses of frames come from."""

#: Type as task files name it → class.
SOURCES: Mapping[str, type] = {
    "geometry_msgs/PoseStamped": PoseStampedSource,
    "geometry_msgs/PoseWithCovarianceStamped": PoseWithCovarianceStampedSource,
    "geometry_msgs/TransformStamped": TransformStampedSource,
    "nav_msgs/Odometry": OdometrySource,
    "vision_msgs/Detection3DArray": DetectionSource,
    "tpgmm_msgs/TaskParameters": TaskParametersSource,
}
TF_MESSAGE = "tf2_msgs/msg/TFMessage"
TF, TF_STATIC = "tf", "tf_static"
"""Topics of transforms, without the slash that they have in every namespace."""


def short_type(name: str) -> str:
    """A type's name as task files have it: geometry_msgs/PoseStamped."""
    return name.replace("/msg/", "/")
