# SPDX-License-Identifier: Apache-2.0
"""ROS 1 bags, by rosbags, in the order of writing."""

from __future__ import annotations

import re
from collections.abc import Collection, Iterator
from pathlib import Path
from typing import NamedTuple

from rosbags.rosbag1 import Reader, ReaderError

from tpgmm_core.common.text import one_line
from tpgmm_ros.recordings.storage.bag_error import BagError
from tpgmm_ros.recordings.storage.storage_file import FileTopic, RawMessage, StorageFile

MAGIC = b"#ROSBAG V"
_REASONS = (
    ("not indexed", "it has no index: its recorder was killed before it could close it. 'rosbag reindex' writes one"),
    ("Compression", "{error} Write it anew by 'rosbag compress --bz2' or 'rosbag decompress'"),
    ("encryption", "{error} Write it anew by 'rosbag decrypt'"),
    ("version", "{error} Write it anew by 'rosbag fix', or in ROS 2 format by 'rosbags-convert'"),
)
_DAMAGED = (
    "it was cut off, or is damaged inside ({error}). 'rosbag reindex' may save what is whole; else record it again"
)


class _Place(NamedTuple):
    """Where a message lies in a file, and its time, ns: in the order of writing."""

    chunk_pos: int
    offset: int
    time: int


class Ros1File(StorageFile):
    """One ROS 1 bag; see `StorageFile`.

    Parameters
    ----------
    path
        the file, with MAGIC at its beginning
    label
        the file that errors name, where `path` is an unpacked copy

    Raises
    ------
    BagError
        the file was cut off, is damaged, has no index, or is of a kind that is not known.
    """

    def __init__(self, path: Path, label: Path | None = None) -> None:
        self._label = label or path
        self._reader = Reader(path)
        try:
            self._reader.open()
        except Exception as error:  # rosbags says damage in many ways: ReaderError, struct.error, AssertionError, ...
            raise self._damaged(error) from None
        self._connections = {connection.id: connection for connection in self._reader.connections}
        self.topics = [
            FileTopic(c.id, c.topic, c.msgtype, "ros1", c.msgdef.data.encode(), "ros1msg", c.msgcount)
            for c in self._reader.connections
        ]
        has_messages = self._reader.message_count > 0
        self.first_ns = self._reader.start_time if has_messages else 0
        self.last_ns = self._reader.end_time - 1 if has_messages else 0

    def messages(self, keys: Collection[int]) -> Iterator[RawMessage]:
        """Messages of some topics in the order of writing.

        Raises
        ------
        BagError
            the file is damaged inside.
        """
        # The reader merges its indices in the order of their entries: by time, unless these begin with their places.
        for key in keys:
            entries = self._reader.indexes[key]
            if not isinstance(entries[0] if entries else None, _Place):
                self._reader.indexes[key] = sorted(_Place(e.chunk_pos, e.offset, e.time) for e in entries)  # type: ignore
        try:
            for connection, at, raw in self._reader.messages([self._connections[key] for key in keys]):
                yield connection.id, at, raw
        except Exception as error:
            raise self._damaged(error) from None

    def _damaged(self, error: Exception) -> BagError:
        said = one_line(error, 200) if isinstance(error, ReaderError) else type(error).__name__
        said = re.sub(r"\('(.*?)',?\)", r"\1", said)
        reason = next((reason for word, reason in _REASONS if word in said), _DAMAGED)
        return BagError(self._label, f"cannot be read: {reason.format(error=said)}")

    def close(self) -> None:
        """Close the file."""
        self._reader.close()
