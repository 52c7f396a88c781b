# SPDX-License-Identifier: Apache-2.0
"""`BagRecorder`: topics of any type to rosbag2 recordings (MCAP, zstd), as they come, one bag from start to stop."""

from __future__ import annotations

import contextlib
import functools
import threading
import time
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Self

from rclpy.clock import Clock, ClockType
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from rclpy.topic_endpoint_info import TopicEndpointInfo

from tpgmm_core.common.text import listed, one_line
from tpgmm_ros.messages.classes import message_class
from tpgmm_ros.recordings.heard_topic import HeardTopic, bag_qos
from tpgmm_ros.recordings.storage.bag_writer import BagWriter, next_name
from tpgmm_ros.recordings.storage.definitions import types_for
from tpgmm_ros.runtime.fitted_subscription import are_latched

#: Nothing that comes while the disk is busy is to be lost, whatever the publisher promises.
RECORD = QoSProfile(depth=1000, reliability=ReliabilityPolicy.BEST_EFFORT)
#: Of topics that are published once.
RECORD_LATCHED = QoSProfile(
    depth=1000, reliability=ReliabilityPolicy.RELIABLE, durability=DurabilityPolicy.TRANSIENT_LOCAL
)
#: What is recorded is handed to the operating system, and what is new in the graph is looked at, so often, s.
PERIOD = 0.5


