# SPDX-License-Identifier: Apache-2.0
"""The sources of a task's frames on topics: messages in, observations in the base frame out.

Poses in other frames are transformed by /tf, to which a node listens only where a frame needs it. Such a pose waits
until the transforms of its time have come; whether it is too old by then is the tracker's to judge.
"""

from __future__ import annotations

import functools
from collections import deque
from collections.abc import Callable, Mapping, Sequence
from itertools import chain
from typing import Any

from rclpy.node import Node
from rclpy.qos import QoSProfile
from rclpy.serialization import deserialize_message
from rclpy.subscription import Subscription

from tpgmm_core.geometry.pose import compose, turned_covariance
from tpgmm_core.observation.poses import Observation, check_pose, wrong_frame
from tpgmm_core.observation.transforms import NO_TRANSFORM, TransformError, TransformTree, TransformWatch
from tpgmm_ros.messages.classes import message_class
from tpgmm_ros.messages.fields import time_to_ns, transform_numbers
from tpgmm_ros.messages.qos import MIXED, STREAM, TRANSFORMS_STATIC
from tpgmm_ros.messages.sources import TF, TF_MESSAGE, TF_STATIC, Source, TopicSource, TransformSource
from tpgmm_ros.runtime.batches import Batches
from tpgmm_ros.runtime.fitted_subscription import FittedSubscription

#: So many poses of one frame wait for transforms: half a second of a fast camera.
MOST_WAITING = 32
#: So many poses of one topic are looked at in one turn: of more that have come meanwhile, the newest.
MOST_TOGETHER = 4


