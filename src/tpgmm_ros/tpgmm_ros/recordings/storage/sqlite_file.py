# SPDX-License-Identifier: Apache-2.0
"""SQLite files of rosbag2 (.db3), read in the order of writing."""

from __future__ import annotations

import sqlite3
from collections.abc import Collection, Iterator
from pathlib import Path
from urllib.parse import quote

from tpgmm_core.common.text import one_line
from tpgmm_ros.recordings.storage.bag_error import BagError
from tpgmm_ros.recordings.storage.storage_file import FileTopic, RawMessage, StorageFile

MAGIC = b"SQLite format 3\x00"
RECOVER = "'sqlite3 FILE .recover' may save what is whole; else record it again"


class SqliteFile(StorageFile):
    """One SQLite file; see `StorageFile`.

    Parameters
    ----------
    path
        the file, with MAGIC at its beginning
    label
        the file that errors name, where `path` is a copy

    Raises
    ------
    BagError
        the file was cut off, is damaged, or is no bag.
    """

    def __init__(self, path: Path, label: Path | None = None) -> None:
        self._label = label or path
        self._refuse_cut(path)
        # immutable: nothing is written beside the file; what waits in a log beside it is read from a copy instead
        options = "mode=ro" if path.with_name(f"{path.name}-wal").exists() else "immutable=1"
        self._database = sqlite3.connect(f"file:{quote(str(path))}?{options}", uri=True)
        try:
            self._open()
        except sqlite3.Error as error:
            self.close()
            raise self._damaged(error) from None
        except BaseException:
            self.close()
            raise

    def _refuse_cut(self, path: Path) -> None:
        with path.open("rb") as file:
            head = file.read(32)
        size, page, pages = path.stat().st_size, int.from_bytes(head[16:18], "big"), int.from_bytes(head[28:32], "big")
        whole = pages * (65536 if page == 1 else page)
        if len(head) < 32 or size < whole:
            raise BagError(
                self._label,
                f"cannot be read: it was cut off; it has {size} bytes of {whole or 'a header of 100'}, as when a copy "
                f"was not finished. {RECOVER}",
            )

    def _open(self) -> None:
        ask = self._database.execute
        tables = {name for (name,) in ask("SELECT name FROM sqlite_master WHERE type = 'table'")}
        if not {"messages", "topics"} <= tables:
            raise BagError(self._label, "cannot be read: it is an SQLite file without messages and topics: no bag")
        definitions = {}
        if "message_definitions" in tables:
            rows = ask("SELECT topic_type, encoding, encoded_message_definition FROM message_definitions")
            definitions = {kind: (encoding, _bytes(text)) for kind, encoding, text in rows}
        counts = dict(ask("SELECT topic_id, COUNT(*) FROM messages GROUP BY topic_id"))
        first, last = ask("SELECT MIN(timestamp), MAX(timestamp) FROM messages").fetchone()
        self.first_ns, self.last_ns = (at if isinstance(at, int) else 0 for at in (first, last))
        self.topics = []
        for key, name, kind, encoding in ask("SELECT id, name, type, serialization_format FROM topics ORDER BY id"):
            found, definition = definitions.get(kind, ("", b""))
            self.topics.append(FileTopic(key, name, kind, encoding, definition, found, counts.get(key, 0)))

    def messages(self, keys: Collection[int]) -> Iterator[RawMessage]:
        """Messages of some topics in the order of writing.

        Raises
        ------
        BagError
            the file is damaged inside.
        """
        wanted = ", ".join(str(int(key)) for key in keys)
        try:
            rows = self._database.execute(
                f"SELECT topic_id, timestamp, data FROM messages WHERE topic_id IN ({wanted}) ORDER BY id"
            )
            for number, (key, at, raw) in enumerate(rows):
                if type(at) is not int or type(raw) is not bytes:  # SQLite takes any value in any column
                    raise self._damaged(
                        f"message {number} has the time {one_line(repr(at)[:40])} and {type(raw).__name__} as data, "
                        "expected an integer, ns, and bytes"
                    )
                yield key, at, raw
        except sqlite3.Error as error:
            raise self._damaged(error) from None

    def _damaged(self, error: Exception | str) -> BagError:
        return BagError(self._label, f"cannot be read: it is damaged inside (SQLite: {error}). {RECOVER}")

    def close(self) -> None:
        """Close the file."""
        self._database.close()


def _bytes(value: str | bytes) -> bytes:
    return value.encode() if isinstance(value, str) else value
