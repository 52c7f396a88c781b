# SPDX-License-Identifier: Apache-2.0
"""Messages to arrays and back: the only place.

What comes from outside is checked here: a message that is not what it should be raises ``MessageError`` with the
reason, and nothing behind this module has to trust a message's sizes.
Poses are ``[x, y, z, qx, qy, qz, qw]``, m; times are integers in ns.
"""

from __future__ import annotations

from array import array
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from builtin_interfaces.msg import Time as TimeMessage
from geometry_msgs.msg import Pose, PoseStamped, PoseWithCovarianceStamped, WrenchStamped
from numpy.typing import NDArray
from sensor_msgs.msg import JointState
from std_msgs.msg import Header

from tpgmm_core import Frame, Gaussian
from tpgmm_core.common.text import listed, shown
from tpgmm_core.geometry.manifold import Manifold
from tpgmm_core.model.reference import Reference
from tpgmm_core.observation.joint_states import JointColumns, JointSample, JointStateAssembler, JointStateError
from tpgmm_core.observation.tracking import FrameStatus, TrackedFrame
from tpgmm_msgs.msg import ControllerState, TaskFrame, TaskParameters
from tpgmm_msgs.msg import Gaussian as GaussianMessage
from tpgmm_msgs.msg import Reference as ReferenceMessage

Array = NDArray[np.float64]

#: No task has frames of more dimensions than this; a message that says so lies.
MAX_DIMENSION = 256
#: Nor has it more frames, or references more Gaussians ahead.
MAX_ITEMS = 256
#: N and N m: the weight of a ton.
MAX_WRENCH = 1e4


class MessageError(ValueError):
    """A message is not what its type and topic promise."""


def floats(values: Array) -> array[float]:
    """What a ``float64[]`` field takes fastest: going through bytes, no number becomes a Python object."""
    return array("d", np.asarray(values, dtype=np.float64).tobytes())


# -- times ------------------------------------------------------------------------------------------------------------


def time_to_ns(stamp: TimeMessage) -> int:
    """A stamp in ns. More nanoseconds than a second has are none: the stamp is taken for the end of its second."""
    return stamp.sec * 1_000_000_000 + min(stamp.nanosec, 999_999_999)


def time_from_ns(nanoseconds: int) -> TimeMessage:
    """A time as a message."""
    seconds, rest = divmod(nanoseconds, 1_000_000_000)
    return TimeMessage(sec=seconds, nanosec=rest)


def header_at(nanoseconds: int, frame_id: str) -> Header:
    """A header with a stamp, ns, and a frame."""
    return Header(stamp=time_from_ns(nanoseconds), frame_id=frame_id)


# -- poses ------------------------------------------------------------------------------------------------------------


def pose_to_array(pose: Pose) -> Array:
    """(7,): as it came, not checked."""
    position, orientation = pose.position, pose.orientation
    return np.array([position.x, position.y, position.z, orientation.x, orientation.y, orientation.z, orientation.w])


def pose_from_array(pose: Sequence[float] | Array) -> Pose:
    """A pose (7,), m and unit quaternion, as a message."""
    message = Pose()
    message.position.x, message.position.y, message.position.z = (float(value) for value in pose[:3])
    orientation = message.orientation
    orientation.x, orientation.y, orientation.z, orientation.w = (float(value) for value in pose[3:])
    return message


def pose_stamped(pose: Sequence[float] | Array, nanoseconds: int, frame_id: str) -> PoseStamped:
    """A pose with its stamp.

    Parameters
    ----------
    pose
        x, y, z in m, qx, qy, qz, qw
    nanoseconds
        stamp, ns
    frame_id
        the frame that it is expressed in

    Returns
    -------
    PoseStamped
        the message
    """
    return PoseStamped(header=header_at(nanoseconds, frame_id), pose=pose_from_array(pose))


def pose_with_covariance(gaussian: Gaussian, nanoseconds: int, frame_id: str) -> PoseWithCovarianceStamped:
    """A Gaussian over a pose; its tangent coordinates are already those of PoseWithCovariance.

    Parameters
    ----------
    gaussian
        over a pose
    nanoseconds
        stamp, ns
    frame_id
        the frame that it is expressed in

    Returns
    -------
    PoseWithCovarianceStamped
        the message
    """
    message = PoseWithCovarianceStamped(header=header_at(nanoseconds, frame_id))
    message.pose.pose = pose_from_array(gaussian.mean)
    message.pose.covariance = np.ascontiguousarray(gaussian.covariance).ravel()
    return message


