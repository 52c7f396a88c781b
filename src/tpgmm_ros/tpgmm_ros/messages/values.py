# SPDX-License-Identifier: Apache-2.0
"""References and task parameters as the core has them, with the header of their messages.

Nodes that share a process hand them on as they are (`runtime.local_topics`); a message is made where one is needed.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

from tpgmm_core.common.text import shown
from tpgmm_core.model.reference import Reference
from tpgmm_core.observation.tracked import FrameStatus, TrackedFrame
from tpgmm_msgs.msg import Reference as ReferenceMessage
from tpgmm_msgs.msg import TaskParameters
from tpgmm_ros.messages import conversions
from tpgmm_ros.messages.conversions import MessageError, TaskFrameState
from tpgmm_ros.messages.frame_messages import frame_of
from tpgmm_ros.messages.lockstep import is_no_reference, no_reference


@dataclass(frozen=True, slots=True)
class StampedReference:
    """A reference at a time.

    Attributes
    ----------
    reference : Reference or None
        None: nothing is reproduced at this time, which is said in lockstep only.
    stamp_ns : int
        ROS time, ns.
    frame_id : str
        The frame that it is expressed in.
    """

    reference: Reference | None
    stamp_ns: int
    frame_id: str

    @classmethod
    def of(cls, message: ReferenceMessage, lockstep: bool = False) -> StampedReference:
        """Read a message.

        Parameters
        ----------
        message
            as it came
        lockstep
            whether a message may hold no reference, which answers a joint state all the same

        Returns
        -------
        StampedReference
            the reference with its stamp

        Raises
        ------
        MessageError
            It holds no reference, and this is not `lockstep`, or one that is none.
        """
        nothing = lockstep and is_no_reference(message)
        stamp_ns = conversions.time_to_ns(message.header.stamp)
        return cls(None if nothing else conversions.reference(message), stamp_ns, message.header.frame_id)

    def require_frame(self, base_frame: str) -> None:
        """Check that it is expressed in the base frame of a robot; an empty name counts as that.

        Raises
        ------
        MessageError
            It is not.
        """
        if self.frame_id not in ("", base_frame):
            raise MessageError(f"the reference is expressed in {shown(self.frame_id)}; expected '{base_frame}'")

    def message(self) -> ReferenceMessage:
        """The same as a message."""
        if self.reference is None:
            return no_reference(self.stamp_ns, self.frame_id)
        return conversions.reference_message(self.reference, self.reference.dimensions, self.stamp_ns, self.frame_id)


@dataclass(frozen=True, slots=True)
class StampedFrames:
    """All frames of a task at a time.

    Attributes
    ----------
    frames : tuple of TrackedFrame
        As the tracker knows them.
    stamp_ns : int
        When they were put together, ROS time, ns.
    frame_id : str
        The frame that they are expressed in.
    """

    frames: tuple[TrackedFrame, ...]
    stamp_ns: int
    frame_id: str

    def message(self) -> TaskParameters:
        """The same as a message."""
        return conversions.task_parameters_message(self.frames, self.stamp_ns, self.frame_id)

    def states(self) -> dict[str, TaskFrameState]:
        """The frames by name, as `conversions.task_parameters` reads them from the message."""
        states = {}
        for item in self.frames:
            if item.pose is None or item.status is FrameStatus.MISSING or item.confidence == 0.0:
                states[item.name] = TaskFrameState(None, 0.0, item.status)
            else:
                frame = frame_of(item)
                if item.covariance is not None:
                    frame = replace(frame, pose_covariance=item.covariance)
                states[item.name] = TaskFrameState(frame, item.confidence, item.status)
        return states
