# SPDX-License-Identifier: Apache-2.0
"""Messages of one type out of one bag, without losing anything silently, and the poses in them.

rosbag2 (MCAP, sqlite3) and ROS 1 bags: no ROS installation takes part. Whatever is wrong with a bag ends in one
BagError that says which bag, what was found, what was expected and what to do.
"""

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from tpgmm_core.common.text import listed, one_line
from tpgmm_core.common.types import Array, Nanoseconds
from tpgmm_core.doubt.doubts import Doubt
from tpgmm_ros.recordings.storage.bag_error import BagError
from tpgmm_ros.recordings.storage.bag_reader import BagReader, BagTopic, Decoding, check_not_empty
from tpgmm_ros.recordings.storage.message_types import decoder

__all__ = ["BagError", "Messages", "Stream", "read_messages", "take_messages", "topics_named", "topics_of_type"]


MOST_BAD = 0.5
"""Where a larger share of messages or poses cannot be used, the source is at fault, not one of them."""


@dataclass(frozen=True, slots=True)
class Messages:
    """Messages of one topic, in the order of writing.

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
    """Numbers of one topic, in the order of writing.

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
    doubts
        what makes no sense in its numbers
    """

    topic: str
    stamps: Nanoseconds
    recorded: Nanoseconds
    values: Array
    notes: tuple[str, ...] = ()
    doubts: tuple[Doubt, ...] = ()


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
    found: dict[str, list[tuple[int, Any]]] = {name: [] for name in topics}
    names = take_messages(path, found, message_type, lambda name, at, message: found[name].append((at, message)))
    return {
        name: Messages(names[name], np.array([at for at, _ in several], np.int64), tuple(one for _, one in several))
        for name, several in found.items()
    }


def take_messages(
    path: Path,
    topics: Iterable[str],
    message_type: str,
    take: Callable[[str, int, Any], object],
    decoding: Decoding = decoder,
) -> dict[str, str]:
    """The same, handed over one after the other in the order of writing, so that none has to be kept.

    Parameters
    ----------
    path, topics, message_type
        see `read_messages`
    take
        called with the topic as given, the time of the recorder in ns, and the message
    decoding
        see `BagReader.messages`

    Returns
    -------
    dict[str, str]
        the topics' names in the bag, by topic as given

    Raises
    ------
    BagError
        see `read_messages`.
    """
    with BagReader(path) as reader:
        chosen = topics_named(path, list(topics), reader.topics, message_type)
        names = {topic.name: name for name, topic in chosen.items()}
        for topic, recorded, message in reader.messages(list(chosen.values()), decoding):
            take(names[topic.name], recorded, message)
    return {name: topic.name for name, topic in chosen.items()}


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
    with BagReader(path) as reader:
        return {topic.name.strip("/") for topic in reader.topics if topic.type == message_type}


def topics_named(
    path: Path, topics: list[str], there: list[BagTopic], message_type: str | None = None
) -> dict[str, BagTopic]:
    """The bag's topic of each name that is asked for; in the one namespace that has them all.

    Parameters
    ----------
    path
        of the bag, for errors
    topics
        relative names
    there
        topics of the bag
    message_type
        of all of them; None: of any type

    Returns
    -------
    dict[str, BagTopic]
        by name, as given

    Raises
    ------
    BagError
        a topic is absent, empty or of another type, or in several namespaces.
    """
    check_not_empty(path, there)
    kind = f"{message_type.rsplit('/', 1)[-1]} " if message_type else ""
    by_name: dict[str, list[BagTopic]] = {}
    for topic in there:
        by_name.setdefault(topic.name.strip("/"), []).append(topic)
    same = sorted(topic.name for topic in there if message_type in (None, topic.type))
    others = (f"its {kind}topics are " + listed(dict.fromkeys(same))) if same else f"it has no {kind}topics"

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
        raise BagError(path, f"lacks the topic {absent}; {others}. Record it, or correct the topics of the task file")

    prefix = "" if "" in complete else complete[0]
    chosen: dict[str, BagTopic] = {}
    for name in topics:
        called_so = by_name[prefix + name]
        right = [topic for topic in called_so if message_type in (None, topic.type)]
        if not right:
            kinds = one_line(listed(dict.fromkeys(topic.type for topic in called_so)), 120)
            raise BagError(
                path,
                f"{one_line(called_so[0].name, 60)} is of type {kinds}, expected {message_type}; {others}. "
                "Correct the topic in the task file, or name the type there",
            )
        chosen[name] = max(right, key=lambda topic: topic.count)
        if not chosen[name].count:
            raise BagError(path, f"{name} is there, but without a message; nothing published it while recording")
    return chosen