def wrench_to_array(message: WrenchStamped) -> Array:
    """Force and torque of a message.

    Parameters
    ----------
    message
        as it came

    Returns
    -------
    Array
        shape (6,): force in N, torque in N m

    Raises
    ------
    MessageError
        not finite, or more than any robot stands.
    """
    force, torque = message.wrench.force, message.wrench.torque
    wrench = np.array([force.x, force.y, force.z, torque.x, torque.y, torque.z])
    if not np.isfinite(wrench).all():
        raise MessageError(f"wrench on {shown(message.header.frame_id)} is not finite: {wrench.tolist()}")
    if np.abs(wrench).max() > MAX_WRENCH:
        raise MessageError(f"a wrench is implausibly large: {wrench.tolist()}; expected {MAX_WRENCH:g} N, N m at most")
    return wrench


def wrench_from_array(wrench: Sequence[float] | Array, nanoseconds: int, link: str) -> WrenchStamped:
    """A wrench on a link, with its stamp.

    Parameters
    ----------
    wrench
        six numbers: force in N, torque in N m
    nanoseconds
        stamp, ns
    link
        name of the link's frame

    Returns
    -------
    WrenchStamped
        the message
    """
    message = WrenchStamped(header=header_at(nanoseconds, link))
    force, torque = message.wrench.force, message.wrench.torque
    force.x, force.y, force.z, torque.x, torque.y, torque.z = (float(value) for value in wrench)
    return message


# -- task parameters --------------------------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True)
class TaskFrameState:
    """One received frame: its map (None while it is missing) and the weight of its precision, 0..1."""

    frame: Frame | None
    weight: float
    status: FrameStatus


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
            frame = Frame.from_pose(tracked.pose[:3], tracked.pose[3:])
            item.rows, item.cols = frame.A.shape
            item.a = floats(frame.A)
            item.b = floats(frame.b)
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
    try:
        return Frame(np.array(item.a).reshape(rows, cols), np.array(item.b))
    except ValueError as error:
        raise MessageError(f"frame {shown(item.name)}: {error}") from error


# -- references -------------------------------------------------------------------------------------------------------


def gaussian_message(gaussian: Gaussian) -> GaussianMessage:
    """A Gaussian as a message."""
    return GaussianMessage(
        manifold=str(gaussian.manifold),
        mean=floats(gaussian.mean),
        covariance=floats(gaussian.covariance),
    )


def gaussian(message: GaussianMessage) -> Gaussian:
    """The Gaussian of a message.

    Parameters
    ----------
    message
        as it came

    Returns
    -------
    Gaussian
        the Gaussian, checked

    Raises
    ------
    MessageError
        for a manifold that is none, sizes that contradict each other, and numbers that are not finite
    """
    dimension = len(message.mean)
    if not 0 < dimension <= MAX_DIMENSION:
        raise MessageError(f"a Gaussian's mean has {dimension} numbers; expected 1 to {MAX_DIMENSION}")
    try:
        manifold = (
            Manifold.euclidean(dimension) if message.manifold == "euclidean" else Manifold.parse(message.manifold)
        )
    except ValueError as error:
        raise MessageError(str(error)) from error
    size = manifold.tangent_dim
    if manifold.dim != dimension or len(message.covariance) != size * size:
        raise MessageError(
            f"a Gaussian on {shown(message.manifold)} holds {dimension} numbers in its mean and "
            f"{len(message.covariance)} in its covariance; expected {manifold.dim} and {size * size}"
        )
    mean, covariance = np.array(message.mean), np.array(message.covariance).reshape(size, size)
    if not (np.isfinite(mean).all() and np.isfinite(covariance).all()):
        raise MessageError("a Gaussian's mean or covariance is not finite")
    try:
        return Gaussian(mean, covariance, manifold)
    except ValueError as error:
        raise MessageError(str(error)) from error


def reference_message(
    reference: Reference, dimensions: Sequence[str], nanoseconds: int, frame_id: str
) -> ReferenceMessage:
    """A reference at a time.

    Parameters
    ----------
    reference
        to be sent
    dimensions
        names of the coordinates of its mean
    nanoseconds
        stamp, ns
    frame_id
        the frame that it is expressed in

    Returns
    -------
    ReferenceMessage
        the message
    """
    return ReferenceMessage(
        header=header_at(nanoseconds, frame_id),
        phase=reference.phase,
        dimensions=list(dimensions),
        gaussian=gaussian_message(reference.gaussian),
        horizon_time_step=reference.horizon_time_step,
        horizon=[gaussian_message(ahead) for ahead in reference.horizon],
        activations=floats(reference.activations),
        frames=list(reference.frames),
    )


