# SPDX-License-Identifier: Apache-2.0
"""`BagReader`: one recording, in however many files, as topics and messages in the order of writing."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Callable, Collection, Iterator
from contextlib import ExitStack
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Any, Self

from backports import zstd

from tpgmm_core.common.text import listed, one_line
from tpgmm_ros.recordings.storage import metadata
from tpgmm_ros.recordings.storage.bag_error import BagError
from tpgmm_ros.recordings.storage.formats import is_storage_file, open_storage
from tpgmm_ros.recordings.storage.message_types import decoder
from tpgmm_ros.recordings.storage.storage_file import FileTopic, RawMessage, StorageFile

_ZSTD = b"\x28\xb5\x2f\xfd"
"""What a message that is packed begins with; a serialised one begins with 0 (CDR)."""


class BagPath(Path):
    """The path of a bag whose recording goes on in further files or bags.

    Attributes
    ----------
    further
        the parts that follow, in the order of recording
    """

    further: tuple[Path, ...] = ()

    @classmethod
    def joined(cls, parts: Collection[Path]) -> Path:
        """Parts of one recording in their order; a single one is itself."""
        first, *others = parts
        if not others:
            return first
        path = cls(first)
        path.further = tuple(others)
        return path

    def with_segments(self, *segments: Any) -> Path:  # type: ignore[override]
        """Paths that are derived from this one have no further parts."""
        return Path(*segments)


type Decoding = Callable[[Path, FileTopic], Callable[[bytes], Any]]


@dataclass(frozen=True, slots=True)
class BagTopic:
    """A topic of a recording.

    Attributes
    ----------
    name, type
        as recorded
    count
        number of messages
    sources
        where they are: file number and the topic in that file
    """

    name: str
    type: str
    count: int
    sources: tuple[tuple[int, FileTopic], ...]


def check_not_empty(path: Path, topics: Collection[BagTopic]) -> None:
    """Refuse a recording without a single message.

    Parameters
    ----------
    path
        of the bag, for the error
    topics
        all that it has

    Raises
    ------
    BagError
        none of them has a message.
    """
    if not any(topic.count for topic in topics):
        names = f"; its topics are {listed([one_line(topic.name, 60) for topic in topics])}" if topics else ""
        raise BagError(
            path,
            f"holds no message at all{names}. Nothing was published while it was recorded, or the recorder was not "
            "subscribed (other domain, other QoS): record again, and watch the rates",
        )


def parts_of(path: Path) -> list[Path]:
    """Files and folders that a bag's recording consists of."""
    return [Path(str(path)), *(path.further if isinstance(path, BagPath) else ())]


def files_of(path: Path) -> tuple[list[Path], dict[str, int]]:
    """Files of one bag in the order of recording, and how many messages of each topic its metadata announce.

    Returns
    -------
    tuple[list[Path], dict[str, int]]
        files, and topic → number of messages

    Raises
    ------
    BagError
        the folder holds no file of a bag, or its metadata are damaged, or a part is missing.
    """
    if not path.is_dir():
        return [path], {}
    if (path / metadata.NAME).exists():
        found = metadata.Metadata.of(path)
        return list(found.files), dict(found.counts)
    files = sorted(filter(is_storage_file, path.iterdir()), key=natural_order)
    if not files:
        raise BagError(path, "cannot be read: it has neither metadata.yaml nor a .mcap, .db3 or .bag file")
    return files, {}


def itself(bag: Path) -> Path:
    """Where a bag lies, whatever links lead there; the only file of a folder is the same bag as the folder."""
    place = bag.resolve()
    if place.is_file() and (place.parent / metadata.NAME).exists():
        return place.parent if len([one for one in place.parent.iterdir() if is_storage_file(one)]) == 1 else place
    return place


def natural_order(path: Path) -> list[tuple[int, str]]:
    """By name, and numbers in names by their values: demo_9 comes before demo_10."""
    parts = re.findall(r"[0-9]+|[^0-9]+", path.name)
    return [(int(part), "") if part.isdecimal() else (-1, part) for part in parts]


def unpacked(raw: bytes) -> bytes:
    """A message as it was serialised, where rosbag2 has packed each for itself."""
    return zstd.decompress(raw) if raw.startswith(_ZSTD) else raw


def _in_order(folder: Path, files: list[StorageFile]) -> list[StorageFile]:
    """Files of a folder that does not say in which order they were recorded, and whether together."""
    ordered = sorted(files, key=lambda file: file.first_ns)
    for one, other in pairwise(ordered):
        if other.first_ns < one.last_ns:
            raise BagError(
                folder,
                f"holds {len(files)} files that were recorded at the same time, without metadata.yaml: they are no "
                "parts of one recording. Name the files themselves, or a folder that holds this one",
            )
    return ordered


