# SPDX-License-Identifier: Apache-2.0
"""Files that are replaced as a whole: a reader meets either the old content or the new one.

Otherwise they are as any program leaves them: a new file has the mode that the umask says, an existing one keeps its
own. Of a link, the file that it leads to is replaced.
"""

from __future__ import annotations

import contextlib
import errno
import os
import secrets
import stat
from collections.abc import Callable
from pathlib import Path
from typing import Any


def write_atomically(path: str | os.PathLike[str], write: Callable[[Path], Any]) -> None:
    """Write a file beside its place, and move it there only when that succeeded.

    Parameters
    ----------
    path
        the file; its directory must exist
    write
        called with the name of an empty file in the same directory, which it fills

    Raises
    ------
    OSError
        when `path` is no regular file or must not be written, when its directory does not exist or must not be written,
        and when the disk is full or fails. The error names `path`
    """
    place = Path(os.path.realpath(path))
    try:
        former = _former(place)
        draft = place.with_name(f".{secrets.token_hex(8)}.part")
        # the kernel applies the umask; Python could only ask for it by changing it, for all threads
        os.close(os.open(draft, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o666))
        try:
            write(draft)
            with draft.open("rb+") as file:
                os.fsync(file.fileno())
            if former is not None:
                with contextlib.suppress(PermissionError):  # the new file is then this user's
                    os.chown(draft, former.st_uid, former.st_gid)
                os.chmod(draft, stat.S_IMODE(former.st_mode))
            os.replace(draft, place)
        except BaseException:
            draft.unlink(missing_ok=True)
            raise
    except OSError as error:
        if error.errno is None:
            raise
        raise OSError(error.errno, error.strerror, os.fspath(path)) from error  # the class follows from the number


def _former(place: Path) -> os.stat_result | None:
    """The status of the file that is there now, None without one. Raises OSError for what must not be replaced."""
    try:
        status = place.stat()
    except FileNotFoundError:
        return None
    if stat.S_ISDIR(status.st_mode):
        raise IsADirectoryError(errno.EISDIR, "Is a directory", str(place))
    if not stat.S_ISREG(status.st_mode):  # a file in its place would no longer be a device
        raise OSError(errno.EINVAL, "Not a regular file", str(place))
    if not os.access(place, os.W_OK):
        raise PermissionError(errno.EACCES, "Permission denied", str(place))
    return status
