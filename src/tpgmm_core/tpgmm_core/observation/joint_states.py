# SPDX-License-Identifier: Apache-2.0
"""Joint states out of messages with any set of joints: more than the robot's, fewer, others, in any order.

A robot's joints may come in one message or in several, one from each driver, and those of a gripper on the
same topic. A state is complete when each own joint has come since the last state, none of them older than a bound. Its
stamp is that of its oldest part, so that its age is not underestimated. A message about other joints only is ignored:
no state and no fault.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from tpgmm_core.common.text import listed
from tpgmm_core.common.types import Array, Indices
from tpgmm_core.observation.streams import SECOND

#: The parts of one state may be this far apart by default, s.
MAX_SPREAD = 0.02


class JointStateError(ValueError):
    """A message that holds own joints, and cannot be used."""


@dataclass(frozen=True, slots=True)
class JointSample:
    """One state.

    Parameters
    ----------
    stamp_ns
        of its oldest part, ns
    values
        one (n,) for each field, in the order of the joints
    """

    stamp_ns: int
    values: tuple[Array, ...]


class JointColumns:
    """Finds joints in messages by name, never by position; the order is computed once and kept while names stay.

    Parameters
    ----------
    joints
        n names, in the order in which values are wanted
    fields
        names of the columns of a message
    """

    def __init__(self, joints: Sequence[str], fields: Sequence[str]) -> None:
        self.joints, self.fields = tuple(joints), tuple(fields)
        self.names: list[str] | None = None
        self._at = {name: index for index, name in enumerate(self.joints)}
        self.own: Indices = np.zeros(0, dtype=np.intp)
        self._places: Indices = self.own
        self.is_whole = False

    def read(self, names: Sequence[str], columns: Sequence[ArrayLike]) -> tuple[Array, ...]:
        """The values of the own joints in a message, (m,) for each field; `own` (m,) says which joints these are.

        Parameters
        ----------
        names
            of the message's joints
        columns
            as many numbers as names, for each field

        Returns
        -------
        tuple[Array, ...]
            shape (m,) for each field, in the order of `own`; empty for a message without own joints

        Raises
        ------
        JointStateError
            when an own joint is named twice, a column has another length than the names, or an own joint's value is not
            finite. A message without own joints raises nothing, whatever it holds
        """
        if names != self.names:
            self._learn(names)
        if not len(self.own):
            return ()
        found = []
        for field, column in zip(self.fields, columns, strict=True):
            values = np.asarray(column, dtype=np.float64)
            if len(values) != len(names):
                raise JointStateError(_wrong_length(field, len(values), len(names)))
            values = values[self._places]
            finite = np.isfinite(values)
            if not finite.all():
                bad = [self.joints[i] for i, ok in zip(self.own, finite, strict=True) if not ok]
                raise JointStateError(f"{field} of {listed(bad)} is not finite")
            found.append(values)
        return tuple(found)

    def _learn(self, names: Sequence[str]) -> None:
        places: dict[int, int] = {}
        for place, name in enumerate(names):
            joint = self._at.get(name)
            if joint is None:
                continue
            if joint in places:
                raise JointStateError(f"{name} is named twice in one message; it names {listed(names)}")
            places[joint] = place
        self.own = np.array(sorted(places), dtype=np.intp)  # values come in the order of the joints
        self._places = np.array([places[int(joint)] for joint in self.own], dtype=np.intp)
        self.is_whole = len(self.own) == len(self.joints)
        self.names = list(names)


class JointStateAssembler:
    """Messages in, complete states out; see the module.

    A part that was overtaken by a newer one of the same joint is ignored. A whole message is a state by itself,
    also one with the stamp of the last: `StreamWatch` decides whether a state is new.

    Parameters
    ----------
    joints, fields
        as for `JointColumns`
    max_spread
        the parts of one state may be this far apart, s
    """

    def __init__(self, joints: Sequence[str], fields: Sequence[str], max_spread: float = MAX_SPREAD) -> None:
        self.columns = JointColumns(joints, fields)
        self._spread_ns = round(max_spread * SECOND)
        self.forget()

    def forget(self) -> None:
        """Start without any message."""
        n = len(self.columns.joints)
        self._values = np.zeros((len(self.columns.fields), n))
        self._stamps = np.zeros(n, dtype=np.int64)
        self._known, self._fresh = np.zeros(n, dtype=bool), np.zeros(n, dtype=bool)

    def take(self, names: Sequence[str], columns: Sequence[ArrayLike], stamp_ns: int) -> JointSample | None:
        """The state that a message completes, None where it completes none.

        Parameters
        ----------
        names, columns
            as for `JointColumns.read`
        stamp_ns
            of the message

        Returns
        -------
        JointSample | None
            the state, with the latest values of all joints

        Raises
        ------
        JointStateError
            like `JointColumns.read`
        """
        found = self.columns.read(names, columns)
        if not found:
            return None
        own = self.columns.own
        if self.columns.is_whole:
            self._stamps[:], self._known[:], self._fresh[:] = stamp_ns, True, False
            return JointSample(stamp_ns, found)
        if self._known[own].all() and 0 < int(self._stamps[own].max()) - stamp_ns <= self._spread_ns:
            return None
        self._values[:, own], self._stamps[own] = found, stamp_ns
        self._known[own] = self._fresh[own] = True
        if not self._fresh.all() or self._old().any():
            return None
        self._fresh[:] = False
        return JointSample(int(self._stamps.min()), tuple(values.copy() for values in self._values))

    def incomplete(self) -> str:
        """Why the messages since the last state are no state yet, in words."""
        joints = self.columns.joints
        missing = [name for name, fresh in zip(joints, self._fresh, strict=True) if not fresh]
        if missing:
            which = "none of its joints arrived" if len(missing) == len(joints) else f"missing {listed(missing)}"
            return f"{which}; the last message names {listed(self.columns.names or ())}"
        old = self._old()
        late = listed(name for name, is_old in zip(joints, old, strict=True) if is_old)
        apart = (int(self._stamps.max()) - int(self._stamps.min())) / SECOND
        return f"{late} came {apart:.3g} s earlier than the others; {self._spread_ns / SECOND:g} s is allowed"

    def _old(self) -> NDArray[np.bool_]:
        return self._stamps < self._stamps.max() - self._spread_ns


def _wrong_length(field: str, length: int, names: int) -> str:
    if length == 0:
        return f"{field} is empty, but needed: let the driver publish {field} too"
    return f"{field} has {length} numbers for {names} joint names; expected as many"
