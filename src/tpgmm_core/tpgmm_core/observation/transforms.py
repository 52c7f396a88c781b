# SPDX-License-Identifier: Apache-2.0
"""`TransformTree`: where frames are that transforms lead to, as on the topics /tf and /tf_static of ROS.

A transform says where a child is in its parent at a time. Chains of them are composed at one time: each transform is
interpolated to it, the position linearly and the orientation along the shortest turn. What is asked before the first or
after the last transform is refused: nothing is invented. Frame ids may have the leading slash of ROS 1.
"""

from __future__ import annotations

from bisect import bisect_left, bisect_right
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import ArrayLike

from tpgmm_core.common.text import listed, shown
from tpgmm_core.common.types import Array
from tpgmm_core.geometry import quaternion
from tpgmm_core.geometry.pose import compose, inverse
from tpgmm_core.observation.poses import check_pose
from tpgmm_core.observation.streams import SECOND

#: How the text of a `TransformError` begins where no transforms lead from one frame to the other.
NO_TRANSFORM = "no transform: "
#: And where some lead there at other times.
NO_TRANSFORM_YET = "no transform at this time"


BY_TURNS_S = 1.0
"""A frame that comes back to a parent so soon after it left it has two publishers; a thing that is grasped does not."""


SAME_M, SAME_RAD = 1e-3, 1e-2
"""Transforms that differ by less are the same, written with fewer digits."""


class TransformError(ValueError):
    """A frame whose place is not known: kind, ":", details.

    Parameters
    ----------
    text
        why
    may_come
        whether newer transforms may tell it
    """

    def __init__(self, text: str, may_come: bool = False) -> None:
        super().__init__(text)
        self.may_come = may_come


@dataclass(slots=True)
class _Link:
    parent: str
    is_static: bool
    stamps: list[int] = field(default_factory=list)
    poses: list[Array] = field(default_factory=list)
    former: tuple[str, int] = ("", 0)
    contested_ns: int | None = None

    def follows(self, other: _Link) -> None:
        """Remember the parent before; one that comes back so soon after it was left, comes by turns."""
        self.former = other.parent, other.stamps[-1]
        self.contested_ns = other.contested_ns
        parent, last_ns = other.former
        if parent == self.parent and self.stamps[-1] - last_ns < BY_TURNS_S * SECOND:
            self.contested_ns = self.stamps[-1]