def reference(message: ReferenceMessage) -> Reference:
    """The reference of a message.

    Parameters
    ----------
    message
        as it came

    Returns
    -------
    Reference
        the reference, checked

    Raises
    ------
    MessageError
        for a Gaussian that is none, and a phase or a time step that is not finite
    """
    if not (np.isfinite(message.phase) and np.isfinite(message.horizon_time_step)):
        raise MessageError(
            f"a reference's phase ({message.phase}) or horizon time step ({message.horizon_time_step}) is not finite"
        )
    if len(message.horizon) > MAX_ITEMS:
        raise MessageError(f"a reference holds {len(message.horizon)} Gaussians ahead; expected {MAX_ITEMS} at most")
    return Reference(
        phase=message.phase,
        gaussian=gaussian(message.gaussian),
        horizon_time_step=message.horizon_time_step,
        horizon=tuple(gaussian(ahead) for ahead in message.horizon),
        activations=np.array(message.activations),
        frames=tuple(message.frames),
        dimensions=tuple(message.dimensions),
    )


# -- terms of torques -------------------------------------------------------------------------------------------------


def torque_terms(terms: Mapping[str, Array]) -> tuple[list[str], array[float]]:
    """`term_names` and `terms` of a ControllerState, from each term's torques (n,)."""
    return list(terms), floats(np.concatenate([np.zeros(0), *terms.values()]))


def terms_of(message: ControllerState) -> dict[str, Array]:
    """The torques of each term of the law.

    Parameters
    ----------
    message
        as it came

    Returns
    -------
    dict[str, Array]
        term → torques (n,), N m, in the order of the message's joints

    Raises
    ------
    MessageError
        as many numbers as no terms of these joints have, a name given twice.
    """
    names, joints = list(message.term_names), len(message.joints)
    if len(message.terms) != len(names) * joints or len(set(names)) != len(names):
        raise MessageError(
            f"{len(message.terms)} numbers for the terms {listed(names)} of {joints} joints; expected "
            f"{len(names) * joints}, and each name once"
        )
    return dict(zip(names, np.array(message.terms).reshape(len(names), joints), strict=True))


# -- joints -----------------------------------------------------------------------------------------------------------


def joint_state_message(
    names: list[str],
    nanoseconds: int,
    position: Array | None = None,
    velocity: Array | None = None,
    effort: Array | None = None,
) -> JointState:
    """States of joints.

    Parameters
    ----------
    names
        of the joints
    nanoseconds
        stamp, ns
    position
        rad, or m for prismatic joints; None: left empty
    velocity
        rad/s or m/s; None: left empty
    effort
        N m or N; None: left empty

    Returns
    -------
    JointState
        the message
    """
    message = JointState(header=Header(stamp=time_from_ns(nanoseconds)), name=names)
    if position is not None:
        message.position = floats(position)
    if velocity is not None:
        message.velocity = floats(velocity)
    if effort is not None:
        message.effort = floats(effort)
    return message


class JointReader:
    """Reads arrays of all its joints out of single JointState messages: what has no use in parts, as torques.

    Parameters
    ----------
    names
        the joints, in the order in which the arrays are wanted
    """

    def __init__(self, names: Sequence[str]) -> None:
        self.names = list(names)
        self._columns: dict[tuple[str, ...], JointColumns] = {}

    def read(self, message: JointState, *fields: str) -> tuple[Array, ...]:
        """Read fields of a message.

        Parameters
        ----------
        message
            as it came
        *fields
            "position", "velocity", "effort"

        Returns
        -------
        tuple[Array, ...]
            shape (len(names),) for each field

        Raises
        ------
        MessageError
            joints are missing or named twice, a field has another length than the names, not finite.
        """
        columns = self._columns.setdefault(fields, JointColumns(self.names, fields))
        try:
            found = columns.read(message.name, [getattr(message, field) for field in fields])
        except JointStateError as error:
            raise MessageError(str(error)) from error
        if not columns.is_whole:
            missing = [self.names[i] for i in range(len(self.names)) if i not in columns.own]
            raise MessageError(f"joints missing: {listed(missing)}; the message names {listed(message.name)}")
        return found


class JointStates:
    """Reads states of all its joints out of JointState messages, each of which may hold a part; see the core.

    Parameters
    ----------
    names, fields
        which joints, and what of them, in which order
    max_spread
        the parts of one state may be this far apart, s
    """

    def __init__(self, names: Sequence[str], fields: Sequence[str], max_spread: float) -> None:
        self._fields = tuple(fields)
        self._assembler = JointStateAssembler(names, fields, max_spread)
        self.forget, self.incomplete = self._assembler.forget, self._assembler.incomplete

    def take(self, message: JointState) -> JointSample | None:
        """Take a message.

        Parameters
        ----------
        message
            as it came

        Returns
        -------
        JointSample | None
            the state that it completes; None where it completes none

        Raises
        ------
        MessageError
            an own joint is named twice or not finite, or a field has another length than the names.
        """
        columns = [getattr(message, field) for field in self._fields]
        try:
            return self._assembler.take(message.name, columns, time_to_ns(message.header.stamp))
        except JointStateError as error:
            raise MessageError(str(error)) from error
