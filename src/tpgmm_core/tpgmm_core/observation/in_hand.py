# SPDX-License-Identifier: Apache-2.0
"""`Hand`: which frames move with the robot's hand while nobody sees them; one rule for topics and recordings.

What a hand carries it covers, too. A thing that lay beside the hand when it was last seen may be in it by now, or not:
that cannot be known, and it is where it was. It moves with the hand only if it was seen to do so: up to its last
observation it kept its place in the hand, while it moved itself. Then it is known as well as it kept that place, and
worse the farther it has gone unseen, since things slip.

Where a gripper tells whether it holds something, that is known: what was near the hand when it closed moves with it,
and is where the hand was when it opened again. What it does not hold does not move with it, whatever was seen.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Iterable
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import ArrayLike, NDArray

from tpgmm_core.common.types import Array, Nanoseconds
from tpgmm_core.geometry import quaternion
from tpgmm_core.geometry.pose import compose, inverse, pose_error, turned_covariance
from tpgmm_core.observation.streams import SECOND
from tpgmm_core.observation.transforms import TransformError, TransformTree

#: A frame keeps its place in the hand where that changes by no more, m and rad.
WITHIN = 0.01, 0.1
#: It moves with the hand once it has moved by so much meanwhile, m or rad: more than an error of where it is seen.
MOVED = 0.04, 0.4
#: The share of what it moves unseen that is added to the standard deviation of where it is.
SLIP = 0.1
#: What is no farther from the hand when its gripper closes is in it, m.
REACH = 0.1
#: So long the hand's former places are known, s; observations of a camera are late.
MEMORY = 3.0
#: So many observations of a frame wait for the hand's pose of their time.
MOST_WAITING = 32

_BASE, _HAND = "base", "hand"


@dataclass(slots=True)
class _Run:
    """Observations up to the last one in which a frame kept its place in the hand."""

    begin: Array
    """In the base, at the first of them."""
    in_hand: Array
    """In the hand, at the first of them."""
    latest: Array
    """In the hand, at the last of them."""
    moved: bool = False


@dataclass(slots=True)
class _Seen:
    run: _Run | None = None
    waiting: deque[tuple[int, Array | bool]] = field(default_factory=lambda: deque(maxlen=MOST_WAITING))
    """Times, and where it was seen then, or whether the gripper was closed from then on."""
    closed: bool | None = None
    """The gripper; None where it has not said."""
    known: Array | None = None
    """In the base, where it was seen or let go last."""
    held: Array | None = None
    """In the hand, as long as the gripper holds it."""
    left: Array | None = None
    """In the base, where the gripper let it go, as long as it has not been seen there."""


class Hand:
    """Where the hand is, and the frames that may move with it.

    Parameters
    ----------
    names
        of these frames
    memory
        how long the hand's former places are known, s; None: for ever, for recordings

    Attributes
    ----------
    pose
        the hand's newest pose (7,) in the base; None before the first one
    """

    def __init__(self, names: Iterable[str], memory: float | None = MEMORY) -> None:
        self._frames = {name: _Seen() for name in names}
        self._tree = TransformTree(memory)
        self.pose: Array | None = None
        self._stamp_ns = self._came_ns = 0

    def __contains__(self, name: object) -> bool:
        """Whether a frame is one that may move with it."""
        return name in self._frames

    def forget(self) -> None:
        """Start anew: time jumped backwards."""
        self._tree.forget()
        self.pose, self._stamp_ns = None, 0
        self._frames = {name: _Seen() for name in self._frames}

    def take(self, pose: ArrayLike, stamp_ns: int, steady_ns: int = 0) -> str:
        """See the hand.

        Parameters
        ----------
        pose
            (7,) in the base
        stamp_ns
            when it was there, ns
        steady_ns
            steady time at arrival, ns

        Returns
        -------
        str
            why it is not used: kind, ":", details; empty where it is
        """
        if reason := self._tree.add(_BASE, _HAND, pose, stamp_ns):
            return reason
        if self.pose is None or stamp_ns > self._stamp_ns:
            self.pose, self._stamp_ns, self._came_ns = self._tree.pose(_HAND, _BASE, stamp_ns), stamp_ns, steady_ns
            for seen in self._frames.values():
                self._work_off(seen)
        return ""

    def age(self, steady_ns: int) -> float:
        """Time since the hand's newest pose came, s."""
        return math.inf if self.pose is None else (steady_ns - self._came_ns) / SECOND

    def see(self, name: str, pose: Array, stamp_ns: int) -> None:
        """See a frame (7,) at a time, ns: this counts once the hand's pose at that time is known."""
        seen = self._frames[name]
        seen.waiting.append((stamp_ns, pose))
        self._work_off(seen)

    def grip(self, name: str, closed: bool, stamp_ns: int) -> None:
        """Hear whether the gripper that may hold a frame is closed from a time on, ns; only changes count."""
        seen = self._frames[name]
        told = [entry for _, entry in seen.waiting if isinstance(entry, bool)]
        if closed != (told[-1] if told else seen.closed):
            seen.waiting.append((stamp_ns, bool(closed)))
            self._work_off(seen)

    def holds(self, name: str) -> bool:
        """Whether the gripper has said that it holds a frame."""
        return self._frames[name].held is not None

    def moves(self, name: str) -> bool:
        """Whether a frame moves with the hand: its gripper holds it, or it was seen to, up to its last observation."""
        seen = self._frames[name]
        return seen.held is not None or (seen.closed is not False and seen.run is not None and seen.run.moved)

    def left(self, name: str) -> Array | None:
        """Where (7,) the gripper has let a frame go; None where it has not, or the frame was seen since."""
        return self._frames[name].left

    def why(self, name: str) -> str:
        """In words, how it is known whether a frame moves with the hand."""
        seen = self._frames[name]
        if seen.held is not None:
            return "moves with the hand, whose gripper holds it"
        if self.moves(name):
            return "moves with the hand, as it did when it was last seen"
        if seen.left is not None:
            return "stays where the gripper let it go"
        if seen.closed is False:
            return "stays where it was: the gripper is open"
        return "stays where it was: it was not seen to move with the hand"

    def place(self, name: str, hand: Array | None = None) -> Array:
        """Where a frame that moves with the hand is now, (7,), or with the hand at other poses (..., 7)."""
        seen = self._frames[name]
        at = self.pose if hand is None else hand
        in_hand = seen.held if seen.held is not None else seen.run.latest if seen.run is not None else None
        assert in_hand is not None and at is not None
        return compose(at, np.broadcast_to(in_hand, at.shape))

    def _work_off(self, seen: _Seen) -> None:
        while seen.waiting:
            stamp_ns, entry = seen.waiting[0]
            hand: Array | None = None
            try:
                hand = self._tree.pose(_HAND, _BASE, stamp_ns)
            except TransformError as error:
                if error.may_come or self.pose is None:
                    return
            if isinstance(entry, bool):
                _grip(seen, entry, hand)
            else:
                _see(seen, entry, hand)
            seen.waiting.popleft()


