# SPDX-License-Identifier: Apache-2.0
"""`BagWriter`: one recording to a rosbag2 folder (MCAP, zstd), of which nothing is lost that was flushed."""

from __future__ import annotations

import contextlib
import os
import re
import shutil
from collections.abc import Sequence
from pathlib import Path

from rosbags.interfaces import Connection, Qos
from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin, Writer
from rosbags.rosbag2.storage_mcap import McapWriter
from rosbags.typesys.store import Typestore

PARTIAL = ".partial"
"""Folder, beside the bags, of those that are not finished."""
UNDONE = ".undone"
"""Folder, beside the bags, of those that were taken back."""


class BagWriter:
    """One bag that grows in `.partial` beside its final place, and is put there when it is complete.

    So a recording that was cut short never looks like a whole one. What was flushed is in the file, as whole chunks:
    it can be read after the process was killed or the disk was full. Nothing is ever overwritten.

    Parameters
    ----------
    path
        the bag's folder; must not exist yet

    Attributes
    ----------
    path
        where the bag will be
    first_ns, last_ns
        times of the first and the last message; 0 before there is one

    Raises
    ------
    FileExistsError
        there is something at `path` already.
    OSError
        it cannot be written there.
    """

    def __init__(self, path: Path) -> None:
        if path.exists():
            raise FileExistsError(f"{path} exists; recordings are not overwritten: move it, or give another path")
        self.path, self.first_ns, self.last_ns = path, 0, 0
        # rosbag2 names the files after the folder, so the unfinished bag has its final name elsewhere.
        self._partial = path.parent / PARTIAL / path.name
        if self._partial.exists():  # of an earlier recording that was cut short
            self._partial.rename(free_name(self._partial))
        self._partial.parent.mkdir(parents=True, exist_ok=True)
        self._writer = Writer(self._partial, version=9, storage_plugin=StoragePlugin.MCAP)
        self._writer.set_compression(CompressionMode.STORAGE, CompressionFormat.ZSTD)
        self._writer.open()
        assert isinstance(self._writer.storage, McapWriter)
        self._storage = self._writer.storage
        self._whole = 0
        self.flush()

    @property
    def duration_s(self) -> float:
        """From the first to the last message, s."""
        return 1e-9 * (self.last_ns - self.first_ns)

    def add_topic(self, name: str, message_type: str, types: Typestore, qos: Sequence[Qos] = ()) -> Connection:
        """Declare a topic, with its definition; returns what `write` asks for.

        Parameters
        ----------
        name, message_type
            of the topic
        types
            knows the type
        qos
            what its publishers offer

        Returns
        -------
        Connection
            the topic in this bag
        """
        return self._writer.add_connection(name, message_type, typestore=types, offered_qos_profiles=qos)

    def write(self, topic: Connection, at_ns: int, data: bytes | memoryview) -> None:
        """Append a message (CDR) with its time, ns; raises OSError where the disk does not take it."""
        self._writer.write(topic, at_ns, data)
        self.first_ns = min(self.first_ns or at_ns, at_ns)
        self.last_ns = max(self.last_ns, at_ns)

    def flush(self) -> None:
        """Hand all that was written to the operating system; raises OSError where the disk does not take it."""
        if self._storage.chunk.bio.tell():
            self._storage.close_chunk()
        self._storage.bio.flush()
        self._whole = self._storage.bio.tell()

    def close(self) -> Path:
        """Finish the bag and put it at its place.

        Returns
        -------
        Path
            the bag

        Raises
        ------
        OSError
            the disk does not take it; `abandon` keeps what it took.
        """
        self.flush()
        self._writer.close()
        with self._storage.path.open("rb") as file:
            os.fsync(file.fileno())
        self._partial.rename(self.path)
        with contextlib.suppress(OSError):  # other unfinished recordings may lie there
            self._partial.parent.rmdir()
        return self.path

    def abandon(self) -> Path:
        """Leave what was flushed in `.partial`, without anything that was begun behind it; returns where that is."""
        with contextlib.suppress(OSError):  # what waits to be written goes nowhere
            self._writer.abort()
        with contextlib.suppress(OSError):
            os.truncate(self._storage.path, self._whole)
        return self._partial

    def discard(self) -> None:
        """Remove all of it."""
        with contextlib.suppress(OSError):
            self._writer.abort()
        shutil.rmtree(self._partial, ignore_errors=True)
        with contextlib.suppress(OSError):
            self._partial.parent.rmdir()


def free_name(path: Path) -> Path:
    """A path that does not exist yet: the given one, or with _2, _3 and so on at its end."""
    number, free = 1, path
    while free.exists():
        number += 1
        free = path.with_name(f"{path.name}_{number}")
    return free


def next_name(folder: Path) -> str:
    """The next of demo_01, demo_02, ... that no bag of a folder has had, finished, unfinished or taken back."""
    parts = [part for part in (folder, folder / PARTIAL, folder / UNDONE) if part.is_dir()]
    found = [re.match(r"demo_(\d+)", item.name) for part in parts for item in part.iterdir()]
    return f"demo_{max((int(match[1]) for match in found if match), default=0) + 1:02d}"
