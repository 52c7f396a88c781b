# SPDX-License-Identifier: Apache-2.0
"""Messages of one type out of one bag, without losing anything silently, and the poses in them.

rosbag2 (MCAP, sqlite3) and ROS 1 bags, by rosbags: no ROS installation takes part. Whatever is wrong with a
bag ends in one BagError that says which bag, what was found, what was expected and what to do.
"""

from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from rosbags.highlevel import AnyReader
from rosbags.interfaces import Connection
from rosbags.typesys import Stores, get_typestore

from tpgmm_core.common.text import listed, one_line

Array = NDArray[np.float64]
Nanoseconds = NDArray[np.int64]


class BagError(ValueError):
    """A bag that cannot be used; the text names the bag, what was found, what was expected, what to do."""

    def __init__(self, path: Path, text: str) -> None:
        super().__init__(one_line(f"{path}: {text}"))
        self.path = path


@dataclass(frozen=True, slots=True)
class Messages:
    """Messages of one topic, in the order of the recorder.

    Attributes
    ----------
    topic
        the topic's name in the bag
    recorded
        (T,) times at which the recorder received them, in ns
    messages
        the messages, at least one
    """

    topic: str
    recorded: Nanoseconds
    messages: tuple[Any, ...]


@dataclass(frozen=True, slots=True)
class Stream:
    """Numbers of one topic, in the order of the recorder.

    Attributes
    ----------
    topic
        the topic's name in the bag
    stamps
        (T,) header stamps in ns
    recorded
        (T,) times at which the recorder received the messages, in ns
    values
        (T, n)
    notes
        what was left out or put right, in words
    """

    topic: str
    stamps: Nanoseconds
    recorded: Nanoseconds
    values: Array
    notes: tuple[str, ...] = ()

    def at(self, seen: Nanoseconds, times: Nanoseconds) -> Array:
        """Values (S, n) at times (S,), linear between those seen at (T,) times that never decrease, ns."""
        return np.column_stack([np.interp(times, seen, column) for column in self.values.T])


def read_messages(path: Path, topics: Iterable[str], message_type: str) -> dict[str, Messages]:
    """Read topics of one type from one bag.

    Topics are relative names. A bag recorded inside a namespace is understood when the namespace is the only
    one in which all of the topics exist.

    Parameters
    ----------
    path
        of the bag
    topics
        to be read
    message_type
        of all of them

    Returns
    -------
    dict[str, Messages]
        by topic, as given

    Raises
    ------
    BagError
        the bag is damaged or incomplete, or a topic is absent, empty or of another type.
    """
    if path.is_dir() and not (path / "metadata.yaml").exists():
        raise BagError(
            path,
            "has no metadata.yaml, which a rosbag2 directory has; run 'ros2 bag reindex' on it, or "
            "give the .mcap or .db3 file itself",
        )
    messages: dict[str, list[tuple[int, Any]]] = {topic: [] for topic in topics}
    # Each kind of damage surfaces in rosbags as an exception of its own (AnyReaderError, apsw's, KeyError,
    # OverflowError, struct.error, ...): this is the one place where they all become a BagError.
    try:
        # Bags of ROS 2 before Iron do not carry their message definitions.
        with AnyReader([path], default_typestore=get_typestore(Stores.ROS2_JAZZY)) as reader:
            chosen = _connections(path, list(messages), reader.connections, message_type)
            names = {connection.id: topic for topic, several in chosen.items() for connection in several}
            counts = {topic: sum(connection.msgcount for connection in several) for topic, several in chosen.items()}
            bag_topics = {topic: several[0].topic for topic, several in chosen.items()}
            selected = [connection for several in chosen.values() for connection in several]
            for connection, recorded, raw in reader.messages(connections=selected):
                message = reader.deserialize(raw, connection.msgtype)
                messages[names[connection.id]].append((recorded, message))
    except BagError:
        raise
    except Exception as error:
        raise BagError(
            path,
            f"cannot be read ({type(error).__name__}: {one_line(error, 300)}); expected a complete bag. If it was cut "
            "off, 'ros2 bag reindex' or 'mcap recover' may save what is left; else record it again",
        ) from error
    for topic, count in counts.items():
        if len(messages[topic]) < count:
            raise BagError(
                path,
                f"lost messages: {bag_topics[topic]} holds {len(messages[topic])} of the {count} that "
                "were recorded; the file is damaged, record it again",
            )
    return {
        topic: Messages(
            bag_topics[topic], np.array([at for at, _ in several], np.int64), tuple(message for _, message in several)
        )
        for topic, several in messages.items()
    }


def topics_of_type(path: Path, message_type: str) -> set[str]:
    """Topics of a type in a bag.

    Parameters
    ----------
    path
        of the bag
    message_type
        full name

    Returns
    -------
    set[str]
        names without slashes around them

    Raises
    ------
    BagError
        the bag is damaged.
    """
    try:
        with AnyReader([path], default_typestore=get_typestore(Stores.ROS2_JAZZY)) as reader:
            return {item.topic.strip("/") for item in reader.connections if item.msgtype == message_type}
    except Exception as error:
        raise BagError(path, f"cannot be read ({type(error).__name__}: {one_line(error, 300)})") from error


def _connections(
    path: Path, topics: list[str], connections: list[Connection], message_type: str
) -> dict[str, list[Connection]]:
    """Connections of each topic. Never empty: to rosbags, an empty list means every topic."""
    kind = message_type.rsplit("/", 1)[-1]
    by_name: dict[str, list[Connection]] = {}
    for connection in connections:
        by_name.setdefault(connection.topic.strip("/"), []).append(connection)
    poses = sorted(connection.topic for connection in connections if connection.msgtype == message_type)
    there = (f"its {kind} topics are " + listed(dict.fromkeys(poses))) if poses else f"it has no {kind} topics"

    prefixes = {name.removesuffix(topics[0]) for name in by_name if f"/{name}".endswith(f"/{topics[0]}")}
    complete = sorted(prefix for prefix in prefixes if all(prefix + topic in by_name for topic in topics))
    if "" not in complete and len(complete) != 1:
        if complete:
            raise BagError(
                path,
                f"holds the topics {', '.join(topics)} in several namespaces ({listed(complete)}); "
                "write the namespace into the topics of the task file",
            )
        prefix = min(prefixes, default="")
        absent = ", ".join(topic for topic in topics if prefix + topic not in by_name)
        raise BagError(path, f"lacks the topic {absent}; {there}. Record it, or correct the topics of the task file")

    prefix = "" if "" in complete else complete[0]
    chosen = {topic: by_name[prefix + topic] for topic in topics}
    for topic, several in chosen.items():
        for connection in several:
            if connection.msgtype != message_type:
                raise BagError(
                    path,
                    f"{one_line(connection.topic, 60)} is of type {one_line(connection.msgtype, 60)}, expected "
                    f"{message_type}; {there}. Correct the topic in the task file, or name the type there",
                )
        if not any(connection.msgcount for connection in several):
            raise BagError(path, f"{topic} is there, but without a message; nothing published it while recording")
    return chosen
