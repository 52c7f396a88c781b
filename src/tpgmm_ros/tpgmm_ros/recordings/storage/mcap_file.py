# SPDX-License-Identifier: Apache-2.0
"""MCAP files (mcap.dev/spec), read in the order of writing; of other topics no byte is parsed.

Chunks without a message of the wanted topics are skipped where the file has an index. A file without one is scanned.
"""

from __future__ import annotations

import contextlib
import mmap
import struct
from binascii import crc32
from collections import Counter
from collections.abc import Callable, Collection, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import lz4.frame
from backports import zstd

from tpgmm_core.common.text import shown
from tpgmm_ros.recordings.storage.bag_error import BagError
from tpgmm_ros.recordings.storage.mcap_records import (
    MAGIC,
    MESSAGE,
    MESSAGE_START,
    RECORD,
    DamageError,
    RecordReader,
    end_of_whole_records,
    placed_records,
    wanted_message,
)
from tpgmm_ros.recordings.storage.storage_file import FileTopic, RawMessage, StorageFile

RECOVER = "'record --recover' or 'mcap recover' may save what is whole; else record it again"

_FOOTER, _SCHEMA, _CHANNEL, _CHUNK = 0x02, 0x03, 0x04, 0x06
_CHUNK_INDEX, _STATISTICS = 0x08, 0x0B
_FOOTER_SIZE = RECORD.size + 20 + len(MAGIC)
_CHUNK_START = struct.Struct("<QQQI")
_FORGET = 16 * 1024 * 1024
"""So much of a file may stay in memory behind the place that is read."""

_DECOMPRESS: dict[str, Callable[[bytes], bytes]] = {"lz4": lz4.frame.decompress, "zstd": zstd.decompress}


class _Schema(NamedTuple):
    name: str
    format: str
    definition: bytes


@dataclass(slots=True)
class _Chunk:
    begin: int
    topics: frozenset[int]
    """Topics that have messages in it; empty where the index does not tell."""


