# SPDX-License-Identifier: Apache-2.0
"""Transforms out of one bag: /tf and /tf_static, and the frames that they lead to."""

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from tpgmm_core.common.text import listed
from tpgmm_core.common.types import Array
from tpgmm_core.doubt.doubts import Doubt
from tpgmm_core.observation.transforms import TransformTree, TransformWatch
from tpgmm_ros.messages.fields import time_to_ns, transform_numbers
from tpgmm_ros.messages.sources import TF, TF_MESSAGE, TF_STATIC, TransformSource
from tpgmm_ros.recordings.bag_messages import BagError, Messages, Stream, read_messages, topics_of_type

OLD_TF_MESSAGE = "tf/msg/tfMessage"
"""What tf2_msgs/TFMessage was called in ROS 1 before tf2; its fields are the same."""


class RecordedTransforms:
    """All transforms of a bag, read when they are asked for.

    Parameters
    ----------
    path
        of the bag
    """

    def __init__(self, path: Path) -> None:
        self._path = path
        self._tree: TransformTree | None = None
        self._moving: list[tuple[int, Any]] = []
        self._refused: dict[str, int] = {}
        self._by_recorder = False
        self._used: set[tuple[str, str]] = set()

    @property
    def tree(self) -> TransformTree:
        """All of them; raises BagError for a bag that cannot be read."""
        if self._tree is None:
            self._tree, self._moving = TransformTree(memory=None), []
            kinds = {kind: topics_of_type(self._path, kind) for kind in (TF_MESSAGE, OLD_TF_MESSAGE)}
            there = {name: kind for kind, names in kinds.items() for name in names}
            for topic in (TF_STATIC, TF):
                several = sorted(f"/{name}" for name in there if f"/{name}".endswith(f"/{topic}"))
                if not several:
                    continue
                if len(several) > 1 and topic not in there:
                    raise BagError(
                        self._path,
                        f"has transforms of several robots, on {listed(several)}, and a task file cannot say which are "
                        "meant: record those of one robot, or its poses as PoseStamped",
                    )
                found = read_messages(self._path, [topic], there[several[0].strip("/")])[topic]
                if topic == TF:
                    self._by_recorder = _never_stamped(found)
                for recorded, message in zip(found.recorded.tolist(), found.messages, strict=True):
                    for kind in self._add(self._tree, message, recorded, topic == TF_STATIC):
                        self._refused[kind] = self._refused.get(kind, 0) + 1
                    if topic == TF:
                        self._moving.append((recorded, message))
        return self._tree

    @property
    def notes(self) -> tuple[str, ...]:
        """What is odd in all of them, in words."""
        said = [f"/tf: {count} transforms left out ({kind})" for kind, count in self._refused.items()]
        if self._by_recorder:
            said.append("/tf has stamps that never change: times of the recorder used")
        return tuple(said)

    @property
    def doubts(self) -> tuple[Doubt, ...]:
        """Contradictions among those that lead to the frames that were asked for."""
        reasons = (reason for used in sorted(self._used) for reason in self.tree.contradictions(*used))
        return tuple(
            Doubt("transforms", (), f"/tf_static: {reason}, and record again") for reason in dict.fromkeys(reasons)
        )

    def pose(self, frame: str, base: str, stamp_ns: int) -> Array:
        """Where a frame is in a base at a time.

        Parameters
        ----------
        frame, base, stamp_ns
            see `TransformTree.pose`

        Returns
        -------
        Array
            shape (7,), with a unit quaternion

        Raises
        ------
        TransformError
            no transforms lead from one to the other, or they are not known at this time
        BagError
            the bag cannot be read
        """
        found = self.tree.pose(frame, base, stamp_ns)
        self._used.add((frame, base))
        return found

    def _add(self, tree: TransformTree, message: Any, recorded: int, is_static: bool) -> Iterator[str]:
        """Kinds of reasons why transforms are not used."""
        for item in message.transforms:
            stamp_ns = recorded if self._by_recorder else time_to_ns(item.header.stamp)
            numbers = transform_numbers(item.transform)
            if reason := tree.add(item.header.frame_id, item.child_frame_id, numbers, stamp_ns, is_static):
                yield reason.split(":", 1)[0]

    def stream(self, source: TransformSource) -> Stream | Array:
        """Where a frame was, at the times at which all transforms to it are known.

        Parameters
        ----------
        source
            the frame, and the base frame

        Returns
        -------
        Stream or Array
            its poses; one pose (7,) where only static transforms lead to it

        Raises
        ------
        BagError
            the bag is damaged, or no transforms lead to the frame.
        """
        watch = TransformWatch(self.tree, source.frame, source.base)
        whole = watch.news()
        if whole is None:
            raise BagError(
                self._path,
                f"its transforms on /tf and /tf_static do not say where {source.frame} is: {watch.reason}. Record them "
                "from before the start, or correct the task file",
            )
        self._used.add((source.frame, source.base))
        if whole[0] is None:
            return whole[1]
        seen = list(self._seen(source))
        if not seen:
            raise BagError(self._path, f"/tf never has all transforms to {source.frame} at one time; {watch.reason}")
        stamps, recorded, poses = zip(*seen, strict=True)
        topic = f"/tf ({listed([source.frame])})"
        return Stream(topic, np.array(stamps, np.int64), np.array(recorded, np.int64), np.array(poses), self.notes)

    def _seen(self, source: TransformSource) -> Iterator[tuple[int, int, Array]]:
        """Stamp, time of the recorder and pose, as they became known: as a running program sees them."""
        tree = self.tree.still()
        watch = TransformWatch(tree, source.frame, source.base)
        for recorded, message in self._moving:
            for _ in self._add(tree, message, recorded, False):
                pass  # these were counted before
            news = watch.news()
            if news is not None and news[0] is not None:
                yield news[0], recorded, news[1]


def _never_stamped(found: Messages) -> bool:
    """Whether several messages have one stamp, such as 0."""
    stamps = {time_to_ns(item.header.stamp) for message in found.messages for item in message.transforms}
    return len(found.messages) > 1 and len(stamps) == 1