class TransformTree:
    """Transforms in, poses of frames at times out.

    Parameters
    ----------
    memory
        how long a transform is kept after newer ones have come, s; None: for ever, for recordings
    """

    def __init__(self, memory: float | None = 10.0) -> None:
        self._memory_ns = None if memory is None else round(memory * SECOND)
        self._links: dict[str, _Link] = {}
        #: By frame: why it cannot be at rest, though a static transform leads to it, in words.
        self.unsteady: dict[str, str] = {}

    def forget(self) -> None:
        """Forget what moves: time jumped backwards. Static transforms hold at all times."""
        self._links = {child: link for child, link in self._links.items() if link.is_static}

    def still(self) -> TransformTree:
        """A tree of the static transforms alone, which goes on by itself."""
        tree = TransformTree(None if self._memory_ns is None else self._memory_ns / SECOND)
        tree._links = {child: link for child, link in self._links.items() if link.is_static}
        return tree

    def add(self, parent: str, child: str, pose: ArrayLike, stamp_ns: int, is_static: bool = False) -> str:
        """Add a transform.

        Parameters
        ----------
        parent, child
            frame ids
        pose
            of the child in the parent, (7,)
        stamp_ns
            when it was there, ns
        is_static
            whether it is there at all times

        Returns
        -------
        str
            why it is not used: kind, ":", details; empty where it is
        """
        parent, child = parent.removeprefix("/"), child.removeprefix("/")
        checked, reason = check_pose(pose)
        if checked is None:
            return f"{reason} (transform from {shown(parent)} to {shown(child)})"
        if not parent or not child or parent == child:
            return f"wrong frame_id: a transform from {shown(parent)} to {shown(child)}"
        link = self._links.get(child)
        if link is not None and (is_static or link.is_static) and (how := _difference(link, parent, checked)):
            self.unsteady[child] = (
                f"{shown(child)} has a static transform and another one that contradicts it, {how}: the last one "
                "counts; end one of the two that publish them"
            )
        if link is None or is_static or (link.parent, link.is_static) != (parent, False):
            # a child has one parent; what it had before does not count
            self._links[child] = _Link(parent, is_static, [stamp_ns], [checked])
            if link is not None and not is_static and not link.is_static:
                self._links[child].follows(link)
            return ""
        at = len(link.stamps) if stamp_ns > link.stamps[-1] else bisect_left(link.stamps, stamp_ns)
        if at < len(link.stamps) and link.stamps[at] == stamp_ns:
            link.poses[at] = checked
            return ""
        link.stamps.insert(at, stamp_ns)
        link.poses.insert(at, checked)
        if self._memory_ns is not None and link.stamps[0] < link.stamps[-1] - 2 * self._memory_ns:
            old = bisect_left(link.stamps, link.stamps[-1] - self._memory_ns)
            del link.stamps[:old], link.poses[:old]
        return ""

    def contradictions(self, frame: str, base: str) -> list[str]:
        """Why what leads from a frame to a base cannot be at rest, though it is said to be, in words."""
        up, down = self._chains(frame, base)
        return self._unsteady_among([*up, *down])

    def _unsteady_among(self, children: list[str]) -> list[str]:
        return [self.unsteady[child] for child in children if child in self.unsteady]

    def latest(self, frame: str, base: str) -> int | None:
        """The newest time at which a frame is known in the base.

        Parameters
        ----------
        frame, base
            frame ids

        Returns
        -------
        int or None
            ns; None where only static transforms lead there: it is known at all times

        Raises
        ------
        TransformError
            no transforms lead from one to the other
        """
        times = [link.stamps[-1] for link in self._between(frame, base) if not link.is_static]
        return min(times, default=None)

    def pose(self, frame: str, base: str, stamp_ns: int | None) -> Array:
        """Where a frame is in the base at a time.

        Parameters
        ----------
        frame, base
            frame ids
        stamp_ns
            ns; None for what is static

        Returns
        -------
        Array
            shape (7,), with a unit quaternion

        Raises
        ------
        TransformError
            no transforms lead from one to the other, or they are not known at this time
        """
        up, down = self._chains(frame, base)
        pose = self._composed(up, stamp_ns)
        return compose(inverse(self._composed(down, stamp_ns)), pose) if down else pose

    def _composed(self, chain: list[str], stamp_ns: int | None) -> Array:
        """Pose of the first of a chain in the parent of its last."""
        if not chain:
            return np.array([0.0, 0.0, 0.0, *quaternion.IDENTITY])
        pose = self._at(chain[0], stamp_ns).copy()
        for child in chain[1:]:
            pose = compose(self._at(child, stamp_ns), pose)
        return pose

    def _at(self, child: str, stamp_ns: int | None) -> Array:
        link = self._links[child]
        if link.is_static or stamp_ns is None:
            return link.poses[-1]
        stamps, poses = link.stamps, link.poses
        if not stamps[0] <= stamp_ns <= stamps[-1]:
            early = stamp_ns < stamps[0]
            by = (stamps[0] - stamp_ns if early else stamp_ns - stamps[-1]) / SECOND
            raise TransformError(
                f"{NO_TRANSFORM_YET}: the one from {shown(link.parent)} to {shown(child)} was requested "
                f"{by:.3f} s {'before its first' if early else 'after its last'} sample",
                may_come=not early,
            )
        after = bisect_right(stamps, stamp_ns)
        if stamps[after - 1] == stamp_ns:
            return poses[after - 1]
        a, b = poses[after - 1], poses[after]
        share = (stamp_ns - stamps[after - 1]) / (stamps[after] - stamps[after - 1])
        return np.concatenate([a[:3] + share * (b[:3] - a[:3]), quaternion.slerp(a[3:], b[3:], share)])

    def _between(self, frame: str, base: str) -> list[_Link]:
        up, down = self._chains(frame, base)
        return [self._links[child] for child in (*up, *down)]

    def _chains(self, frame: str, base: str) -> tuple[list[str], list[str]]:
        """Children from the frame up, and from the base up, to where they meet."""
        up, down = self._upwards(frame.removeprefix("/")), self._upwards(base.removeprefix("/"))
        meeting = next((name for name in up if name in down), None)
        if meeting is None:
            known = sorted({*self._links, *(link.parent for link in self._links.values())})
            raise TransformError(
                f"{NO_TRANSFORM}nothing connects {shown(base)} to {shown(frame)}; those that came are about "
                f"{'; '.join([listed(known), *self._unsteady_among([*up, *down])])}"
            )
        return up[: up.index(meeting)], down[: down.index(meeting)]

    def _upwards(self, frame: str) -> list[str]:
        names = [frame]
        while (link := self._links.get(names[-1])) is not None:
            if link.contested_ns is not None and link.stamps[-1] - link.contested_ns < BY_TURNS_S * SECOND:
                raise TransformError(
                    f"{NO_TRANSFORM}{shown(names[-1])} has two parents by turns, {shown(link.former[0])} and "
                    f"{shown(link.parent)}: two programs publish it; stop one of them"
                )
            if link.parent in names:
                raise TransformError(f"{NO_TRANSFORM}those above {shown(frame)} form a loop")
            names.append(link.parent)
        return names


def _difference(link: _Link, parent: str, pose: Array) -> str:
    """How a transform differs from the last one of a link, in words; nothing where by rounding alone."""
    if link.parent != parent:
        return f"in {shown(link.parent)} and in {shown(parent)}"
    apart = float(np.linalg.norm(link.poses[-1][:3] - pose[:3]))
    turned = float(quaternion.angle_between(link.poses[-1][3:], pose[3:]))
    return f"{apart:.3f} m and {np.degrees(turned):.1f} deg apart" if apart > SAME_M or turned > SAME_RAD else ""


class TransformWatch:
    """What a tree newly says of one frame: an observation for each time at which all transforms to it are known.

    Parameters
    ----------
    tree
        that others add to
    frame, base
        frame ids
    """

    def __init__(self, tree: TransformTree, frame: str, base: str) -> None:
        self._tree, self._frame, self._base = tree, frame, base
        self.forget()

    def forget(self) -> None:
        """Start anew: time jumped backwards."""
        self._last_ns = -1
        #: Why the frame is not known; empty where it is.
        self.reason = ""

    def news(self) -> tuple[int | None, Array] | None:
        """The newest time and pose (7,), None for the time of what is static; None where nothing new is known."""
        try:
            stamp_ns = self._tree.latest(self._frame, self._base)
            if stamp_ns is not None and stamp_ns <= self._last_ns:
                return None
            pose = self._tree.pose(self._frame, self._base, stamp_ns)
        except TransformError as error:
            self.reason = str(error)
            return None
        self.reason = ""
        if stamp_ns is not None:
            self._last_ns = stamp_ns
        return stamp_ns, pose
