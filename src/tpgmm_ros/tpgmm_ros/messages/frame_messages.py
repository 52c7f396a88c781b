# SPDX-License-Identifier: Apache-2.0
"""Task parameters as messages and back: where the frames of a task are."""

from __future__ import annotations

import functools
from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from tpgmm_core import Frame
from tpgmm_core.common.text import shown
from tpgmm_core.observation.tracked import FrameStatus, TrackedFrame
from tpgmm_msgs.msg import TaskFrame, TaskParameters
from tpgmm_ros.messages.basic_messages import MessageError, floats, header_at, time_from_ns
from tpgmm_ros.messages.fields import LARGEST_VARIANCE

#: No task has frames of more dimensions than this; a message that says so lies.
MAX_DIMENSION = 256
#: Nor has it more frames, or references more Gaussians ahead.
MAX_ITEMS = 256


@dataclass(frozen=True, slots=True)
class TaskFrameState:
    """One received frame: its map (None while it is missing) and the weight of its precision, 0..1."""

    frame: Frame | None
    weight: float
    status: FrameStatus


def frame_of(tracked: TrackedFrame) -> Frame:
    """The frame where one is, kept for the next time: most poses are published often before they change."""
    assert tracked.pose is not None
    return _frame_of(tracked.pose.tobytes(), b"" if tracked.stretch is None else tracked.stretch.tobytes())


@functools.lru_cache(maxsize=MAX_ITEMS)
def _frame_of(pose: bytes, stretch: bytes) -> Frame:
    values, axes = np.frombuffer(pose), np.frombuffer(stretch).reshape(3, 3) if stretch else None
    return Frame.from_pose(values[:3], values[3:], stretch=axes)


def task_parameters_message(frames: Iterable[TrackedFrame], nanoseconds: int, frame_id: str) -> TaskParameters:
    """All frames of a task at a time; of those that were never seen only the names.

    Parameters
    ----------
    frames
        as tracked
    nanoseconds
        stamp, ns
    frame_id
        the frame that they are expressed in

    Returns
    -------
    TaskParameters
        the message
    """
    message = TaskParameters(header=header_at(nanoseconds, frame_id))
    for tracked in frames:
        item = TaskFrame(
            name=tracked.name,
            status=int(tracked.status),
            confidence=tracked.confidence,
            stamp=time_from_ns(tracked.stamp_ns),
        )
        if tracked.pose is not None:
            frame = frame_of(tracked)
            item.rows, item.cols = frame.A.shape
            item.a = floats(frame.A)
            item.b = floats(frame.b)
            if tracked.covariance is not None:
                item.pose_covariance = floats(tracked.covariance)
        message.frames.append(item)
    return message


def task_parameters(message: TaskParameters) -> dict[str, TaskFrameState]:
    """The frames of a message.

    Parameters
    ----------
    message
        as it came

    Returns
    -------
    dict[str, TaskFrameState]
        by name

    Raises
    ------
    MessageError
        sizes that contradict each other, not finite, an unknown status, a name given twice, too many.
    """
    if len(message.frames) > MAX_ITEMS:
        raise MessageError(f"task parameters name {len(message.frames)} frames; expected {MAX_ITEMS} at most")
    states: dict[str, TaskFrameState] = {}
    for item in message.frames:
        if item.name in states:
            raise MessageError(f"task parameters name the frame {shown(item.name)} twice")
        try:
            status = FrameStatus(item.status)
        except ValueError:
            raise MessageError(
                f"frame {shown(item.name)} has status {item.status}; expected 0 (VISIBLE), 1 (HELD) or 2 (MISSING)"
            ) from None
        if not 0.0 <= item.confidence <= 1.0:
            raise MessageError(f"frame {shown(item.name)} has confidence {item.confidence}; expected 0 to 1")
        if status is FrameStatus.MISSING or item.confidence == 0.0:
            states[item.name] = TaskFrameState(None, 0.0, status)
            continue
        states[item.name] = TaskFrameState(_frame(item), item.confidence, status)
    return states


def _frame(item: TaskFrame) -> Frame:
    rows, cols = item.rows, item.cols
    if not (0 < rows <= MAX_DIMENSION and 0 < cols <= MAX_DIMENSION):
        raise MessageError(f"frame {shown(item.name)} says {rows} x {cols}; expected 1 to {MAX_DIMENSION} each")
    if len(item.a) != rows * cols or len(item.b) != rows:
        raise MessageError(
            f"frame {shown(item.name)} says {rows} x {cols} but holds {len(item.a)} numbers in a and {len(item.b)} in "
            f"b; expected {rows * cols} and {rows}"
        )
    covariance = np.array(item.pose_covariance)
    if len(covariance) not in (0, 36) or np.any(np.abs(covariance) > LARGEST_VARIANCE):
        raise MessageError(
            f"frame {shown(item.name)} holds {len(covariance)} numbers in pose_covariance; expected none, or 36 of "
            f"{LARGEST_VARIANCE:g} at most"
        )
    try:
        P = covariance.reshape(6, 6) if len(covariance) else None
        return Frame(np.array(item.a).reshape(rows, cols), np.array(item.b), pose_covariance=P)
    except ValueError as error:
        raise MessageError(f"frame {shown(item.name)}: {error}") from error
