# SPDX-License-Identifier: Apache-2.0
"""Which format a file of a bag has, by its first bytes; its name and metadata.yaml may be wrong."""

from __future__ import annotations

import shutil
from collections.abc import Callable
from contextlib import ExitStack
from pathlib import Path
from tempfile import TemporaryDirectory

from backports import zstd

from tpgmm_core.common.text import shown
from tpgmm_ros.recordings.storage import mcap_file, ros1_file, sqlite_file
from tpgmm_ros.recordings.storage.bag_error import BagError
from tpgmm_ros.recordings.storage.storage_file import StorageFile

SUFFIXES = (".mcap", ".db3", ".bag", ".mcap.zst", ".mcap.zstd", ".db3.zst", ".db3.zstd", ".bag.active")
"""How names of files of bags end."""

_ZSTD = b"\x28\xb5\x2f\xfd"
_FORMATS: dict[bytes, Callable[[Path, Path], StorageFile]] = {
    mcap_file.MAGIC: mcap_file.McapFile,
    sqlite_file.MAGIC: sqlite_file.SqliteFile,
    ros1_file.MAGIC: ros1_file.Ros1File,
}
_POINTER = b"version https://git-lfs"
_PACKED = {
    b"\x1f\x8b": ("gzip", "gunzip"),
    b"BZh": ("bzip2", "bunzip2"),
    b"\xfd7zXZ\x00": ("xz", "unxz"),
    b"\x04\x22\x4d\x18": ("lz4", "lz4 -d"),
    b"PK\x03\x04": ("zip", "unzip"),
}


def is_storage_file(path: Path) -> bool:
    """Whether a file is called as files of bags are."""
    return path.name.endswith(SUFFIXES) and path.is_file()


def without_suffix(name: str) -> str:
    """The name of a file of a bag without its ending."""
    return next((name.removesuffix(end) for end in SUFFIXES if name.endswith(end)), name)


def has_known_format(path: Path) -> bool:
    """Whether a file begins as files of bags do, whatever it is called."""
    try:
        head = _head(path)
    except OSError:
        return False
    return head.startswith((*_FORMATS, _ZSTD))


def open_storage(path: Path, stack: ExitStack, whole: bool = True) -> StorageFile:
    """Open a file of a bag.

    Parameters
    ----------
    path
        the file; one that is packed by zstd is unpacked into a temporary folder
    stack
        closes it, and removes what was unpacked
    whole
        an MCAP file that was cut off is refused; else it is read as far as it goes

    Returns
    -------
    StorageFile
        the file

    Raises
    ------
    BagError
        the file is empty, was cut off, is damaged, or is of no known format.
    """
    try:
        head = _head(path)
        label = path
        if head.startswith(_ZSTD):
            path = _unpacked(path, stack)
            head = _head(path)
        elif head.startswith(sqlite_file.MAGIC) and _log_of(path).is_file() and _log_of(path).stat().st_size:
            path = _copied(path, stack)
        for magic, kind in _FORMATS.items():
            if head.startswith(magic):
                file = mcap_file.McapFile(path, label, whole) if kind is mcap_file.McapFile else kind(path, label)
                stack.callback(file.close)
                return file
    except OSError as error:
        raise BagError(path, f"cannot be read: {error.strerror or error}") from None
    if not head:
        raise BagError(label, "cannot be read: it is empty (0 bytes), as when the recorder was killed or the disk full")
    for magic, (name, command) in _PACKED.items():
        if head.startswith(magic):
            raise BagError(label, f"cannot be read: it is packed by {name}; unpack it first, with '{command}'")
    if any(magic.startswith(head) for magic in _FORMATS):
        raise BagError(label, f"cannot be read: it was cut off after {len(head)} bytes; record it again")
    if head == _POINTER[: len(head)] and len(head) > 8:
        raise BagError(
            label, "cannot be read: it is a pointer of Git LFS, not the file itself: run 'git lfs pull' where it lies"
        )
    raise BagError(
        label,
        f"cannot be read: its format is not known; it begins with {shown(head[:12])}, expected an MCAP, SQLite (.db3) "
        "or ROS 1 bag file",
    )


def _head(path: Path) -> bytes:
    with path.open("rb") as file:
        return file.read(16)


def _log_of(path: Path) -> Path:
    """What SQLite has not yet put into a file: left beside it where the recorder was killed."""
    return path.with_name(f"{path.name}-wal")


def _copied(path: Path, stack: ExitStack) -> Path:
    """A copy with its log: to read both together, SQLite writes beside them, and nothing may be written here."""
    folder = Path(stack.enter_context(TemporaryDirectory()))
    for file in (path, _log_of(path)):
        shutil.copyfile(file, folder / file.name)
    return folder / path.name


def _unpacked(path: Path, stack: ExitStack) -> Path:
    copy = Path(stack.enter_context(TemporaryDirectory())) / path.stem
    try:
        with zstd.open(path, "rb") as packed, copy.open("wb") as file:
            shutil.copyfileobj(packed, file)
    except (EOFError, zstd.ZstdError) as error:
        raise BagError(
            path,
            f"cannot be read: it is packed by zstd, and was cut off or is damaged ({error}); 'zstd -d' may save the "
            "beginning, and 'mcap recover' what is whole in that",
        ) from None
    return copy
