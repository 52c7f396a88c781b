# SPDX-License-Identifier: Apache-2.0
"""Joint states as messages and back."""

from __future__ import annotations

from collections.abc import Sequence

from sensor_msgs.msg import JointState
from std_msgs.msg import Header

from tpgmm_core.common.text import listed
from tpgmm_core.common.types import Array
from tpgmm_core.observation.joint_states import JointColumns, JointSample, JointStateAssembler, JointStateError
from tpgmm_ros.messages.basic_messages import MessageError, floats, time_from_ns
from tpgmm_ros.messages.joint_state_bytes import JointStateValues


def joint_state_of_values(values: JointStateValues) -> JointState:
    """The message that holds these values."""
    return joint_state_message(list(values.name), values.stamp_ns, values.position, values.velocity, values.effort)


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

    def take(self, message: JointStateValues) -> JointSample | None:
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
            return self._assembler.take(message.name, columns, message.stamp_ns)
        except JointStateError as error:
            raise MessageError(str(error)) from error
