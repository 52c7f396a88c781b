# SPDX-License-Identifier: Apache-2.0
"""Records of an MCAP file, and their fields, where they lie: nothing is copied."""

from __future__ import annotations

import struct
from collections.abc import Iterator

from tpgmm_ros.recordings.storage.storage_file import RawMessage

MAGIC = b"\x89MCAP0\r\n"
MESSAGE = 0x05
RECORD = struct.Struct("<BQ")
MESSAGE_START = struct.Struct("<HIQQ")


class DamageError(Exception):
    """What is wrong at some byte, in words."""


class RecordReader:
    """Fields of a record, one after the other."""

    def __init__(self, data: memoryview) -> None:
        self._data, self._at = data, 0

    def number(self, size: int) -> int:
        """The next number, of so many bytes."""
        return int.from_bytes(self.data(size), "little")

    def data(self, size: int) -> memoryview:
        """The next bytes.

        Parameters
        ----------
        size
            how many

        Returns
        -------
        memoryview
            of the record

        Raises
        ------
        DamageError
            there are fewer.
        """
        part = self._data[self._at : self._at + size]
        if len(part) != size:
            raise DamageError("a record is shorter than its fields")
        self._at += size
        return part

    def block(self) -> memoryview:
        """The next bytes, whose number stands before them."""
        return self.data(self.number(4))

    def text(self) -> str:
        """The next text."""
        return bytes(self.block()).decode(errors="replace")


def end_of_whole_records(data: memoryview) -> int:
    """Where the first record begins that was cut off."""
    at = len(MAGIC)
    while at + RECORD.size <= len(data):
        opcode, length = RECORD.unpack_from(data, at)
        if opcode == 0 or at + RECORD.size + length > len(data):
            break
        at += RECORD.size + length
    return at


def placed_records(data: memoryview, at: int, only: int | None = None) -> Iterator[tuple[int, memoryview, int]]:
    """Records from a byte on.

    Parameters
    ----------
    data
        of a file, or of a chunk
    at
        where the first one begins
    only
        records of this kind; None: of all

    Yields
    ------
    tuple[int, memoryview, int]
        kind of the record, what is in it, and where it begins

    Raises
    ------
    DamageError
        a record is not there as a whole.
    """
    end = len(data)
    while at < end:
        opcode, length = RECORD.unpack_from(data, at)
        begin = at + RECORD.size
        if opcode == 0 or begin + length > end:
            raise DamageError(f"at byte {at} of {end} there is no whole record")
        if only is None or opcode == only:
            yield opcode, data[begin : begin + length], at
        at = begin + length


def wanted_message(record: memoryview, wanted: frozenset[int]) -> Iterator[RawMessage]:
    """The message of a record, where its topic is one of the wanted ones."""
    key, _, at, _ = MESSAGE_START.unpack_from(record)
    if key in wanted:
        yield key, at, bytes(record[MESSAGE_START.size :])