class BagReader:
    """One recording, open from ``with`` to its end.

    Parameters
    ----------
    path
        a bag: a rosbag2 folder, or one file; a `BagPath` for several that are parts of one recording
    whole
        MCAP files that were cut off are refused; else they are read as far as they go

    Attributes
    ----------
    topics
        all of them, in the order in which they were declared
    first_ns, last_ns
        earliest and latest time of the recorder; 0 without a message
    """

    def __init__(self, path: Path, whole: bool = True) -> None:
        self.path, self._whole = path, whole

    def __enter__(self) -> Self:
        announced: Counter[str] = Counter()
        with ExitStack() as stack:
            self._files: list[StorageFile] = []
            try:
                for part in parts_of(self.path):
                    files, counts = files_of(part)
                    opened = [open_storage(file, stack, self._whole) for file in files]
                    self._files += opened if counts else _in_order(part, opened)
                    announced.update(counts)
            except BagError as error:
                raise error.of_bag(self.path) from None
            self._stack = stack.pop_all()
        sources: dict[tuple[str, str], list[tuple[int, FileTopic]]] = {}
        for number, file in enumerate(self._files):
            for topic in file.topics:
                sources.setdefault((topic.name, topic.type), []).append((number, topic))
        self.topics = [
            BagTopic(name, kind, sum(topic.count for _, topic in several), tuple(several))
            for (name, kind), several in sources.items()
        ]
        self._announced = announced
        times = [(file.first_ns, file.last_ns) for file in self._files if any(t.count for t in file.topics)]
        self.first_ns = min((first for first, _ in times), default=0)
        self.last_ns = max((last for _, last in times), default=0)
        return self

    def __exit__(self, *_: object) -> None:
        self._files = []
        self._stack.close()

    def messages(
        self, topics: Collection[BagTopic], decoding: Decoding = decoder
    ) -> Iterator[tuple[BagTopic, int, Any]]:
        """Messages of some topics in the order of writing, with the times of the recorder, ns.

        Parameters
        ----------
        topics
            of this recording
        decoding
            bag and topic of a file → what makes messages of bytes

        Returns
        -------
        Iterator[tuple[BagTopic, int, Any]]
            topic, time, message

        Raises
        ------
        BagError
            a file is damaged, a message cannot be deserialised, or fewer messages come than there should be.
        """
        came = dict.fromkeys((topic.name for topic in topics), 0)
        expected = {
            name: max(sum(t.count for t in topics if t.name == name), self._announced_of(name)) for name in came
        }
        for number, file in enumerate(self._files):
            mine = {
                t.key: (topic, decoding(self.path, t)) for topic in topics for at, t in topic.sources if at == number
            }
            for key, at, raw in self._raw(file, mine) if mine else ():
                topic, decode = mine[key]
                try:
                    message = decode(unpacked(raw))
                except Exception as error:  # of damaged bytes, deserialisers raise many things
                    raise BagError(
                        self.path,
                        f"cannot be read: message {came[topic.name]} on {one_line(topic.name, 60)} is no "
                        f"{one_line(topic.type, 60)}: {type(error).__name__}: {one_line(error, 150)}; it is damaged, "
                        "or was published with another definition. Record it again",
                    ) from error
                came[topic.name] += 1
                yield topic, at, message
        for name, count in came.items():
            if count < expected[name]:
                raise BagError(
                    self.path,
                    f"lost messages: {one_line(name, 60)} holds {count} of the {expected[name]} that were recorded; "
                    "the file is damaged, record it again",
                )

    def raw_messages(self, topics: Collection[BagTopic]) -> Iterator[tuple[BagTopic, int, bytes]]:
        """The same as they were recorded, not deserialised and not counted.

        Returns
        -------
        Iterator[tuple[BagTopic, int, bytes]]
            topic, time of the recorder in ns, bytes

        Raises
        ------
        BagError
            a file is damaged.
        """
        for number, file in enumerate(self._files):
            mine = {source.key: topic for topic in topics for at, source in topic.sources if at == number}
            for key, at, raw in self._raw(file, mine) if mine else ():
                yield mine[key], at, raw

    def _raw(self, file: StorageFile, keys: Collection[int]) -> Iterator[RawMessage]:
        try:
            yield from file.messages(keys)
        except BagError as error:
            raise error.of_bag(self.path) from None

    def _announced_of(self, name: str) -> int:
        """Messages of a topic that metadata announce, where it has one type, so that they can be told apart."""
        if not self._whole:
            return 0
        same = [topic for topic in self.topics if topic.name == name]
        return self._announced[name] if len(same) == 1 else 0