def _see(seen: _Seen, pose: Array, hand: Array | None) -> None:
    """Take an observation, with the hand where it was then; None: that is not known."""
    seen.known, seen.left = pose, None
    if hand is None:
        seen.run = seen.held = None
        return
    in_hand = compose(inverse(hand), pose)
    seen.run = _gone_on(seen.run, pose, in_hand)
    if seen.held is not None:  # seen elsewhere, it is not held; seen in the hand, it is held as it is seen
        seen.held = in_hand if pose_error(pose, hand)[0] <= REACH else None


def _grip(seen: _Seen, closed: bool, hand: Array | None) -> None:
    """Take a change of the gripper: what is near is held from now on, or is let go here."""
    seen.closed, seen.run = closed, None
    if closed:
        if hand is not None and seen.known is not None and pose_error(seen.known, hand)[0] <= REACH:
            seen.held = compose(inverse(hand), seen.known)
    elif seen.held is not None:
        if hand is not None:
            seen.known = seen.left = compose(hand, seen.held)
        seen.held = None


def _gone_on(run: _Run | None, pose: Array, in_hand: Array) -> _Run:
    """The run with one more observation, or a new one that begins with it."""
    if run is None or any(e > most for e, most in zip(pose_error(in_hand, run.in_hand), WITHIN, strict=True)):
        return _Run(pose, in_hand, in_hand)
    run.latest = in_hand
    run.moved |= any(e >= least for e, least in zip(pose_error(pose, run.begin), MOVED, strict=True))
    return run


def carried_covariance(covariance: Array | None, seen: Array, place: Array) -> Array:
    """How well the pose of a frame is known that moves with the hand unseen.

    Parameters
    ----------
    covariance
        (6, 6) of its last observation, m² and rad²; None where none is known
    seen, place
        (7,), where it was then, and where it is now by the hand

    Returns
    -------
    Array
        (6, 6)
    """
    deviations = [least + SLIP * gone for least, gone in zip(WITHIN, pose_error(place, seen), strict=True)]
    added = np.diag(np.repeat(np.square(deviations), 3))
    if covariance is None:
        return added
    turn = quaternion.multiply(place[3:], quaternion.conjugate(seen[3:]))
    return turned_covariance(covariance, turn) + added


def carried_poses(
    at: Nanoseconds,
    hand: Array,
    seen_at: Nanoseconds,
    seen: Array,
    held: Array,
    timeout: float,
    gripper: tuple[Nanoseconds, NDArray[np.bool_]] | None = None,
) -> tuple[Array, NDArray[np.bool_]]:
    """Where a frame of a recording was that may move with the hand.

    Parameters
    ----------
    at
        (T,) ns, increasing
    hand
        (T, 7), where the hand was then
    seen_at, seen
        (S,) ns, increasing, and (S, 7): observations of the frame
    held
        (T, 7), the latest of these at each time
    timeout
        after so long without an observation it counts as not seen, s
    gripper
        (G,) ns, increasing, and (G,), whether the gripper was closed then; None: it does not say

    Returns
    -------
    tuple[Array, NDArray[np.bool_]]
        poses (T, 7), and where (T,) it moved with the hand
    """
    rule, poses, moved = Hand(["frame"], None), held.copy(), np.zeros(len(at), bool)
    for stamp, pose in zip(at.tolist(), hand, strict=True):
        rule.take(pose, stamp)
    # at the same time, the frame is seen first, as the newest pose is what a gripper closes around
    events: list[tuple[int, Array | bool]] = list(zip(seen_at.tolist(), seen, strict=True))
    if gripper is not None:
        events += [(stamp, bool(closed)) for stamp, closed in zip(gripper[0].tolist(), gripper[1], strict=True)]
    events.sort(key=lambda event: event[0])
    ends = np.append(np.searchsorted(at, [stamp for stamp, _ in events[1:]]), len(at))
    unseen = 0
    for (stamp, entry), end in zip(events, ends, strict=True):
        if isinstance(entry, bool):
            rule.grip("frame", entry, stamp)
        else:
            rule.see("frame", entry, stamp)
            unseen = int(np.searchsorted(at, stamp + round(timeout * SECOND), side="right"))
        begin = max(unseen, int(np.searchsorted(at, stamp)))
        if begin >= end:
            continue
        if rule.moves("frame"):
            poses[begin:end], moved[begin:end] = rule.place("frame", hand[begin:end]), True
        elif (left := rule.left("frame")) is not None:
            poses[begin:end] = left
    return poses, moved
