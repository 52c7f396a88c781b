# SPDX-License-Identifier: Apache-2.0
"""What every file of a bag offers, whatever its format: its topics, and messages in the order of writing."""

from __future__ import annotations

from collections.abc import Collection, Iterator
from dataclasses import dataclass
from typing import Protocol

type RawMessage = tuple[int, int, bytes]
"""Key of the topic, time of the recorder in ns, and the message as it was recorded."""


@dataclass(frozen=True, slots=True)
class FileTopic:
    """A topic as one file declares it. Its definition is text that nobody has looked at.

    Attributes
    ----------
    key
        number of the topic in this file; a topic may have several, one for each publisher
    name, type
        of the topic, the type as package/msg/Name
    encoding
        of its messages: cdr (ROS 2), ros1, or another one
    definition
        of the type
    definition_format
        of the definition: ros2msg, ros2idl, ros1msg, or another one; empty where there is none
    count
        number of messages that the file says it has
    """

    key: int
    name: str
    type: str
    encoding: str
    definition: bytes
    definition_format: str
    count: int


class StorageFile(Protocol):
    """A file of a bag, open for reading.

    Attributes
    ----------
    topics
        all topics of the file
    first_ns, last_ns
        times of the recorder, of the first and the last message; 0 where there is none
    """

    topics: list[FileTopic]
    first_ns: int
    last_ns: int

    def messages(self, keys: Collection[int]) -> Iterator[RawMessage]:
        """Messages of some topics in the order of writing.

        Parameters
        ----------
        keys
            of the topics

        Returns
        -------
        Iterator[RawMessage]
            key of the topic, time and bytes of each

        Raises
        ------
        BagError
            the file is damaged inside.
        """

    def close(self) -> None:
        """Close the file."""