class BagRecorder:
    """Listens to topics, and records them into one bag after the other.

    It listens from the beginning, so that what was published once (transforms that never change, the description of
    the robot) is in every bag, at its beginning. Each bag is in its place when it is complete; see `BagWriter`.
    Methods may be called from any thread.

    Parameters
    ----------
    node
        the node that subscribes
    topics
        full names of message types by topic (as the node resolves it); None: as it is published, once it is
    keep_every
        keep only every n-th message of a topic, for topics that come faster than they are needed
    drop_repeated
        leave out a message that is the last one of its topic once more, byte by byte: for topics with stamps, of those
        who send again where an answer is missing

    Attributes
    ----------
    failure
        why the last recording broke off, in words; empty where none did

    Raises
    ------
    ValueError
        a type is known nowhere.
    ModuleNotFoundError
        the package of a type is not installed.
    """

    def __init__(
        self,
        node: Node,
        topics: Mapping[str, str | None],
        keep_every: Mapping[str, int] | None = None,
        drop_repeated: bool = False,
    ) -> None:
        self.failure = ""
        self._node, self._keep_every, self._drop_repeated = node, dict(keep_every or {}), drop_repeated
        self._lock = threading.RLock()
        self._writer: BagWriter | None = None
        self._topics = {name: HeardTopic(name, kind) for name, kind in topics.items()}
        for topic in self._topics.values():
            if topic.type is not None:
                types_for(topic.type)
                self._subscribe(topic, topic.name.endswith("tf_static"))
        self._timer = node.create_timer(PERIOD, self._work, clock=Clock(clock_type=ClockType.STEADY_TIME))

    # -- what a user does ---------------------------------------------------------------------------------------------

    @property
    def recording(self) -> Path | None:
        """Where the bag will be that is being recorded; None while none is."""
        with self._lock:
            return None if self._writer is None else self._writer.path

    @property
    def counts(self) -> dict[str, int]:
        """Messages by topic since the bag began, with those that were not kept."""
        return {name: topic.count for name, topic in self._topics.items()}

    @property
    def came(self) -> dict[str, int]:
        """Messages by topic since the recorder began to listen."""
        return {name: topic.came for name, topic in self._topics.items()}

    @property
    def duration_s(self) -> float:
        """From the first to the last message of the bag that is being recorded, s; 0 while none is."""
        with self._lock:
            return 0.0 if self._writer is None else self._writer.duration_s

    def rates(self) -> dict[str, float | None]:
        """Messages per second by topic, as they come now, recorded or not; None where there is no stream."""
        now = time.monotonic()
        with self._lock:
            return {name: topic.rate(now) for name, topic in self._topics.items()}

    def troubles(self) -> dict[str, str]:
        """Why topics cannot be recorded, in words, by topic."""
        return {name: topic.trouble for name, topic in self._topics.items() if topic.trouble}

    def start(self, folder: Path, name: str | None = None) -> Path:
        """Begin a bag.

        Parameters
        ----------
        folder
            of the bags; made where it is missing
        name
            of the bag; None: the next of demo_01, demo_02, ...

        Returns
        -------
        Path
            where the bag will be

        Raises
        ------
        FileExistsError
            there is something already.
        ValueError
            a bag is being recorded.
        OSError
            it cannot be written there.
        """
        with self._lock:
            if self._writer is not None:
                raise ValueError(f"{self._writer.path} is being recorded: stop it first")
            self.failure = ""
            writer = BagWriter(folder / (name or next_name(folder)))
            try:
                for topic in self._topics.values():
                    topic.begin()
                    if topic.type is not None:
                        self._declare(writer, topic)
                    for data in topic.kept:
                        self._write(writer, topic, data)
                writer.flush()
            except BaseException:
                writer.discard()
                raise
            self._writer = writer
            return writer.path

    def stop(self) -> Path:
        """Finish the bag.

        Returns
        -------
        Path
            the bag

        Raises
        ------
        ValueError
            none is being recorded, with the reason where it broke off.
        OSError
            the disk did not take all of it; what it took is kept, and the text says where.
        """
        with self._lock:
            writer = self._begun()
            self._writer = None
            try:
                return writer.close()
            except OSError as error:
                raise OSError(self._broke_off(writer, error)) from error

    def discard(self) -> Path:
        """Remove the bag that is being recorded.

        Returns
        -------
        Path
            where it would have been

        Raises
        ------
        ValueError
            none is being recorded.
        """
        with self._lock:
            writer = self._begun()
            self._writer = None
            writer.discard()
            return writer.path

    def close(self) -> None:
        """Listen no more; a bag that is being recorded stays unfinished, in `.partial`."""
        with self._lock:
            if self._writer is not None:
                with contextlib.suppress(OSError):
                    self._writer.flush()
                self._writer.abandon()
                self._writer = None
            self._node.destroy_timer(self._timer)
            for topic in self._topics.values():
                if topic.subscription is not None:
                    self._node.destroy_subscription(topic.subscription)
                    topic.subscription = None

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    @contextlib.contextmanager
    def into(self, path: Path) -> Iterator[Self]:
        """Record one bag from ``with`` to its end, and listen no more; after an error it stays in `.partial`.

        Parameters
        ----------
        path
            of the bag

        Yields
        ------
        Self
            the recorder
        """
        with self:
            self.start(path.parent, path.name)
            yield self
            self.stop()

    # -- what comes ---------------------------------------------------------------------------------------------------

    def _take(self, topic: HeardTopic, data: bytes) -> None:
        with self._lock:
            topic.take(data, time.monotonic())
            if self._writer is not None and not (self._drop_repeated and data == topic.last):
                try:
                    self._write(self._writer, topic, data)
                except OSError as error:
                    self._fail(error)

    def _write(self, writer: BagWriter, topic: HeardTopic, data: bytes) -> None:
        topic.last = data
        if topic.count % self._keep_every.get(topic.name, 1) == 0:
            if topic.connection is None:
                self._declare(writer, topic)
            assert topic.connection is not None
            writer.write(topic.connection, self._now(), data)
        topic.count += 1

    def _work(self) -> None:
        """Flush what was recorded, and look for topics of which more is known by now."""
        with self._lock:
            if self._writer is not None:
                try:
                    self._writer.flush()
                except OSError as error:
                    self._fail(error)
            for topic in self._topics.values():
                # a latched subscription does not hear who is not, and comes later
                if not topic.trouble and (topic.latched or not topic.came):
                    self._look_at(topic)

    def _look_at(self, topic: HeardTopic) -> None:
        """Subscribe as those who publish it ask for."""
        offers = self._offers(topic)
        if not offers:
            return
        types = sorted({offer.topic_type for offer in offers})
        if topic.type is None:
            try:
                types_for(types[0])
                topic.type = types[0]
            except ValueError as error:
                topic.trouble = str(error)
                return
        if topic.type not in types:
            topic.trouble = f"is published as {listed(types)}, expected {topic.type}: correct the task file"
            return
        latched = are_latched(offers)
        if topic.subscription is None or latched != topic.latched:
            self._subscribe(topic, latched)

    def _subscribe(self, topic: HeardTopic, latched: bool) -> None:
        assert topic.type is not None
        if topic.subscription is not None:
            self._node.destroy_subscription(topic.subscription)
        take = functools.partial(self._take, topic)
        topic.latched = latched
        topic.kept.clear()
        topic.subscription = self._node.create_subscription(
            message_class(topic.type), topic.name, take, RECORD_LATCHED if latched else RECORD, raw=True
        )

    def _declare(self, writer: BagWriter, topic: HeardTopic) -> None:
        assert topic.type is not None
        qos = [bag_qos(offer.qos_profile) for offer in self._offers(topic)]
        topic.connection = writer.add_topic(self._resolved(topic), topic.type, types_for(topic.type), qos)

    def _offers(self, topic: HeardTopic) -> list[TopicEndpointInfo]:
        offers: list[TopicEndpointInfo] = self._node.get_publishers_info_by_topic(self._resolved(topic))
        return offers

    def _resolved(self, topic: HeardTopic) -> str:
        name: str = self._node.resolve_topic_name(topic.name)
        return name

    def _now(self) -> int:
        now: int = self._node.get_clock().now().nanoseconds
        return now

    # -- what goes wrong ----------------------------------------------------------------------------------------------

    def _begun(self) -> BagWriter:
        if self._writer is None:
            raise ValueError(self.failure or "nothing is being recorded: start first")
        return self._writer

    def _fail(self, error: OSError) -> None:
        writer, self._writer = self._writer, None
        if writer is not None:
            self._broke_off(writer, error)

    def _broke_off(self, writer: BagWriter, error: OSError) -> str:
        kept = writer.abandon()
        self.failure = one_line(
            f"the recording of {writer.path} broke off ({error.strerror or error}); what the disk took is in {kept}: "
            f"'record --recover {kept}' makes a bag of it. Make room, and record it again"
        )
        return self.failure