class FrameSources:
    """Subscribes to what a task's frames are observed by.

    Parameters
    ----------
    node
        that subscribes
    sources
        by frame name
    base_frame
        of the task
    observe
        called with a frame's name and an observation in the base frame
    refuse
        called with a frame's name and a reason: kind, ":", details
    fix
        called with a frame's name and its pose (7,), where only static transforms lead to it

    Raises
    ------
    ModuleNotFoundError
        the messages of a source are not installed.
    """

    def __init__(
        self,
        node: Node,
        sources: Mapping[str, Source],
        base_frame: str,
        observe: Callable[[str, Observation], object],
        refuse: Callable[[str, str], object],
        fix: Callable[[str, Any], object],
    ) -> None:
        self._node, self._base_frame = node, base_frame
        self._observe, self._refuse, self._fix = observe, refuse, fix
        self._tree = TransformTree()
        self._watches: dict[str, TransformWatch] = {}
        self._waiting: dict[str, deque[Observation]] = {name: deque() for name in sources}
        self._topics: dict[str, str] = {}
        self._fitted: dict[str, FittedSubscription] = {}
        self._heard = set[str]()
        # of frames, how many messages have come since one was about it, and what it should have held
        self._without: dict[str, tuple[int, str]] = {}
        self._listens = False
        self._missing = ""
        for name, source in sources.items():
            if isinstance(source, TransformSource):
                self._watches[name] = TransformWatch(self._tree, source.frame, source.base)
            else:
                take = functools.partial(self._take_all, name, source)
                self._topics[name] = node.resolve_topic_name(source.topic)
                # where several things take turns on one topic, its newest message may be about another one
                qos, most = (MIXED, MIXED.depth) if source.selection else (STREAM, MOST_TOGETHER)
                subscribe = functools.partial(self._subscribe, source.message_type, source.topic, take, most)
                self._fitted[name] = FittedSubscription(node, qos, subscribe)
        if self._watches:
            self._listen()

    def forget(self) -> None:
        """Forget what was seen: time jumped backwards."""
        self._tree.forget()
        for waiting in self._waiting.values():
            waiting.clear()
        for watch in self._watches.values():
            watch.forget()
        for subscription in self._fitted.values():
            subscription.hear_again()

    @property
    def kept(self) -> list[str]:
        """Frames whose publishers keep what they have said: it holds until they say something else."""
        return [name for name, subscription in self._fitted.items() if subscription.is_latched]

    def unknown(self) -> dict[str, str]:
        """Frames that no transforms lead to, or that no message of their topic is about, and why."""
        others = {
            name: f"none of the last {count} messages on {self._topics[name]} holds {what}"
            for name, (count, what) in self._without.items()
        }
        return others | {name: watch.reason for name, watch in self._watches.items() if watch.reason}

    def unpublished(self) -> dict[str, str]:
        """Frames on whose topic nothing came, or that has no publisher at present, in words."""
        found = {}
        for name, topic in self._topics.items():
            self._fitted[name].fit()
            if not self._node.count_publishers(topic):
                found[name] = f"nobody publishes {topic}"
            elif name not in self._heard:
                found[name] = f"nothing came on {topic}"
        return found

    def _subscribe(
        self, kind: str, topic: str, take: Callable[[Sequence[Any]], object], most: int, qos: QoSProfile
    ) -> Subscription:
        """Whoever floods a topic shall not keep other topics, or other nodes of the process, from their turn."""
        read = functools.partial(deserialize_message, message_type=message_class(kind))
        return Batches(self._node, message_class(kind), topic, take, qos, read, most).subscription

    def _take_all(self, name: str, source: TopicSource, messages: Sequence[Any]) -> None:
        for message in messages:
            self._take(name, source, message)

    def _take(self, name: str, source: TopicSource, message: Any) -> None:
        self._heard.add(name)
        observation = source.read(message)
        if observation is None:
            count, _ = self._without.get(name, (0, ""))
            self._without[name] = count + 1, source.selection
            return
        self._without.pop(name, None)
        if self._fitted[name].is_latched:
            observation = observation._replace(lasts=True)
        if observation.fault:
            self._refuse(name, observation.fault)
        elif observation.frame_id == self._base_frame or not wrong_frame(observation.frame_id, self._base_frame):
            self._observe(name, observation)
        else:
            waiting = self._waiting[name]
            if len(waiting) == MOST_WAITING:
                self._refuse(name, f"no transform at this time: none for {MOST_WAITING} poses; is /tf published?")
                waiting.popleft()
            waiting.append(observation)
            self._work_off(name)

    def _work_off(self, name: str) -> None:
        waiting = self._waiting[name]
        while waiting and self._is_done(name, waiting[0]):
            waiting.popleft()

    def _is_done(self, name: str, observation: Observation) -> bool:
        """Whether a pose of another frame is transformed or refused; else its transforms may still come."""
        pose, fault = check_pose(observation.pose)
        if pose is None or not observation.frame_id or not self._try_to_listen():
            self._refuse(name, fault or wrong_frame(observation.frame_id, self._base_frame) + self._missing)
            return True
        try:
            place = self._tree.pose(observation.frame_id, self._base_frame, observation.stamp_ns)
        except TransformError as error:
            if not error.may_come:
                reason = str(error)
                unknown = reason.startswith(NO_TRANSFORM)
                self._refuse(name, wrong_frame(observation.frame_id, self._base_frame) if unknown else reason)
            return not error.may_come
        covariance = observation.covariance
        if covariance is not None:
            covariance = turned_covariance(covariance, place[3:])
        moved = observation._replace(frame_id=self._base_frame, pose=compose(place, pose), covariance=covariance)
        self._observe(name, moved)
        return True

    def _try_to_listen(self) -> bool:
        try:
            self._listen()
        except ModuleNotFoundError as error:
            self._missing = f" ({error})"
        return self._listens

    def _listen(self) -> None:
        if not self._listens and not self._missing:
            for topic, is_static, qos in ((TF_STATIC, True, TRANSFORMS_STATIC), (TF, False, MIXED)):
                take = functools.partial(self._take_transforms, is_static)
                self._subscribe(TF_MESSAGE, f"/{topic}", take, qos.depth, qos)
            self._listens = True

    def _take_transforms(self, is_static: bool, messages: Sequence[Any]) -> None:
        for item in chain.from_iterable(message.transforms for message in messages):
            stamp_ns, numbers = time_to_ns(item.header.stamp), transform_numbers(item.transform)
            reason = self._tree.add(item.header.frame_id, item.child_frame_id, numbers, stamp_ns, is_static)
            if reason:
                self._node.get_logger().warning(f"transform refused: {reason}", throttle_duration_sec=2.0)
        for reason in self._tree.unsteady.values():
            self._node.get_logger().warning(reason, throttle_duration_sec=10.0)
        for name, watch in self._watches.items():
            news = watch.news()
            if news is None:
                continue
            stamp, pose = news
            if stamp is None:
                self._fix(name, pose)
            else:
                self._observe(name, Observation(stamp, self._base_frame, pose))
        for name in self._waiting:
            self._work_off(name)