class McapFile(StorageFile):
    """One MCAP file; see `StorageFile`.

    Parameters
    ----------
    path
        the file, with MAGIC at its beginning
    label
        the file that errors name, where `path` is an unpacked copy
    whole
        a file that was cut off is refused; else it is read as far as it goes

    Raises
    ------
    BagError
        the file was cut off or is damaged.
    """

    def __init__(self, path: Path, label: Path | None = None, whole: bool = True) -> None:
        self._label, self._must_be_whole = label or path, whole
        self._file = path.open("rb")
        self._map = mmap.mmap(self._file.fileno(), 0, access=mmap.ACCESS_READ)
        self._data = memoryview(self._map)
        self._schemas: dict[int, _Schema] = {}
        self._channels: dict[int, FileTopic] = {}
        self._chunks: list[_Chunk] = []
        self._counts: Counter[int] = Counter()
        self.first_ns, self.last_ns = 0, 0
        self._forgotten = 0
        try:
            self._open()
        except (DamageError, struct.error) as error:
            more = self._more()
            self.close()
            raise more or self._damaged(error) from None
        except BaseException:
            self.close()
            raise
        self.topics = [
            FileTopic(c.key, c.name, c.type, c.encoding, c.definition, c.definition_format, self._counts[c.key])
            for c in self._channels.values()
        ]

    def _open(self) -> None:
        size = len(self._data)
        if size < len(MAGIC) + _FOOTER_SIZE or bytes(self._data[-len(MAGIC) :]) != MAGIC:
            if not self._must_be_whole:
                self._end = end_of_whole_records(self._data)
                self._scan(self._end)
                return
            raise self._more() or BagError(
                self._label,
                f"cannot be read: it was cut off; its {size} bytes end without the footer that an MCAP file has, as "
                f"when the recorder was killed, the disk was full, or a copy was not finished. {RECOVER}",
            )
        self._end = size - _FOOTER_SIZE
        opcode, _ = RECORD.unpack_from(self._data, self._end)
        (summary,) = struct.unpack_from("<Q", self._data, self._end + RECORD.size)
        if opcode != _FOOTER or summary > self._end:
            raise DamageError("its footer is damaged")
        if not (summary and self._read_summary(summary)):
            if more := self._more():
                raise more
            self._scan(summary or self._end)
        self._end = summary or self._end

    def _more(self) -> BagError | None:
        """What is wrong where a file has its end before its last byte; None where it has not."""
        size, end = len(self._data), self._map.find(MAGIC, _FOOTER_SIZE) + len(MAGIC)
        if not _FOOTER_SIZE < end < size:
            return None
        if RECORD.unpack_from(self._data, end - _FOOTER_SIZE) != (_FOOTER, _FOOTER_SIZE - RECORD.size - len(MAGIC)):
            return None
        is_file = bytes(self._data[end : end + len(MAGIC)]) == MAGIC
        return BagError(
            self._label,
            f"cannot be read: it ends after {end} bytes, and {'another MCAP file' if is_file else 'something else'} of "
            f"{size - end} bytes follows. Files of bags are not joined by writing one behind the other: cut it apart "
            f"('head -c {end}', 'tail -c +{end + 1}'), into parts of their own",
        )

    def _read_summary(self, begin: int) -> bool:
        """Whether the summary tells all that is needed; a file may have a part of it, or a damaged one."""
        told: tuple[int, int, int] | None = None
        try:
            for opcode, record, _ in placed_records(self._data[begin : self._end], 0):
                fields = RecordReader(record)
                if opcode == _CHUNK_INDEX:
                    fields.data(16)
                    at, _ = fields.number(8), fields.number(8)
                    offsets = fields.block()
                    self._chunks.append(_Chunk(at, frozenset(key for key, _ in struct.iter_unpack("<HQ", offsets))))
                elif opcode == _STATISTICS:
                    count, _, channels, _, _, chunks, first, last = struct.unpack_from("<QHIIIIQQ", record)
                    fields.data(42)
                    self._counts.update(dict(struct.iter_unpack("<HQ", fields.block())))
                    told = count, channels, chunks
                    self.first_ns, self.last_ns = first, last
                else:
                    self._declare(opcode, record)
        except (DamageError, struct.error):
            told = None
        if told is not None and told[1] <= len(self._channels) and told[2] == len(self._chunks):
            if told[0] == sum(self._counts.values()):
                self._chunks.sort(key=lambda chunk: chunk.begin)
                return True
        for known in (self._schemas, self._channels, self._chunks, self._counts):
            known.clear()
        return False

    def _scan(self, end: int) -> None:
        """Find out by reading the whole file what a summary would have told."""
        first, last = None, 0
        for opcode, record, begin in placed_records(self._data[:end], len(MAGIC)):
            if opcode == _CHUNK:
                keys = set()
                for inner, part, _ in placed_records(self._content(record), 0):
                    self._declare(inner, part)
                    if inner == MESSAGE:
                        key, _, at, _ = MESSAGE_START.unpack_from(part)
                        keys.add(key)
                        self._counts[key] += 1
                        first, last = min(at if first is None else first, at), max(last, at)
                self._chunks.append(_Chunk(begin, frozenset(keys)))
                self._forget(begin)
            elif opcode == MESSAGE:
                key, _, at, _ = MESSAGE_START.unpack_from(record)
                self._counts[key] += 1
                first, last = min(at if first is None else first, at), max(last, at)
            else:
                self._declare(opcode, record)
        self.first_ns, self.last_ns = first or 0, last

    def _declare(self, opcode: int, record: memoryview) -> None:
        fields = RecordReader(record)
        if opcode == _SCHEMA:
            key = fields.number(2)
            self._schemas[key] = _Schema(fields.text(), fields.text(), bytes(fields.block()))
        elif opcode == _CHANNEL:
            key, schema = fields.number(2), self._schemas.get(fields.number(2), _Schema("", "", b""))
            topic, encoding = fields.text(), fields.text()
            kind = schema.name.replace("/", "/msg/") if schema.name.count("/") == 1 else schema.name  # ROS 1
            self._channels[key] = FileTopic(key, topic, kind, encoding, schema.definition, schema.format, 0)

    def messages(self, keys: Collection[int]) -> Iterator[RawMessage]:
        """Messages of some topics in the order of writing.

        Raises
        ------
        BagError
            the file is damaged inside.
        """
        wanted = frozenset(keys)
        self._forgotten = 0
        try:
            if self._chunks:
                for chunk in self._chunks:
                    if not chunk.topics or chunk.topics & wanted:
                        opcode, length = RECORD.unpack_from(self._data, chunk.begin)
                        if opcode != _CHUNK:
                            raise DamageError(f"there is no chunk at byte {chunk.begin}, where the index has one")
                        begin = chunk.begin + RECORD.size
                        content = self._content(self._data[begin : begin + length])
                        for _, record, _ in placed_records(content, 0, MESSAGE):
                            yield from wanted_message(record, wanted)
                        self._forget(begin + length)
            else:
                for _, record, at in placed_records(self._data[: self._end], len(MAGIC), MESSAGE):
                    yield from wanted_message(record, wanted)
                    self._forget(at)
        except (DamageError, struct.error) as error:
            raise self._damaged(error) from None

    def _forget(self, end: int) -> None:
        """Hand back the memory of the file's part before a byte, which the system reads again where it is needed."""
        size = end // mmap.PAGESIZE * mmap.PAGESIZE
        if size > self._forgotten + _FORGET:
            self._map.madvise(mmap.MADV_DONTNEED, self._forgotten, size - self._forgotten)
            self._forgotten = size

    def _content(self, record: memoryview) -> memoryview:
        """The records in a chunk, unpacked and checked."""
        fields = RecordReader(record)
        _, _, size, checksum = _CHUNK_START.unpack(fields.data(_CHUNK_START.size))
        compression = fields.text()
        packed = fields.data(fields.number(8))
        if not compression:
            content = packed
        elif compression in _DECOMPRESS:
            try:
                content = memoryview(_DECOMPRESS[compression](bytes(packed)))
            except (RuntimeError, ValueError, EOFError, zstd.ZstdError) as error:
                raise DamageError(f"a chunk cannot be unpacked by {compression}: {error}") from None
        else:
            raise BagError(
                self._label,
                f"cannot be read: its chunks are compressed with {shown(compression)}; lz4 and zstd are known. "
                "'mcap compress --compression zstd' writes it anew",
            )
        if len(content) != size or (checksum and crc32(content) != checksum):
            raise DamageError("a chunk does not have its size or its checksum")
        return content

    def _damaged(self, error: Exception) -> BagError:
        return BagError(self._label, f"cannot be read: it is damaged inside ({error}). {RECOVER}")

    def close(self) -> None:
        """Close the file."""
        with contextlib.suppress(BufferError):  # of parts that somebody still holds
            self._data.release()
            self._map.close()
        self._file.close()
