# SPDX-License-Identifier: Apache-2.0
"""Lockstep: a graph that computes the same numbers, however its processes are scheduled.

Each node answers each input of a tick once, and only when all that belongs to this tick has come; which message came
first makes no difference then (a process network: Kahn, "The semantics of a simple language for parallel programming",
1974). So that no node waits for what does not come, a node without an answer says that it has none: by an invalid pose,
or by a reference without a Gaussian. Time stands still until all have answered. A state that was not answered comes
again; a node that has answered it already gives the same answer.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable

import numpy as np
from geometry_msgs.msg import PoseStamped

from tpgmm_msgs.msg import Reference as ReferenceMessage
from tpgmm_ros.messages import conversions


class Barrier[ItemT]:
    """Holds the newest item back until each of the other inputs has the stamp of the item's tick.

    Parameters
    ----------
    inputs
        names of the other inputs
    act
        called with the item as soon as they are there
    period_ns
        of the ticks of the other inputs, ns; 1: they have a message for each item
    """

    def __init__(self, inputs: Iterable[str], act: Callable[[ItemT], None], period_ns: int = 1) -> None:
        self._act, self._period_ns = act, period_ns
        self._stamps: dict[str, int | None] = dict.fromkeys(inputs)
        self._held: tuple[ItemT, int] | None = None

    def take(self, item: ItemT, stamp_ns: int) -> None:
        """The next item; one that is still held is given up for it."""
        self._held = item, stamp_ns - stamp_ns % self._period_ns
        self._release()

    def came(self, name: str, stamp_ns: int) -> None:
        """A message of another input was taken."""
        self._stamps[name] = stamp_ns
        self._release()

    def _release(self) -> None:
        if self._held is not None:
            item, due_ns = self._held
            if all(stamp_ns == due_ns for stamp_ns in self._stamps.values()):
                self._held = None
                self._act(item)


class LateBarrier[ItemT]:
    """Holds a tick back until each input has answered it, also with items that are older than the tick.

    A camera tells late what it saw, with the stamp of its image. It answers each tick with one message for each frame:
    either with what it knows since then, or with nothing, at the stamp of the tick. A message that comes again answers
    nothing. Inputs are in order, and time stands still until all have answered: so whatever is new belongs to the tick
    that is not yet answered, be its stamp as old as it may.

    Parameters
    ----------
    inputs
        names of the inputs
    act
        called with the stamp of the tick, ns, and each input's item, None for nothing
    again
        called with the stamp of a tick that was answered already
    """

    def __init__(
        self,
        inputs: Iterable[str],
        act: Callable[[int, dict[str, ItemT | None]], None],
        again: Callable[[int], None],
    ) -> None:
        self._inputs, self._act, self._again = tuple(inputs), act, again
        self._due_ns = self._answered_ns = -1
        self._new: dict[str, tuple[int, ItemT | None]] = {}
        self._taken: dict[str, tuple[int, bool]] = {}

    def tick(self, stamp_ns: int) -> None:
        """The next tick, or the same one once more; one of an earlier time begins anew."""
        if stamp_ns < self._due_ns:
            self._new.clear()
            self._taken.clear()
        self._due_ns = stamp_ns
        if stamp_ns == self._answered_ns:
            self._again(stamp_ns)
        else:
            self._release()

    def came(self, name: str, stamp_ns: int, item: ItemT | None) -> None:
        """An item of an input; None: it has nothing to say at this tick."""
        if self._taken.get(name) != (stamp_ns, item is None):
            self._new[name] = stamp_ns, item
            self._release()

    def _release(self) -> None:
        due_ns = self._due_ns
        if due_ns == self._answered_ns or len(self._new) < len(self._inputs):
            return
        if any(stamp_ns != due_ns if item is None else stamp_ns > due_ns for stamp_ns, item in self._new.values()):
            return
        new, self._new = self._new, {}
        self._taken = {name: (stamp_ns, item is None) for name, (stamp_ns, item) in new.items()}
        self._answered_ns = due_ns
        self._act(due_ns, {name: item for name, (_, item) in new.items()})


def nothing_seen(stamp_ns: int, frame_id: str) -> PoseStamped:
    """What perception says of a frame that it looked for and did not see."""
    return conversions.pose_stamped(np.full(7, np.nan), stamp_ns, frame_id)


def is_nothing_seen(message: PoseStamped) -> bool:
    """Whether a message is one of `nothing_seen`."""
    return bool(np.isnan(conversions.pose_to_array(message.pose)).all())


def no_reference(stamp_ns: int, frame_id: str) -> ReferenceMessage:
    """What a reproduction says while nothing is reproduced."""
    return ReferenceMessage(header=conversions.header_at(stamp_ns, frame_id))


def is_no_reference(message: ReferenceMessage) -> bool:
    """Whether a message is one of `no_reference`."""
    return not message.gaussian.mean
